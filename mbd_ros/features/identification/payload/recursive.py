"""What a moving robot carries, from sample to sample: recursive least squares that forget.

    L = exp(-dt / memory) L + X' W X,  b = exp(-dt / memory) b + X' W y,  p = (L + L0)^-1 b

with L0 what is known before any sample. Position, velocity, acceleration and effort pass the same
causal filter, so that all lag alike.

Source: L. Ljung, System Identification, 1999, section 11.2 (forgetting).
"""

import math

import numpy as np

from mbd_ros.core.model.inertial_parameters import (
    COUNT,
    is_consistent,
    parameter_transformation,
    parameters_of,
    parameters_of_pseudo_inertia,
    pseudo_inertia,
)
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import SolveError
from mbd_ros.features.identification.regressor import Regressor
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import InverseDynamics
from mbd_ros.methods.signals.differentiation import LowPass

_ORDER = 3  # of the filter: position, velocity and acceleration come out
_LOOKS = 8.0  # updates in a period of the cut-off
_BAND = 2.0  # independent samples for one period of the cut-off
_SHOWN = 0.3  # of what was open before: what is known better counts as shown
_START = 0.05  # of the efforts: residual before any is known
_TOO_LARGE = "motion and efforts are too large for an estimate"
_LEAST = 1.0e-4  # of a body's pseudo-inertia before any data: what a body keeps at least


class RecursivePayload:
    """Ten inertial numbers of a body that is fixed to a link, in the axes of the link.

    Args:
        robot: The robot without it, of joints alone.
        solver: Inverse dynamics of the scene, open chain.
        cutoff: Half-power frequency of the filter [Hz].
        memory: Time after which samples count 1/e [s].
        mass: Mass that may be expected [kg].
        size: Size that may be expected [m].

    Attributes:
        numbers: Estimate, shape (10,).
        covariance: Of it, shape (10, 10).
        deviation: Residual of each joint [N·m or N], shape (m,).
        updates: How often it looked.

    Raises:
        ModelError: Unknown link.
    """

    def __init__(
        self,
        robot: Robot,
        solver: InverseDynamics,
        frame: str,
        *,
        cutoff: float,
        memory: float,
        mass: float,
        size: float,
    ) -> None:
        self._regressor = Regressor(robot, solver)
        link = robot.model.frames[robot.frame(frame)]
        joint = int(link.parentJoint)
        self._columns = slice(COUNT * (joint - 1), COUNT * joint)
        self._to_joint = parameter_transformation(link.placement)
        self._given = parameters_of(robot.model).ravel()
        self._n, self._memory, self._cutoff = len(self._regressor.labels), memory, cutoff
        self._open = np.array([mass, *[mass * size] * 3, *[mass * size**2] * 6])
        self._prior = np.diag(1.0 / np.square(self._open))
        moment = mass * size**2
        self._least = _LEAST * np.diag([moment, moment, moment, mass])
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._filter = LowPass(_ORDER, self._cutoff, 2 * self._n)
        self._stamp: int | None = None
        self._since, self._settled = 0.0, -self._filter.settling_time
        self._information, self._b = np.zeros((COUNT, COUNT)), np.zeros(COUNT)
        self._power, self._weight = np.zeros(self._n), 0.0
        self.numbers, self.covariance = np.zeros(COUNT), np.diag(np.square(self._open))
        self.deviation, self.updates = np.zeros(self._n), 0

    @property
    def body(self) -> Array:
        """The nearest numbers of a body of positive density, shape (10,)."""
        if is_consistent(self.numbers):
            return self.numbers
        size = np.sqrt(np.diag(self._least))
        values, vectors = np.linalg.eigh(pseudo_inertia(self.numbers) / np.outer(size, size))
        kept = vectors @ np.diag(np.maximum(values, 1.0)) @ vectors.T
        return parameters_of_pseudo_inertia(kept * np.outer(size, size))

    @property
    def shown(self) -> Array:
        """Which numbers the motion shows, shape (10,) of truth."""
        left = np.sqrt(np.diag(self.covariance))
        return np.asarray(left < _SHOWN * self._open)

    def update(self, stamp: int, position: Array, effort: Array) -> bool:
        """Take a sample.

        Args:
            stamp: Time [ns], later than the last.
            position: Of the independent joints [rad or m], shape (m,).
            effort: Of them [N·m or N], same shape.

        Returns:
            Whether the estimate is new.

        Raises:
            SolveError: No finite estimate explains the sample; the estimate stays as it was.
        """
        signal = np.concatenate((position, effort))
        if self._stamp is None:
            self._filter.start(signal, 0.0)
            self._stamp = stamp
            return False
        step = stamp - self._stamp
        self._filter.update(signal, step)
        self._stamp, dt = stamp, step * NANOSECOND
        self._since, self._settled = self._since + dt, self._settled + dt
        if self._settled < 0.0 or self._since * self._cutoff * _LOOKS < 1.0:
            return False
        self._learn(self._since)
        self._since = 0.0
        return True

    def _learn(self, dt: float) -> None:
        """Forget, and add the filtered sample."""
        n, state = self._n, self._filter.state
        y, v, a = (row[None, :n] for row in state)
        effort = state[0, n:]
        W = self._regressor.rows(y, v, a)
        known = self._regressor.known(W, y, v, a, [])[0] + W[0] @ self._given
        X, left = W[0][:, self._columns] @ self._to_joint, effort - known
        sigma = self._scatter(left - X @ self.numbers, effort, dt)
        kept = math.exp(-dt / self._memory)
        worth = min(1.0, _BAND * self._cutoff * dt)
        weighted = worth * X.T / np.square(sigma)
        information = kept * self._information + weighted @ X
        b = kept * self._b + weighted @ left
        try:
            covariance = np.linalg.inv(information + self._prior)
        except np.linalg.LinAlgError as error:
            raise SolveError(_TOO_LARGE) from error
        numbers = covariance @ b
        if not np.isfinite(covariance).all() or not np.isfinite(numbers).all():
            raise SolveError(_TOO_LARGE)
        self._information, self._b = information, b
        self.covariance, self.numbers = covariance, numbers
        self.updates += 1

    def _scatter(self, left: Array, effort: Array, dt: float) -> Array:
        """Deviation of each joint, from residuals of late.

        Raises:
            SolveError: They are not finite.
        """
        kept = math.exp(-dt / self._memory)
        floor = _START * float(np.abs(effort).max(initial=0.0)) + 1.0e-9
        power, weight = kept * self._power + np.square(left), kept * self._weight + 1.0
        share = min(weight / (10.0 + weight), 1.0)
        deviation = np.sqrt(power / weight)
        sigma = np.sqrt(share * np.square(deviation) + (1.0 - share) * (floor * floor)) + 1.0e-9
        if not np.isfinite(sigma).all():
            raise SolveError(_TOO_LARGE)
        self._power, self._weight, self.deviation = power, weight, deviation
        return np.asarray(sigma)
