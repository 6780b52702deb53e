"""Numbers, inertias and efforts that nobody knows, as states of an estimator.

Numbers of loads, offsets of sensors, masses and payloads have the rate 0, and noise.
"""

from __future__ import annotations

import inspect
import math
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

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

_CACHED_LOADS = 16  # of other numbers
MASS, PAYLOAD, OFFSET = "mass", "payload", "offset"
_LEAST_MASS = 1.0e-3  # of the mass of a link, below which it is not estimated to be


def with_unknowns(
    source: Scene, scene: Scene, sensors: Sequence[Sensor], parameters: Mapping[str, float]
) -> Unknowns:
    """The scene and its sensors with numbers that are estimated.

    Args:
        source: The scene as it is read.
        scene: The same, made ready.
        sensors: What is measured.
        parameters: As in `EstimateTask`.

    Raises:
        ModelError: Names a number that there is not, and what is accepted.
    """
    found, places = Unknowns(source, scene, list(sensors)), places_of(source)
    of_loads, others = dict[str, dict[str, float]](), list[tuple[str, str, float]]()
    names = {sensor.name for sensor in sensors}
    for key, deviation in parameters.items():
        owner, _, argument = key.rpartition(".")
        if not 0.0 < deviation < math.inf:
            raise ModelError(f"parameters: {key}: deviation {deviation:g}, accepted: > 0")
        is_offset = argument == OFFSET and owner in names
        if is_offset or (argument in (MASS, PAYLOAD) and owner not in places):
            others.append((owner, argument, deviation))
        else:
            of_loads.setdefault(owner, {})[argument] = deviation
    for owner, asked in of_loads.items():
        _add_load(found, owner, asked, sensors)
    for owner, argument, deviation in others:  # at the end: states of others keep their places
        if argument == OFFSET:
            _add_offset(found, owner, deviation)
        else:
            _add_mass(found, owner, argument, deviation)
    return found


@dataclass
class Unknowns:
    """A scene whose numbers are internal states.

    Attributes:
        source: The scene as it is read.
        scene: With what holds them.
        sensors: With their offsets.
        masses: Those that stand in the model of its robot.
        deviations: Internal state -> deviation at the start.
    """

    source: Scene
    scene: Scene
    sensors: list[Sensor]
    masses: list[UnknownMass] = field(default_factory=list)
    deviations: dict[str, float] = field(default_factory=dict)

    def hold(self, part: UnknownNumber, deviation: float) -> None:
        """Add what holds numbers."""
        forces = self.scene.parts.get("forces", ())
        self.scene = self.scene.holding(forces=(*forces, part))
        self.deviations |= {f"{part.name}.{one.name}": deviation for one in part.internal}


class UnknownMass(NamedTuple):
    """A mass whose number is an internal state.

    Attributes:
        part: Its internal state.
        joint: Index of the joint that carries it.
        first: Its value in the model [kg].
        unit: Ten numbers of 1 kg of it, in the axes of the joint, shape (10,).
    """

    part: UnknownNumber
    joint: int
    first: float
    unit: Array


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


def _add_load(
    found: Unknowns, owner: str, asked: Mapping[str, float], sensors: Sequence[Sensor]
) -> None:
    scene = found.source
    loads = {load.name: load for load in scene.parts.get("forces", ()) if load.name}
    key = f"{owner}.{next(iter(asked))}"
    if owner not in loads:
        names = [f"{name}.{OFFSET}" for name in (s.name for s in sensors)]
        names += [f"{link}.{MASS}" for link in scene.robot.inertias()]
        raise ModelError(_unknown(key, key, [*(f"{name}.<argument>" for name in loads), *names]))
    make, first, bounds = _maker(scene, loads[owner], list(asked))
    internal = [
        Internal(name, unit, low, high, value, is_constant=True)
        for name, value, (low, high, unit) in zip(asked, first, bounds, strict=True)
    ]
    part = UncertainLoad(loads[owner], make, internal)
    forces = [part if one.name == owner else one for one in found.scene.parts["forces"]]
    found.scene = found.scene.holding(forces=tuple(forces))
    found.deviations |= {f"{owner}.{name}": value for name, value in asked.items()}


def _unknown(key: str, word: str, names: Sequence[str]) -> str:
    close = nearest(word, names) or sorted(names)
    return f"parameters: '{key}' cannot be estimated; there are {', '.join(close[:20]) or 'none'}"


