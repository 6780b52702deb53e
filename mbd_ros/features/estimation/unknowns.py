"""Numbers of a scene that are estimated: names and deviations to states of an estimator."""

import inspect
import math
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin

from mbd_ros.core.contracts.parts import Internal, Load
from mbd_ros.core.contracts.sensor import Sensor
from mbd_ros.core.ranges import Within, described
from mbd_ros.errors import ModelError
from mbd_ros.features.estimation.unknown_inertias import UnknownMass
from mbd_ros.features.estimation.unknown_numbers import OffsetSensor, UncertainLoad, UnknownNumber
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.numbers import places_of
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.reading.part_entries import part_of
from mbd_ros.scene.schema.nearest import nearest

MASS, PAYLOAD, OFFSET = "mass", "payload", "offset"
_LEAST = 1.0e-3  # of the mass of a link, below which it is not estimated to be


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


def inner(sensor: Sensor) -> Sensor:
    """The sensor of the scene behind one whose offset is estimated; itself else."""
    return sensor.inner if isinstance(sensor, OffsetSensor) else sensor


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
        lower, link = _LEAST * first, links[owner]
        inertia = pin.Inertia(1.0, link.lever, link.inertia / first)
    unit = np.array(frame.placement.act(inertia).toDynamicParameters())
    part = UnknownNumber(
        owner,
        [Internal(argument, "kg", lower, math.inf, first, is_constant=True)],
        int(scene.robot.model.nv),
    )
    found.hold(part, deviation)
    found.masses.append(UnknownMass(part, int(frame.parentJoint), first, unit))


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


def _unknown(key: str, word: str, names: Sequence[str]) -> str:
    close = nearest(word, names) or sorted(names)
    return f"parameters: '{key}' cannot be estimated; there are {', '.join(close[:20]) or 'none'}"
