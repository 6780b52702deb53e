"""Numbers of a scene that nobody knows exactly, as states of an estimator of rate 0."""

from collections.abc import Callable, Sequence

import numpy as np

from mbd_ros.core.contracts.outputs import Now
from mbd_ros.core.contracts.parts import Internal, Load, Slots, Wrench
from mbd_ros.core.contracts.sensor import Measures, Sensor
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.state import Array, State

_KEPT = 16  # loads of other numbers


class UnknownNumber(Load):
    """Numbers that act by what reads them: offsets of sensors, inertias.

    Args:
        owner: Name of what they belong to.
        internal: The numbers, by their arguments.
        nv: Size of the velocity of the robot.
    """

    def __init__(self, owner: str, internal: Sequence[Internal], nv: int) -> None:
        self.name, self.internal = owner, tuple(internal)
        self._none, self._still = np.zeros(nv), np.zeros(len(self.internal))

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Nothing, shape (nv,), not to be written to."""
        return self._none

    def constant_slopes(self, nv: int, nz: int) -> Array:
        """Nothing, shape (nv, 2 nv + nz)."""
        return np.zeros((nv, 2 * nv + nz))

    def rates(self, k: Kinematics, x: State, u: Array) -> Array:
        """Nothing, shape (len(internal),)."""
        return self._still


class UncertainLoad(Load):
    """A load with numbers that are estimated; internal states of its own come first.

    Args:
        load: As the scene has it.
        make: Makes the same load with other values of these numbers.
        internal: The numbers, by their arguments.
    """

    def __init__(
        self, load: Load, make: Callable[[Sequence[float]], Load], internal: Sequence[Internal]
    ) -> None:
        self.name, self.reads, self.inputs = load.name, load.reads, load.inputs
        self._own, self._make = len(load.internal), make
        self.internal = (*load.internal, *internal)
        self._kept = dict[bytes, Load]()

    def bind(self, slots: Slots) -> None:
        """As `Part.bind`; the load has the first internal states."""
        super().bind(slots)
        self._kept = {}

    def _made(self, x: State) -> Load:
        numbers = x.z[self.z][self._own :]
        key = numbers.tobytes()
        load = self._kept.get(key)
        if load is None:
            load = self._make(numbers.tolist())
            load.bind(Slots(self.u, slice(self.z.start, self.z.start + self._own)))
            if len(self._kept) >= _KEPT:
                self._kept.pop(next(iter(self._kept)))
            self._kept[key] = load
        return load

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force [N·m or N], shape (nv,)."""
        return self._made(x).force(k, x, u)

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
        """As those of the load."""
        return self._made(x).wrenches(k, x, u)

    def potential(self, k: Kinematics, x: State) -> float:
        """Energy that it stores [J]."""
        return self._made(x).potential(k, x)

    def rates(self, k: Kinematics, x: State, u: Array) -> Array:
        """Those of the load, then nothing, shape (len(internal),)."""
        found = np.zeros(len(self.internal))
        if self._own:
            found[: self._own] = self._made(x).rates(k, x, u)
        return found


class OffsetSensor(Sensor):
    """A sensor whose offset is estimated.

    Args:
        sensor: As the scene has it.
        offset: The offset, one number a component, beyond that of the sensor itself.
    """

    def __init__(self, sensor: Sensor, offset: UnknownNumber) -> None:
        self.name, self.inner, self._offset = sensor.name, sensor, offset
        self.level, self.reads, self.unit = sensor.level, sensor.reads, sensor.unit
        self.components, self.label, self.delay = sensor.components, sensor.label, sensor.delay
        self.is_linear, self.noise_varies = sensor.is_linear, sensor.noise_varies

    def measure(self, k: Kinematics, x: State, now: Now | None) -> Array:
        """As the sensor, by the estimated offset more."""
        measured: Array = self.inner.measure(k, x, now) + x.z[self._offset.z]
        return measured

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """As that of the sensor."""
        return self.inner.jacobian(k, x)

    def by_position(self, k: Kinematics, x: State) -> Array | None:
        """As that of the sensor."""
        return self.inner.by_position(k, x)

    def by_internal(self, nz: int) -> Array | None:
        """Ones by the offset; differences see it where there is an acceleration."""
        if self.level >= Measures.ACCELERATION:
            return None
        return np.eye(nz)[np.arange(nz)[self._offset.z]]

    def covariance(self, k: Kinematics, x: State) -> Array:
        """As that of the sensor."""
        return self.inner.covariance(k, x)
