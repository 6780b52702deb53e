"""Unknown numbers, inertias and efforts as internal states of an estimator.

Numbers of loads, offsets of sensors, masses and payloads are constant apart from noise.
"""

from __future__ import annotations

import inspect
import math
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.contracts import Internal, Load, Measures, Now, Sensor, Slots, Wrench
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Within, described
from mbd_ros.core.state import Array, State, have_same_bits
from mbd_ros.errors import ModelError
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.reading.part_entries import part_of
from mbd_ros.scene.schema.nearest import nearest
from mbd_ros.scene.variants import places_of

_CACHED_LOADS = 16  # with different numbers
MASS, PAYLOAD, OFFSET = "mass", "payload", "offset"
_LEAST_MASS = 1.0e-3  # of the mass of a link: lower bound of its estimate


def add_unknowns(
    source: Scene, scene: Scene, sensors: Sequence[Sensor], parameters: Mapping[str, float]
) -> Unknowns:
    """Return the scene and its sensors with numbers to estimate as internal states.

    Args:
        source: The scene as it was read.
        scene: The prepared scene.
        sensors: Sensors of the estimation.
        parameters: Number -> initial standard deviation, as in `EstimateTask`.

    Raises:
        ModelError: A number does not exist; the message tells what is accepted.
    """
    unknowns, places = Unknowns(source, scene, list(sensors)), places_of(source)
    of_loads, others = dict[str, dict[str, float]](), list[tuple[str, str, float]]()
    names = {sensor.name for sensor in sensors}
    for key, deviation in parameters.items():
        owner, _, argument = key.rpartition(".")
        if not 0.0 < deviation < math.inf:
            raise ModelError(f"parameters: {key}: deviation is {deviation:g}, but must be > 0")
        is_offset = argument == OFFSET and owner in names
        if is_offset or (argument in (MASS, PAYLOAD) and owner not in places):
            others.append((owner, argument, deviation))
        else:
            of_loads.setdefault(owner, {})[argument] = deviation
    for owner, numbers in of_loads.items():
        _add_load(unknowns, owner, numbers, sensors)
    for owner, argument, deviation in others:  # last, so that other states keep their places
        if argument == OFFSET:
            _add_offset(unknowns, owner, deviation)
        else:
            _add_mass(unknowns, owner, argument, deviation)
    return unknowns


@dataclass
class Unknowns:
    """A scene with unknown numbers as internal states.

    Attributes:
        source: The scene as it was read.
        scene: The scene with parts for the unknown numbers.
        sensors: Sensors with their offsets.
        masses: Unknown masses in the model of the robot.
        deviations: Internal state -> initial standard deviation.
    """

    source: Scene
    scene: Scene
    sensors: list[Sensor]
    masses: list[UnknownMass] = field(default_factory=list)
    deviations: dict[str, float] = field(default_factory=dict)

    def add_part(self, part: UnknownNumber, deviation: float) -> None:
        """Add a part for unknown numbers."""
        forces = self.scene.parts.get("forces", ())
        self.scene = self.scene.holding(forces=(*forces, part))
        self.deviations |= {f"{part.name}.{number.name}": deviation for number in part.internal}


class UnknownMass(NamedTuple):
    """A mass that is an internal state.

    Attributes:
        part: Part with the internal state.
        joint: Index of the joint that carries the mass.
        first: Value in the model [kg].
        unit: Ten inertial parameters of 1 kg of it, in the axes of the joint, shape (10,).
    """

    part: UnknownNumber
    joint: int
    first: float
    unit: Array


class UnknownNumber(Load):
    """Unknown numbers without a force of their own: offsets of sensors, inertias.

    Args:
        owner: Name of the part to which they belong.
        internal: The numbers, named by their arguments.
        nv: Size of the velocity of the robot.
    """

    def __init__(self, owner: str, internal: Sequence[Internal], nv: int) -> None:
        self.name = owner
        self.internal = tuple(internal)
        self._zero_force = np.zeros(nv)
        self._zero_rates = np.zeros(len(self.internal))

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return zeros, shape (nv,), which must not be written to."""
        return self._zero_force

    def constant_slopes(self, nv: int, nz: int) -> Array:
        """Return zeros, shape (nv, 2 nv + nz)."""
        return np.zeros((nv, 2 * nv + nz))

    def rates(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return zeros, shape (len(internal),)."""
        return self._zero_rates