def _maker(
    scene: Scene, load: Load, names: Sequence[str]
) -> tuple[Callable[[Sequence[float]], Load], list[float], list[tuple[float, float, str]]]:
    """What makes a load with other numbers, these numbers now, and their bounds and units."""
    place = places_of(scene)[load.name]
    section = next(s for s in scene.sections if s.key == place.section)
    entry = dict(scene.entries[place.section][place.at])
    kind, hints = type(load), typing.get_type_hints(type(load).__init__, include_extras=True)
    signature = inspect.signature(kind).parameters
    first, bounds = list[float](), list[tuple[float, float, str]]()
    for name in names:
        told = described(hints.get(name, str))
        if told.kind is not float:
            known = [n for n, hint in hints.items() if described(hint).kind is float]
            raise ModelError(_unknown(f"{load.name}.{name}", name, known))
        first.append(float(entry.get(name, signature[name].default)))
        within = told.within or Within(-math.inf, math.inf)
        low = -within.high if within.of_size else within.low
        bounds.append((low, within.high, told.unit))
    entry.pop("name", None)
    site = Site(section, scene.origin, scene.robot, scene.parts)

    def make(values: Sequence[float]) -> Load:
        changed = entry | dict(zip(names, values, strict=True))
        made: Load = part_of(section, changed, f"{scene.name}: {load.name}", site)
        made.name = load.name
        return made

    return make, first, bounds


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
        self._loads = dict[tuple[float, ...], Load]()

    def bind(self, slots: Slots) -> None:
        """Take places in inputs and internal states; the load has the first of these."""
        super().bind(slots)
        self._loads = {}

    def _made(self, x: State) -> Load:
        numbers = tuple(x.z[self.z][self._own :].tolist())
        load = self._loads.get(numbers)
        if load is None:
            load = self._make(numbers)
            load.bind(Slots(self.u, slice(self.z.start, self.z.start + self._own)))
            if len(self._loads) >= _CACHED_LOADS:
                self._loads.pop(next(iter(self._loads)))
            self._loads[numbers] = load
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


def _add_offset(found: Unknowns, owner: str, deviation: float) -> None:
    at = next(i for i, sensor in enumerate(found.sensors) if sensor.name == owner)
    sensor = found.sensors[at]
    units = sensor.unit or ""
    names = [f"{OFFSET}_{one}".rstrip("_") for one in sensor.components]
    part = UnknownNumber(
        owner,
        [Internal(name, units, initial=0.0, is_constant=True) for name in names],
        int(found.scene.robot.model.nv),
    )
    found.hold(part, deviation)
    found.sensors[at] = OffsetSensor(sensor, part)


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
        """The Jacobian of the sensor, shape (m, n)."""
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


def _add_mass(found: Unknowns, owner: str, argument: str, deviation: float) -> None:
    scene = found.scene
    links = scene.robot.inertias()
    known = list(links) if argument == MASS else [f.name for f in scene.robot.model.frames]
    if owner not in known:
        raise ModelError(_unknown(f"{owner}.{argument}", owner, known))
    if not found.masses:
        own = replace(scene.robot, model=scene.robot.model.copy())
        found.scene = scene = replace(scene, robot=own)
    frame = scene.robot.model.frames[scene.robot.frame(owner)]
    if not int(frame.parentJoint):
        raise ModelError(f"{owner}.{argument}: nothing moves '{owner}'")
    first, lower, inertia = 0.0, 0.0, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3)))
    if argument == MASS:
        first = float(links[owner].mass)
        if first <= 0.0:
            raise ModelError(f"{owner}.{MASS} is 0; accepted: {owner}.{PAYLOAD}, at its origin")
        lower, link = _LEAST_MASS * first, links[owner]
        inertia = pin.Inertia(1.0, link.lever, link.inertia / first)
    unit = np.array(frame.placement.act(inertia).toDynamicParameters())
    part = UnknownNumber(
        owner,
        [Internal(argument, "kg", lower, math.inf, first, is_constant=True)],
        int(scene.robot.model.nv),
    )
    found.hold(part, deviation)
    found.masses.append(UnknownMass(part, int(frame.parentJoint), first, unit))


