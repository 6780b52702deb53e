"""The search for the gaits of a scene, from guesses of a task and grids of values of joints.

A scene is a motion with events, cycle by cycle, at any value of a parameter. Along some
coordinates a gait may begin anywhere: a translation is a travel where moving the motion along it
changes neither rates nor guards nor resets. The travels are the null space of these changes, by
central differences.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.contracts import label
from mbd_ros.core.dynamics.phased_system import PhasedSystem
from mbd_ros.core.state import Array, State
from mbd_ros.errors import FallError, MbdError, ModelError, SceneError, SolveError
from mbd_ros.features.gait.periodic import PeriodicMotion, ReturnMap, periodic_motion
from mbd_ros.features.gait.task import GaitTask, Grid
from mbd_ros.jobs.progress import Say, progress
from mbd_ros.methods.sensitivities.flow import Segment, Travel, TravelCoordinate
from mbd_ros.methods.sensitivities.simulated_flow import EndsCycle, SimulatedFlow
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.runs.simulation import build_simulation
from mbd_ros.scene.schema.nearest import nearest
from mbd_ros.scene.variants import with_inertias, with_numbers, with_sections

SLOPE = "slope"
Start = Mapping[str, float]
"""Values of `<joint>.position` and `<joint>.velocity`."""

_KEPT = 8  # flows: those of a step of a continuation
_ASIDE = 1.0e-3  # m: how far a motion is moved to see whether it changes
_UNCHANGED = 1.0e-7  # change of rates and guards a metre, over the largest entry
_SAME = 1.0e-7  # of the state: two searches that ended in one gait


def found_gaits(family: SceneFamily, say: Say) -> list[Gait]:
    """The gaits to which the guesses of a task lead, each once.

    Raises:
        FallError: No guess comes to the end of a cycle.
        SolveError: No guess leads to a periodic motion.
    """
    scene, task, flow = family.scene, family.task, family.flow()
    starts = list(guesses(scene, task, flow))
    found: list[Gait] = []
    failures: list[MbdError] = []
    for x in progress(starts, len(starts), "gait"):
        try:
            found.append(_gait(family, x, found))
        except (FallError, SolveError) as error:
            failures.append(error)
    if failures and len(starts) > 1:
        say(f"{len(failures)} of {len(starts)} guesses lead to no gait")
    if not found:
        raise _none(family, failures)
    origin = found[0].motion.passage.begin
    states = [one.travel.back(flow, one.motion.passage.begin, origin) for one in found]
    return [found[i] for i in distinct(states, flow, _SAME)]


def guesses(scene: Scene, task: GaitTask, flow: SimulatedFlow) -> Iterator[State]:
    """States to begin with: those of the scene or of the task, then those of its grid."""
    given = task.guesses or ({},)
    initial = scene.entries.get("initial") or {}
    for i, guess in enumerate(given):
        if not guess:
            yield flow.started(scene.initial)
            continue
        try:
            yield flow.started(with_sections(scene, initial=_merged(initial, guess)).initial)
        except SceneError as error:
            raise SceneError(f"{task.source}: gait.guesses[{i}]: {error}") from error
    if task.search:
        first = flow.started(scene.initial)
        for start in grid_starts(task.search):
            try:
                yield placed_at(scene, flow, first, start)
            except SolveError:
                continue


def _merged(initial: Mapping[str, object], guess: Mapping[str, object]) -> dict[str, object]:
    """An entry of `initial` with values of another one."""
    merged = dict(initial)
    for key, values in guess.items():
        inner = merged.get(key)
        is_both = isinstance(inner, Mapping) and isinstance(values, Mapping)
        merged[key] = {**inner, **values} if is_both else values  # type: ignore[dict-item]
    return merged


def grid_starts(grids: Sequence[Grid]) -> Iterator[Start]:
    """All combinations of the values of some grids."""
    names = [grid.name for grid in grids]
    values = [np.linspace(grid.low, grid.high, grid.count).tolist() for grid in grids]
    for combination in product(*values):
        yield dict(zip(names, combination, strict=True))


def placed_at(scene: Scene, flow: SimulatedFlow, x: State, start: Start) -> State:
    """A state near another one, with values of some joints.

    Raises:
        SceneError: A joint that does not exist, or follows others.
        SolveError: The mechanism cannot be closed with them.
    """
    numbers = flow.system.integrated(np.arange(float(scene.robot.model.nv))).tolist()
    every = flow.system.expand(x)
    positions, velocities = dict[int, float](), dict[int, float]()
    for name, value in start.items():
        joint_name, _, quantity = name.rpartition(".")
        try:
            joint = scene.robot.joint(joint_name)
        except ModelError as error:
            raise SceneError(f"{name}: {error}") from error
        if joint.v not in numbers:
            raise SceneError(f"{name}: follows another joint, leave it out")
        index = numbers.index(joint.v)
        if quantity == "position":
            positions[index] = value - float(every.q[joint.q])
        else:
            velocities[index] = value
    return flow.placed(x, positions, velocities)


def _gait(family: SceneFamily, x: State, others: Sequence[Gait]) -> Gait:
    flow = family.flow()
    segments = flow.cycle(x)
    for _ in range(family.task.cycles - 1):
        segments = flow.cycle(segments[-1].after)
    travel = others[0].travel if others else travel_for(flow, segments, family.task)
    section = segments[-1]
    way = ReturnMap(flow, section, travel, family.task.cycles)
    return Gait(periodic_motion(way, section.end), section, travel)


def _none(family: SceneFamily, failures: Sequence[MbdError]) -> MbdError:
    """Why there is none, with what can be done."""
    first = failures[0] if failures else SolveError("no guess can be placed")
    where = family.task.source or family.scene.name
    if isinstance(first, FallError):
        return FallError(
            f"{where}: from the guess not one cycle can be followed: {first}; accepted: another "
            "guess in guesses, a grid of them in search, a longer longest"
        )
    return SolveError(
        f"{where}: {first}; accepted: another guess in guesses, or a grid of them in search"
    )


def distinct(states: Sequence[State], flow: SimulatedFlow, near: float) -> list[int]:
    """Numbers of the states that are no repetition of an earlier one."""
    found: list[int] = []
    for i, x in enumerate(states):
        apart: list[Array] = [flow.minus(x, states[j]) for j in found]
        if all(float(np.abs(d).max()) > near for d in apart):
            found.append(i)
    return found


class Gait(NamedTuple):
    """A periodic motion of a scene.

    Attributes:
        section: Segment that ends with the event of the section.
        travel: Along which it moves on.
    """

    motion: PeriodicMotion
    section: Segment
    travel: Travel


class SceneFamily:
    """The return maps of a scene along a parameter.

    Args:
        task: What is asked.
        parameter: `slope`, a name as `Scene.with_` takes them, or empty without one.
    """

    def __init__(self, scene: Scene, task: GaitTask, parameter: str = "") -> None:
        self.scene, self.task, self._parameter = scene, task, parameter
        self._flows: dict[float, SimulatedFlow] = {}
        self._flow: SimulatedFlow | None = None

    def scene_at(self, value: float) -> Scene:
        """The scene at a value of the parameter.

        Raises:
            SceneError: Nothing has that name, or the value is out of range.
        """
        if self._parameter == SLOPE:
            return self._sloping(self._gravity(value))
        return with_numbers(self.scene, {self._parameter: value})

    def flow(self, value: float | None = None) -> SimulatedFlow:
        """The motion at a value of the parameter; None for the scene as it is."""
        if value is None or not self._parameter:
            self._flow = self._flow or flow_of(self.scene, self.task)
            return self._flow
        if value not in self._flows:
            if len(self._flows) > _KEPT:
                self._flows.pop(next(iter(self._flows)))
            self._flows[value] = flow_of(self.scene_at(value), self.task)
        return self._flows[value]

    def of(self, section: Segment, travel: Travel) -> Callable[[float], ReturnMap]:
        """The return maps by the value of the parameter."""

        def at(value: float) -> ReturnMap:
            flow = self.flow(value)
            return ReturnMap(flow, flow.own(section), travel, self.task.cycles)

        return at

    def value(self) -> float | None:
        """The value that the scene has; None where only a search tells."""
        if self._parameter == SLOPE:
            x, _, z = self._turned()
            return math.atan2(x, -z)
        return None

    def _sloping(self, gravity: list[float]) -> Scene:
        """The scene with another gravity, where it states its own one, and the same inertias."""
        robot = self.scene.entries.get("robot") or {}
        if "gravity" in robot:
            scene = with_sections(self.scene, robot={**robot, "gravity": gravity})
        else:
            scene = with_sections(self.scene, gravity=gravity)
        changed = any(model_source.inertias for model_source in self.scene.robot.model_sources)
        return with_inertias(scene, self.scene.robot.inertias()) if changed else scene

    def _turned(self) -> tuple[float, float, float]:
        """Gravity along the downhill direction, 0, and along the normal [m/s^2]."""
        x, y, z = (float(g) for g in self.scene.robot.model.gravity.linear)
        return math.hypot(x, y) * (1.0 if (x, y) >= (0.0, 0.0) else -1.0), 0.0, z

    def _gravity(self, slope: float) -> list[float]:
        """Gravity on ground that falls by an angle along x, or along gravity where it has one."""
        x, y, z = (float(g) for g in self.scene.robot.model.gravity.linear)
        size, flat = math.sqrt(x * x + y * y + z * z), math.hypot(x, y)
        along = (x / flat, y / flat) if flat > 0.0 else (1.0, 0.0)
        if along < (0.0, 0.0):
            along = (-along[0], -along[1])
        down = size * math.sin(slope)
        return [down * along[0], down * along[1], -size * math.cos(slope)]


def flow_of(scene: Scene, task: GaitTask) -> SimulatedFlow:
    """The motion of a scene, cycle by cycle.

    Args:
        task: Event of the section, longest cycle and integrator count.

    Raises:
        SceneError: Nothing in it ends a cycle; names what there is.
    """
    solver = {"type": scene.solver.tier, "backend": scene.solver.backend}
    plain = build_simulation(scene, integrator=task.integrator, solver=solver)
    parts = plain.system, plain.integrator, plain.stabilization, plain.dt
    joints = [joint.v for joint in scene.robot.joints if joint.kind != "prismatic"]
    numbers = plain.system.integrated(np.arange(float(scene.robot.model.nv)))
    turning = np.flatnonzero(np.isin(numbers, joints))
    return SimulatedFlow(*parts, _end_of_cycle(scene, plain, task), task.longest, turning)


def _end_of_cycle(scene: Scene, plain: Simulation, task: GaitTask) -> EndsCycle:
    """What ends a cycle: an event by its name, or a way back into the first phase."""
    if not plain.guards:
        raise SceneError(
            f"{scene.name}: nothing happens in it that could end a cycle; accepted: a scene with "
            "phases, contacts or stops"
        )
    if task.event is not None:
        found = [g for g in plain.guards if task.event in (g, g.partition(".")[2])]
        if not found:
            there = ", ".join(nearest(task.event, plain.guards) or plain.guards)
            raise SceneError(
                f"{task.source or scene.name}: gait.event: no event is called '{task.event}', "
                f"there are: {there}"
            )
        return lambda segment: bool(set(found) & set(segment.event))
    system = plain.system
    if not isinstance(system, PhasedSystem):
        there = ", ".join(plain.guards)
        raise SceneError(
            f"{task.source or scene.name}: gait.event: is missing: which event ends a cycle? "
            f"There are: {there}"
        )
    exits = {label(phase, e.name) for phase in system.phases for e in phase.exits}
    return lambda s: s.after.mode[0] == system.first and bool(exits & set(s.event))


def travel_for(flow: SimulatedFlow, segments: Sequence[Segment], task: GaitTask) -> Travel:
    """The travel of a gait: as named, or found.

    Raises:
        SceneError: A name of nothing that travels.
    """
    known = {one.name: one for one in candidates(flow.system)}
    if task.travel is None:
        return travel_of(flow, segments, tuple(known.values()))
    for name in task.travel:
        if name not in known:
            there = ", ".join(known) or "none"
            raise SceneError(
                f"{task.source}: gait.travel: '{name}' does not travel, there are: {there}"
            )
    return Travel(tuple(known[name] for name in task.travel))


def travel_of(
    flow: Any, segments: Sequence[Segment], coordinates: Sequence[TravelCoordinate]
) -> Travel:
    """The directions along which neither rates nor rows nor guards nor resets change.

    Args:
        segments: A cycle of it.
        coordinates: Those that may be such directions.
    """
    if not coordinates:
        return Travel()
    changes, sizes = [], [1.0]
    for x, seen in _places(flow, segments):
        along = Travel(coordinates).tangents(x, flow.size)
        near = seen(x)
        sizes.append(float(np.abs(near).max(initial=0.0)))
        sides = [
            [seen(flow.plus(x, sign * _ASIDE * one)) for one in along.T] for sign in (1.0, -1.0)
        ]
        changes.append((np.array(sides[0]) - np.array(sides[1])).T / (2.0 * _ASIDE))
    every = np.vstack(changes)
    _, found, right = np.linalg.svd(every, full_matrices=True)
    count = int(np.sum(found > _UNCHANGED * max(sizes)))
    return Travel(coordinates, right[count:])


def _places(flow: Any, segments: Sequence[Segment]) -> Iterator[tuple[State, Any]]:
    """States, and what must not change there."""

    def within(x: State) -> Array:
        return np.concatenate((flow.rate(x), flow.open(x)))

    for segment in segments:
        yield segment.begin, within

        def at_end(x: State, segment: Segment = segment) -> Array:
            after = flow.minus(flow.reset(segment, x), x)
            return np.concatenate((within(x), [flow.value(segment, x)], after))

        yield segment.end, at_end


def candidates(system: Any) -> tuple[TravelCoordinate, ...]:
    """Translations of free bodies, and of slides between the world and a robot."""
    robot, model = system.robot, system.model
    kept = {int(v): i for i, v in enumerate(system.integrated(np.arange(float(model.nv))))}
    chart = system.chart.model
    q_of = {int(j.idx_v): int(j.idx_q) for j in chart.joints if j.nv}
    found = [
        TravelCoordinate(f"{base.name}.position.{axis}", q_of[kept[base.v.start]], v, number)
        for base in robot.bases
        if (v := kept.get(base.v.start)) is not None
        for number, axis in enumerate("xyz")
    ]
    carried = {0}
    for joint in robot.joints:
        index = next(i for i, j in enumerate(model.joints) if j.nv and j.idx_v == joint.v)
        if joint.kind != "prismatic" or int(model.parents[index]) not in carried:
            continue
        carried.add(index)
        if joint.v in kept:
            v = kept[joint.v]
            found.append(TravelCoordinate(joint.name, q_of[v], v))
    return tuple(found)