def _add_load(
    unknowns: Unknowns, owner: str, numbers: Mapping[str, float], sensors: Sequence[Sensor]
) -> None:
    scene = unknowns.source
    loads = {load.name: load for load in scene.parts.get("forces", ()) if load.name}
    key = f"{owner}.{next(iter(numbers))}"
    if owner not in loads:
        names = [f"{name}.{OFFSET}" for name in (s.name for s in sensors)]
        names += [f"{link}.{MASS}" for link in scene.robot.inertias()]
        raise ModelError(_unknown(key, key, [*(f"{name}.<argument>" for name in loads), *names]))
    make, first, bounds = _maker(scene, loads[owner], list(numbers))
    internal = [
        Internal(name, unit, low, high, value, is_constant=True)
        for name, value, (low, high, unit) in zip(numbers, first, bounds, strict=True)
    ]
    part = UncertainLoad(loads[owner], make, internal)
    forces = [part if force.name == owner else force for force in unknowns.scene.parts["forces"]]
    unknowns.scene = unknowns.scene.holding(forces=tuple(forces))
    unknowns.deviations |= {f"{owner}.{name}": value for name, value in numbers.items()}


def _unknown(key: str, word: str, names: Sequence[str]) -> str:
    close = nearest(word, names) or sorted(names)
    there = ", ".join(close[:20]) or "none"
    return f"parameters: '{key}' cannot be estimated; accepted are {there}"


def _maker(
    scene: Scene, load: Load, names: Sequence[str]
) -> tuple[Callable[[Sequence[float]], Load], list[float], list[tuple[float, float, str]]]:
    """Return a factory of a load with other numbers, the given numbers, and bounds and units."""
    place = places_of(scene)[load.name]
    section = next(s for s in scene.sections if s.key == place.section)
    entry = dict(scene.entries[place.section][place.at])
    kind, hints = type(load), typing.get_type_hints(type(load).__init__, include_extras=True)
    signature = inspect.signature(kind).parameters
    first, bounds = list[float](), list[tuple[float, float, str]]()
    for name in names:
        description = described(hints.get(name, str))
        if description.kind is not float:
            known = [n for n, hint in hints.items() if described(hint).kind is float]
            raise ModelError(_unknown(f"{load.name}.{name}", name, known))
        first.append(float(entry.get(name, signature[name].default)))
        within = description.within or Within(-math.inf, math.inf)
        low = -within.high if within.of_size else within.low
        bounds.append((low, within.high, description.unit))
    entry.pop("name", None)
    site = Site(section, scene.origin, scene.robot, scene.parts)

    def make(values: Sequence[float]) -> Load:
        changed = entry | dict(zip(names, values, strict=True))
        changed_load: Load = part_of(section, changed, f"{scene.name}: {load.name}", site)
        changed_load.name = load.name
        return changed_load

    return make, first, bounds


class UncertainLoad(Load):
    """A load with numbers to estimate; internal states of the load itself come first.

    Args:
        load: The load in the scene.
        make: Factory of the same load with other values of these numbers.
        internal: The numbers, named by their arguments.
    """

    def __init__(
        self, load: Load, make: Callable[[Sequence[float]], Load], internal: Sequence[Internal]
    ) -> None:
        self.name = load.name
        self.reads = load.reads
        self.inputs = load.inputs
        self._own_count = len(load.internal)
        self._make = make
        self.internal = (*load.internal, *internal)
        self._loads = dict[tuple[float, ...], Load]()

    def bind(self, slots: Slots) -> None:
        """Bind to places in inputs and internal states; the load has the first of these."""
        super().bind(slots)
        self._loads = {}

    def _load_at(self, x: State) -> Load:
        numbers = tuple(x.z[self.z][self._own_count :].tolist())
        load = self._loads.get(numbers)
        if load is None:
            load = self._make(numbers)
            load.bind(Slots(self.u, slice(self.z.start, self.z.start + self._own_count)))
            if len(self._loads) >= _CACHED_LOADS:
                self._loads.pop(next(iter(self._loads)))
            self._loads[numbers] = load
        return load

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the generalized force [N·m or N], shape (nv,)."""
        return self._load_at(x).force(k, x, u)

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
        """Return the wrenches of the load."""
        return self._load_at(x).wrenches(k, x, u)

    def potential(self, k: Kinematics, x: State) -> float:
        """Return the energy that the load stores [J]."""
        return self._load_at(x).potential(k, x)

    def rates(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the rates of the load, followed by zeros, shape (len(internal),)."""
        rates = np.zeros(len(self.internal))
        if self._own_count:
            rates[: self._own_count] = self._load_at(x).rates(k, x, u)
        return rates