class UnknownInertias:
    """Writes masses into a model.

    Inertias of bodies are linear in them: pi = pi_0 + sum (z_i - z_i0) d_i, with the ten numbers
    of a body.

    Source: C. G. Atkeson, C. H. An, J. M. Hollerbach, Int. J. Robotics Research 5(3) (1986).

    Args:
        model: Pinocchio model that nobody else uses.
    """

    def __init__(self, model: Any, masses: Sequence[UnknownMass]) -> None:
        self._model, self._data, self.masses = model, pin.Data(model), tuple(masses)
        joints = {mass.joint for mass in masses}
        self._known = {j: np.array(model.inertias[j].toDynamicParameters()) for j in joints}
        self._written: Array | None = None  # internal states whose inertias the model has

    def write(self, z: Array) -> None:
        """Give the model the inertias of internal states."""
        if not self.masses or have_same_bits(self._written, z):
            return
        self._written = z.copy()
        self._set([float(z[mass.part.z][0]) for mass in self.masses])

    def efforts(self, x: State, a: Array) -> Array:
        """What 1 kg more of each asks of the joints [N·m/kg or N/kg], shape (nv, count).

        Args:
            x: State of all joints, whose internal states are written.
            a: Accelerations of all joints, shape (nv,).
        """
        values = [float(x.z[mass.part.z][0]) for mass in self.masses]
        here = np.array(pin.rnea(self._model, self._data, x.q, x.v, a))
        found = np.empty((len(here), len(values)))
        for i in range(len(values)):
            self._set([value + (i == j) for j, value in enumerate(values)])
            found[:, i] = pin.rnea(self._model, self._data, x.q, x.v, a) - here
        self._set(values)
        return found

    def _set(self, values: Sequence[float]) -> None:
        total = {joint: known.copy() for joint, known in self._known.items()}
        for mass, value in zip(self.masses, values, strict=True):
            total[mass.joint] += (value - mass.first) * mass.unit
        for joint, numbers in total.items():
            self._model.inertias[joint] = pin.Inertia.FromDynamicParameters(numbers)


class EffortDisturbance(Load):
    """An unknown effort on each of some joints: tau = z, z' = 0 but for noise.

    Efforts that drift have rates, which are states too: z' = r, r' = 0 but for noise.

    Args:
        robot: Robot of the scene.
        joints: Where they act.
        drifting: Whether they have rates; these stand behind the efforts.

    Raises:
        ModelError: Unknown joint.
    """

    def __init__(self, robot: Robot, joints: Sequence[str], *, drifting: bool = False) -> None:
        found = [robot.joint(name) for name in joints]
        self.name, self.joints = "disturbance", tuple(joints)
        efforts = [
            Internal(j.name, j.effort_unit, initial=0.0, is_constant=not drifting) for j in found
        ]
        rates = [
            Internal(f"{j.name}_rate", f"{j.effort_unit}/s", initial=0.0, is_constant=True)
            for j in found
        ]
        self.internal = (*efforts, *(rates if drifting else ()))
        self.drifting, self._count = drifting, len(found)
        self._v, self._nv = np.array([j.v for j in found], dtype=np.intp), int(robot.model.nv)
        self._still = np.zeros(len(self.internal))

    @property
    def efforts(self) -> slice:
        """Where the efforts stand in z."""
        return slice(self.z.start, self.z.start + self._count)

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force [N·m or N], shape (nv,)."""
        tau, efforts = k.zeros(self._nv), x.z[self.z]
        tau[self._v] = efforts[: self._count] if self.drifting else efforts
        return tau

    def constant_slopes(self, nv: int, nz: int) -> Array | None:
        """Ones by the efforts, shape (nv, 2 nv + nz); None where these drift."""
        if self.drifting:
            return None
        slopes = np.zeros((nv, 2 * nv + nz))
        slopes[self._v, 2 * nv + np.arange(nz)[self.z]] = 1.0
        return slopes

    def rates(self, k: Kinematics, x: State, u: Array) -> Array:
        """Of the efforts, and nothing of their rates, shape (len(internal),)."""
        if not self.drifting:
            return self._still
        found = np.zeros(len(self.internal))
        found[: self._count] = x.z[self.z][self._count :]
        return found


def inner(sensor: Sensor) -> Sensor:
    """The sensor of the scene behind one whose offset is estimated; itself else."""
    return sensor.inner if isinstance(sensor, OffsetSensor) else sensor
