"""All sensors of an estimator at once: what they should see, and how that changes."""

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from mbd_ros.core.contracts.outputs import Now
from mbd_ros.core.contracts.sensor import Measures, Sensor
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.estimation.process import Observation
from mbd_ros.core.estimation.state_tangent import StateTangent
from mbd_ros.core.inverse_dynamics.sensed_reactions import FeltReactions
from mbd_ros.core.kinematics.kinematics import Reads
from mbd_ros.core.state import Array, Evaluation, State
from mbd_ros.errors import ModelError

_STEP = 1.0e-6  # of differences [m, rad and their rates]


class SensorSet:
    """Sensors of a mechanism, one below the other.

    Args:
        sensors: The sensors.
        system: The system.
        evaluate: As that of the system, which it is by default; what depends on accelerations
            asks it.

    Attributes:
        sensors: As given.
        m: Numbers in all.
        slices: Where each stands.
        names: `<sensor>`, or `<sensor>.<component>`, in the same order.
    """

    def __init__(
        self,
        sensors: Sequence[Sensor],
        system: System,
        evaluate: Callable[[State, Array | None], Evaluation] | None = None,
    ) -> None:
        self.sensors, self._system = tuple(sensors), system
        self._evaluate = system.evaluate if evaluate is None else evaluate
        ends = np.cumsum([0, *(len(sensor.components) for sensor in sensors)]).tolist()
        self.m = ends[-1]
        self.slices = [slice(a, b) for a, b in itertools.pairwise(ends)]
        self.names = tuple(
            ".".join(filter(None, (sensor.name, one)))
            for sensor in sensors
            for one in sensor.components
        )
        self._reads = max((_asked(sensor) for sensor in sensors), default=Reads.NOTHING)
        self._needs_forces = any(s.level >= Measures.ACCELERATION for s in sensors)
        feels = any(s.level >= Measures.FORCE for s in sensors)
        self._felt = FeltReactions(system) if feels else None
        self._noise_varies = any(s.noise_varies for s in sensors)
        self._R: Array | None = None
        nv = int(system.robot.model.nv)
        self._by_q, self._by_v = np.zeros((2, self.m, nv))
        each = zip(self.sensors, self.slices, strict=True)
        self._turning = [(s, mine) for s, mine in each if not s.is_linear]
        self._is_filled, nz = False, system.internals.nz
        self._same: Array | None = None  # the derivative, where it is the same everywhere
        self._by_z, self._is_offset = np.zeros((self.m, nz)), False
        for sensor, mine in zip(self.sensors, self.slices, strict=True):
            slope = sensor.by_internal(nz)
            if slope is not None:
                self._by_z[mine], self._is_offset = slope, True
        each = zip(self.sensors, self.slices, strict=True)
        self._winding = [(s, mine) for s, mine in each if type(s).near is not Sensor.near]

    def near(self, values: Array, expected: Array) -> Array:
        """What was measured, written as near to what is expected as it can be, shape (m,)."""
        if not self._winding:
            return values
        found = values.copy()
        for sensor, mine in self._winding:
            found[mine] = sensor.near(values[mine], expected[mine])
        return found

    def values(self, y: State, u: Array | None) -> Array:
        """What they should see, shape (m,)."""
        return self._measured(y, u)[1]

    def covariance(self, y: State) -> Array:
        """Of the noise, shape (m, m), not to be written to.

        Raises:
            ModelError: A sensor without noise; names it.
        """
        if self._R is not None and not self._noise_varies:
            return self._R
        x, k = self._system.expand(y), self._system.k
        k.refresh(x.q, x.v, self._reads)
        R = np.zeros((self.m, self.m))
        for sensor, mine in zip(self.sensors, self.slices, strict=True):
            R[mine, mine] = sensor.covariance(k, x)
            if not (R[mine, mine].diagonal() > 0.0).all():
                raise ModelError(
                    f"sensor {sensor.name}: an estimator needs its noise, accepted: > 0"
                )
        self._R = R
        return R

    def observe(self, y: State, u: Array | None, tangent: StateTangent) -> Observation:
        """What they should see, and its derivative by steps of the tangent."""
        R = self.covariance(y)
        x, here = self._measured(y, u)
        if self._same is not None:
            return Observation(here, self._same, R)
        if not self._is_filled:
            self._fill(x)
        k, differ = self._system.k, list[int]()
        for sensor, mine in self._turning:
            if sensor.level is Measures.POSITION:
                self._by_q[mine] = sensor.jacobian(k, x)
                continue
            by_q = sensor.by_position(k, x) if sensor.level is Measures.VELOCITY else None
            if by_q is None:
                differ.extend(range(mine.start, mine.stop))
            else:
                self._by_q[mine], self._by_v[mine] = by_q, sensor.jacobian(k, x)
        nv, lift = self._by_q.shape[1], tangent.of_all_joints(y)
        H = self._by_q.dot(lift[:nv]) + self._by_v.dot(lift[nv:])
        if self._is_offset:
            H[:, tangent.n - self._by_z.shape[1] :] += self._by_z
        if differ:
            H[differ] = self._differences(y, u, here, tangent)[differ]
        if tangent.is_whole and tangent.n == 2 * nv + self._by_z.shape[1] and not self._turning:
            self._same = H
        return Observation(here, H, R)

    def _fill(self, x: State) -> None:
        """The rows that never change."""
        self._is_filled = True
        for sensor, mine in zip(self.sensors, self.slices, strict=True):
            if sensor.is_linear and sensor.level is Measures.POSITION:
                self._by_q[mine] = sensor.jacobian(self._system.k, x)
            elif sensor.is_linear:
                by_q = sensor.by_position(self._system.k, x)
                self._by_q[mine] = 0.0 if by_q is None else by_q
                self._by_v[mine] = sensor.jacobian(self._system.k, x)

    def _differences(self, y: State, u: Array | None, here: Array, tangent: StateTangent) -> Array:
        found, step = np.zeros((self.m, tangent.n)), np.zeros(tangent.n)
        for i in range(tangent.n):
            step[i] = _STEP
            found[:, i] = (self.values(tangent.plus(y, step), u) - here) / _STEP
            step[i] = 0.0
        return found

    def _measured(self, y: State, u: Array | None) -> tuple[State, Array]:
        """State of all joints, and what the sensors should see there."""
        system, now = self._system, None
        x, k = system.expand(y), system.k
        if self._needs_forces:
            found = self._evaluate(x, u)
            felt = self._felt
            reactions = None if felt is None else felt.at(x, u, found.a, found.lam)
            now = Now(found.a, found.lam, reactions)
        k.refresh(x.q, x.v, self._reads)
        every = [np.asarray(s.measure(k, x, now), dtype=np.float64) for s in self.sensors]
        return x, np.concatenate([np.zeros(0), *every])


def _asked(sensor: Sensor) -> Reads:
    """What a sensor and its Jacobian read of k."""
    return Reads(max(sensor.reads, Reads.JACOBIAN)) if sensor.reads else Reads.NOTHING