def _add_offset(unknowns: Unknowns, owner: str, deviation: float) -> None:
    at = next(i for i, sensor in enumerate(unknowns.sensors) if sensor.name == owner)
    sensor = unknowns.sensors[at]
    units = sensor.unit or ""
    names = [f"{OFFSET}_{component}".rstrip("_") for component in sensor.components]
    part = UnknownNumber(
        owner,
        [Internal(name, units, initial=0.0, is_constant=True) for name in names],
        int(unknowns.scene.robot.model.nv),
    )
    unknowns.add_part(part, deviation)
    unknowns.sensors[at] = OffsetSensor(sensor, part)


class OffsetSensor(Sensor):
    """A sensor with an offset to estimate.

    Args:
        sensor: The sensor in the scene.
        offset: The offset, one number per component, which is added to the measurement.
    """

    def __init__(self, sensor: Sensor, offset: UnknownNumber) -> None:
        self.name = sensor.name
        self.scene_sensor = sensor
        self._offset = offset
        self.level = sensor.level
        self.reads = sensor.reads
        self.unit = sensor.unit
        self.components = sensor.components
        self.label = sensor.label
        self.delay = sensor.delay
        self.is_linear = sensor.is_linear
        self.noise_varies = sensor.noise_varies

    def measure(self, k: Kinematics, x: State, now: Now | None) -> Array:
        """Return the measurement of the sensor plus the estimated offset."""
        measured: Array = self.scene_sensor.measure(k, x, now) + x.z[self._offset.z]
        return measured

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Return the Jacobian of the sensor, shape (m, n)."""
        return self.scene_sensor.jacobian(k, x)

    def by_position(self, k: Kinematics, x: State) -> Array | None:
        """Return the derivative of the sensor by positions."""
        return self.scene_sensor.by_position(k, x)

    def by_internal(self, nz: int) -> Array | None:
        """Return the derivative by internal states; None for sensors of accelerations."""
        if self.level >= Measures.ACCELERATION:
            return None
        return np.eye(nz)[np.arange(nz)[self._offset.z]]

    def covariance(self, k: Kinematics, x: State) -> Array:
        """Return the covariance of the sensor."""
        return self.scene_sensor.covariance(k, x)


def _add_mass(unknowns: Unknowns, owner: str, argument: str, deviation: float) -> None:
    scene = unknowns.scene
    links = scene.robot.inertias()
    known = list(links) if argument == MASS else [f.name for f in scene.robot.model.frames]
    if owner not in known:
        raise ModelError(_unknown(f"{owner}.{argument}", owner, known))
    if not unknowns.masses:
        own = replace(scene.robot, model=scene.robot.model.copy())
        unknowns.scene = scene = replace(scene, robot=own)
    frame = scene.robot.model.frames[scene.robot.frame(owner)]
    if not int(frame.parentJoint):
        raise ModelError(f"{owner}.{argument}: '{owner}' does not move; name a link that moves")
    first, lower, inertia = 0.0, 0.0, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3)))
    if argument == MASS:
        first = float(links[owner].mass)
        if first <= 0.0:
            raise ModelError(
                f"{owner}.{MASS}: the mass is 0 in the scene; estimate {owner}.{PAYLOAD}, "
                "which is at its origin"
            )
        lower, link = _LEAST_MASS * first, links[owner]
        inertia = pin.Inertia(1.0, link.lever, link.inertia / first)
    unit = np.array(frame.placement.act(inertia).toDynamicParameters())
    part = UnknownNumber(
        owner,
        [Internal(argument, "kg", lower, math.inf, first, is_constant=True)],
        int(scene.robot.model.nv),
    )
    unknowns.add_part(part, deviation)
    unknowns.masses.append(UnknownMass(part, int(frame.parentJoint), first, unit))


class UnknownInertias:
    """Writes estimated masses into a model.

    Inertias of bodies are linear in the masses: pi = pi_0 + sum (z_i - z_i0) d_i, with the ten
    inertial parameters pi of a body.

    Source: C. G. Atkeson, C. H. An, J. M. Hollerbach, Int. J. Robotics Research 5(3) (1986).

    Args:
        model: Pinocchio model that is not shared.
        masses: The estimated masses.
    """

    def __init__(self, model: pin.Model, masses: Sequence[UnknownMass]) -> None:
        self._model = model
        self._data = pin.Data(model)
        self.masses = tuple(masses)
        joints = {mass.joint for mass in masses}
        self._known = {j: np.array(model.inertias[j].toDynamicParameters()) for j in joints}
        self._written: Array | None = None  # internal states whose inertias the model has

    def write(self, z: Array) -> None:
        """Write the inertias that belong to internal states into the model."""
        if not self.masses or have_same_bits(self._written, z):
            return
        self._written = z.copy()
        self._set([float(z[mass.part.z][0]) for mass in self.masses])

    def efforts(self, x: State, a: Array) -> Array:
        """Return the efforts per kilogram of each mass [N·m/kg or N/kg], shape (nv, count).

        Args:
            x: State of all joints, whose internal states have been written.
            a: Accelerations of all joints, shape (nv,).
        """
        values = [float(x.z[mass.part.z][0]) for mass in self.masses]
        here = np.array(pin.rnea(self._model, self._data, x.q, x.v, a))
        efforts = np.empty((len(here), len(values)))
        for i in range(len(values)):
            self._set([value + (i == j) for j, value in enumerate(values)])
            efforts[:, i] = pin.rnea(self._model, self._data, x.q, x.v, a) - here
        self._set(values)
        return efforts

    def _set(self, values: Sequence[float]) -> None:
        total = {joint: known.copy() for joint, known in self._known.items()}
        for mass, value in zip(self.masses, values, strict=True):
            total[mass.joint] += (value - mass.first) * mass.unit
        for joint, numbers in total.items():
            self._model.inertias[joint] = pin.Inertia.FromDynamicParameters(numbers)


class EffortDisturbance(Load):
    """Unknown efforts on some joints: tau = z, z' = 0 apart from noise.

    Efforts that drift have rates, which are internal states as well: z' = r, r' = 0 apart from
    noise.

    Args:
        robot: Robot of the scene.
        joints: Joints on which the efforts act.
        drifting: Whether the efforts have rates; these follow the efforts in z.

    Raises:
        ModelError: A joint is unknown.
    """

    def __init__(self, robot: Robot, joints: Sequence[str], *, drifting: bool = False) -> None:
        parts = [robot.joint(name) for name in joints]
        self.name = "disturbance"
        self.joints = tuple(joints)
        efforts = [
            Internal(j.name, j.effort_unit, initial=0.0, is_constant=not drifting) for j in parts
        ]
        rates = [
            Internal(f"{j.name}_rate", f"{j.effort_unit}/s", initial=0.0, is_constant=True)
            for j in parts
        ]
        self.internal = (*efforts, *(rates if drifting else ()))
        self.drifting = drifting
        self._count = len(parts)
        self._v = np.array([j.v for j in parts], dtype=np.intp)
        self._nv = int(robot.model.nv)
        self._zero_rates = np.zeros(len(self.internal))

    @property
    def efforts(self) -> slice:
        """Slice of the efforts in z."""
        return slice(self.z.start, self.z.start + self._count)

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the generalized force [N·m or N], shape (nv,)."""
        tau, efforts = k.zeros(self._nv), x.z[self.z]
        tau[self._v] = efforts[: self._count] if self.drifting else efforts
        return tau

    def constant_slopes(self, nv: int, nz: int) -> Array | None:
        """Return the constant derivatives of the force, shape (nv, 2 nv + nz); None with drift."""
        if self.drifting:
            return None
        slopes = np.zeros((nv, 2 * nv + nz))
        slopes[self._v, 2 * nv + np.arange(nz)[self.z]] = 1.0
        return slopes

    def rates(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the rates of the efforts, followed by zeros, shape (len(internal),)."""
        if not self.drifting:
            return self._zero_rates
        rates = np.zeros(len(self.internal))
        rates[: self._count] = x.z[self.z][self._count :]
        return rates


def scene_sensor(sensor: Sensor) -> Sensor:
    """Return the sensor of the scene, without an estimated offset."""
    return sensor.scene_sensor if isinstance(sensor, OffsetSensor) else sensor
