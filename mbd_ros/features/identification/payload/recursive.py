"""Recursive estimation of the payload of a moving robot by least squares with forgetting.

    L = exp(-dt / memory) L + X' W X,  b = exp(-dt / memory) b + X' W y,  p = (L + L0)^-1 b

L0 is the prior information. Position, velocity, acceleration and effort pass the same causal
filter, so that all have the same delay.

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

_ORDER = 3  # of the filter, which yields position, velocity and acceleration
_UPDATES = 8.0  # updates in a period of the cutoff frequency
_BAND = 2.0  # independent samples in a period of the cutoff frequency
_SHOWN = 0.3  # of the prior deviation: parameters with a smaller deviation are determined
_START = 0.05  # of the efforts: deviation that is assumed at the start
_TOO_LARGE = "motion and efforts are too large for an estimate"
_LEAST = 1.0e-4  # of the pseudo-inertia of the prior: the least that a body keeps


class RecursivePayload:
    """Ten inertial parameters of a body that is fixed to a link, in the axes of the link.

    Args:
        robot: The robot without the payload, with joints only.
        solver: Inverse dynamics of the scene, an open chain.
        frame: Link that carries the payload.
        cutoff: Half-power frequency of the filter [Hz].
        memory: Time after which the weight of samples has fallen to 1/e [s].
        mass: Expected mass [kg].
        size: Expected size [m].

    Attributes:
        numbers: Estimate of the parameters, shape (10,).
        covariance: Covariance of the estimate, shape (10, 10).
        deviation: Residual of each joint [N·m or N], shape (m,).
        updates: Number of updates of the estimate.

    Raises:
        ModelError: The link does not exist.
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
        self._nominal = parameters_of(robot.model).ravel()
        self._n = len(self._regressor.labels)
        self._memory = memory
        self._cutoff = cutoff
        self._prior_deviation = np.array([mass, *[mass * size] * 3, *[mass * size**2] * 6])
        self._prior = np.diag(1.0 / np.square(self._prior_deviation))
        moment = mass * size**2
        self._least = _LEAST * np.diag([moment, moment, moment, mass])
        self.reset()

    def reset(self) -> None:
        """Discard all samples."""
        self._filter = LowPass(_ORDER, self._cutoff, 2 * self._n)
        self._stamp: int | None = None
        self._since_update = 0.0
        self._since_settled = -self._filter.settling_time
        self._information = np.zeros((COUNT, COUNT))
        self._b = np.zeros(COUNT)
        self._power = np.zeros(self._n)
        self._weight = 0.0
        self.numbers = np.zeros(COUNT)
        self.covariance = np.diag(np.square(self._prior_deviation))
        self.deviation = np.zeros(self._n)
        self.updates = 0

    @property
    def body(self) -> Array:
        """Parameters of the nearest body of positive density, shape (10,)."""
        if is_consistent(self.numbers):
            return self.numbers
        size = np.sqrt(np.diag(self._least))
        values, vectors = np.linalg.eigh(pseudo_inertia(self.numbers) / np.outer(size, size))
        limited = vectors @ np.diag(np.maximum(values, 1.0)) @ vectors.T
        return parameters_of_pseudo_inertia(limited * np.outer(size, size))

    @property
    def is_determined(self) -> Array:
        """Which parameters the motion has determined, booleans of shape (10,)."""
        sigma = np.sqrt(np.diag(self.covariance))
        return np.asarray(sigma < _SHOWN * self._prior_deviation)

    def update(self, stamp: int, position: Array, effort: Array) -> bool:
        """Add a sample.

        Args:
            stamp: Time [ns], later than the last.
            position: Positions of the independent joints [rad or m], shape (m,).
            effort: Efforts of the independent joints [N·m or N], shape (m,).

        Returns:
            Whether the estimate was updated.

        Raises:
            SolveError: No finite estimate explains the sample; the estimate remains unchanged.
        """
        signal = np.concatenate((position, effort))
        if self._stamp is None:
            self._filter.start(signal, 0.0)
            self._stamp = stamp
            return False
        step = stamp - self._stamp
        self._filter.update(signal, step)
        self._stamp = stamp
        dt = step * NANOSECOND
        self._since_update += dt
        self._since_settled += dt
        if self._since_settled < 0.0 or self._since_update * self._cutoff * _UPDATES < 1.0:
            return False
        self._add_sample(self._since_update)
        self._since_update = 0.0
        return True

    def _add_sample(self, dt: float) -> None:
        """Reduce the weight of earlier samples, and add the filtered sample."""
        n, state = self._n, self._filter.state
        y, v, a = (row[None, :n] for row in state)
        effort = state[0, n:]
        W = self._regressor.rows(y, v, a)
        known = self._regressor.known(W, y, v, a, [])[0] + W[0] @ self._nominal
        X, torque = W[0][:, self._columns] @ self._to_joint, effort - known
        sigma = self._update_deviation(torque - X @ self.numbers, effort, dt)
        decay = math.exp(-dt / self._memory)
        worth = min(1.0, _BAND * self._cutoff * dt)
        weighted = worth * X.T / np.square(sigma)
        information = decay * self._information + weighted @ X
        b = decay * self._b + weighted @ torque
        try:
            covariance = np.linalg.inv(information + self._prior)
        except np.linalg.LinAlgError as error:
            raise SolveError(_TOO_LARGE) from error
        numbers = covariance @ b
        if not np.isfinite(covariance).all() or not np.isfinite(numbers).all():
            raise SolveError(_TOO_LARGE)
        self._information = information
        self._b = b
        self.covariance = covariance
        self.numbers = numbers
        self.updates += 1

    def _update_deviation(self, residual: Array, effort: Array, dt: float) -> Array:
        """Return the deviation of each joint from recent residuals.

        Raises:
            SolveError: The deviations are not finite.
        """
        decay = math.exp(-dt / self._memory)
        floor = _START * float(np.abs(effort).max(initial=0.0)) + 1.0e-9
        power, weight = decay * self._power + np.square(residual), decay * self._weight + 1.0
        share = min(weight / (10.0 + weight), 1.0)
        deviation = np.sqrt(power / weight)
        sigma = np.sqrt(share * np.square(deviation) + (1.0 - share) * (floor * floor)) + 1.0e-9
        if not np.isfinite(sigma).all():
            raise SolveError(_TOO_LARGE)
        self._power = power
        self._weight = weight
        self.deviation = deviation
        return np.asarray(sigma)
