"""Search for the gaits of a scene, from the guesses of a task and from grids of joint values.

A scene is a motion with events, evaluated cycle by cycle, for any value of a parameter. A
translation is a travel where moving the motion along it changes neither rates nor guards nor
resets, so that a gait may begin anywhere along it. The travels are the null space of these
changes, which central differences compute.
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

_MOST_FLOWS = 8  # flows: those of a step of a continuation
_ASIDE = 1.0e-3  # m: displacement of a motion that tells whether it changes
_UNCHANGED = 1.0e-7  # change of rates and guards per metre, over the largest entry
_SAME = 1.0e-7  # difference of states of the same gait


def search_gaits(family: SceneFamily, say: Say) -> list[Gait]:
    """Search the gaits to which the guesses of a task lead; each is returned once.

    Raises:
        FallError: No guess reaches the end of a cycle.
        SolveError: No guess leads to a periodic motion.
    """
    scene, task, flow = family.scene, family.task, family.flow()
    starts = list(build_guesses(scene, task, flow))
    gaits: list[Gait] = []
    failures: list[MbdError] = []
    for x in progress(starts, len(starts), "gait"):
        try:
            gaits.append(_find_gait(family, x, gaits))
        except (FallError, SolveError) as error:
            failures.append(error)
    if failures and len(starts) > 1:
        say(f"{len(failures)} of {len(starts)} guesses lead to no gait")
    if not gaits:
        raise _no_gait_error(family, failures)
    origin = gaits[0].motion.passage.begin
    states = [gait.travel.move_back(flow, gait.motion.passage.begin, origin) for gait in gaits]
    return [gaits[i] for i in distinct_states(states, flow, _SAME)]


def build_guesses(scene: Scene, task: GaitTask, flow: SimulatedFlow) -> Iterator[State]:
    """Yield initial states: those of the scene or of the task, then those of its grid."""
    given = task.guesses or ({},)
    initial = scene.entries.get("initial") or {}
    for i, guess in enumerate(given):
        if not guess:
            yield flow.start(scene.initial)
            continue
        try:
            yield flow.start(with_sections(scene, initial=_merged(initial, guess)).initial)
        except SceneError as error:
            raise SceneError(f"{task.source}: gait.guesses[{i}]: {error}") from error
    if task.search:
        first = flow.start(scene.initial)
        for start in grid_starts(task.search):
            try:
                yield place_start(scene, flow, first, start)
            except SolveError:
                continue


def _merged(initial: Mapping[str, object], guess: Mapping[str, object]) -> dict[str, object]:
    """Return an entry `initial` with the values of a guess."""
    entries = dict(initial)
    for key, values in guess.items():
        inner = entries.get(key)
        is_both = isinstance(inner, Mapping) and isinstance(values, Mapping)
        entries[key] = {**inner, **values} if is_both else values  # type: ignore[dict-item]
    return entries


def grid_starts(grids: Sequence[Grid]) -> Iterator[Start]:
    """Yield all combinations of the values of some grids."""
    names = [grid.name for grid in grids]
    values = [np.linspace(grid.low, grid.high, grid.count).tolist() for grid in grids]
    for combination in product(*values):
        yield dict(zip(names, combination, strict=True))


def place_start(scene: Scene, flow: SimulatedFlow, x: State, start: Start) -> State:
    """Return a state near another one, with given values of some joints.

    Raises:
        SceneError: A joint does not exist, or follows other joints.
        SolveError: The loops cannot be closed with these values.
    """
    numbers = flow.system.integrated(np.arange(float(scene.robot.model.nv))).tolist()
    state = flow.system.expand(x)
    positions, velocities = dict[int, float](), dict[int, float]()
    for name, value in start.items():
        joint_name, _, quantity = name.rpartition(".")
        try:
            joint = scene.robot.joint(joint_name)
        except ModelError as error:
            raise SceneError(f"{name}: {error}") from error
        if joint.v not in numbers:
            raise SceneError(f"{name}: this joint follows another one; leave it out")
        index = numbers.index(joint.v)
        if quantity == "position":
            positions[index] = value - float(state.q[joint.q])
        else:
            velocities[index] = value
    return flow.set_coordinates(x, positions, velocities)


def _find_gait(family: SceneFamily, x: State, others: Sequence[Gait]) -> Gait:
    flow = family.flow()
    segments = flow.cycle(x)
    for _ in range(family.task.cycles - 1):
        segments = flow.cycle(segments[-1].after)
    travel = others[0].travel if others else choose_travel(flow, segments, family.task)
    section = segments[-1]
    map_ = ReturnMap(flow, section, travel, family.task.cycles)
    return Gait(periodic_motion(map_, section.end), section, travel)


def _no_gait_error(family: SceneFamily, failures: Sequence[MbdError]) -> MbdError:
    """Return the error for a search without result, with advice."""
    first = failures[0] if failures else SolveError("no guess can be placed")
    where = family.task.source or family.scene.name
    if isinstance(first, FallError):
        return FallError(
            f"{where}: not one cycle can be simulated from the guess: {first}; try another guess "
            "in guesses, a grid of them in search, or a longer time in longest"
        )
    return SolveError(
        f"{where}: {first}; try another guess in guesses, or a grid of them in search"
    )


def distinct_states(states: Sequence[State], flow: SimulatedFlow, near: float) -> list[int]:
    """Return the indices of states that do not repeat an earlier one."""
    indices: list[int] = []
    for i, x in enumerate(states):
        differences: list[Array] = [flow.minus(x, states[j]) for j in indices]
        if all(float(np.abs(d).max()) > near for d in differences):
            indices.append(i)
    return indices


class Gait(NamedTuple):
    """A periodic motion of a scene.

    Attributes:
        motion: The motion.
        section: Segment that ends with the event of the section.
        travel: Directions along which the motion travels.
    """

    motion: PeriodicMotion
    section: Segment
    travel: Travel


class SceneFamily:
    """Return maps of a scene along a parameter.

    Args:
        task: Options of the search.
        parameter: `slope`, a name as `Scene.with_` accepts it, or empty without a parameter.
    """

    def __init__(self, scene: Scene, task: GaitTask, parameter: str = "") -> None:
        self.scene = scene
        self.task = task
        self._parameter = parameter
        self._flows: dict[float, SimulatedFlow] = {}
        self._flow: SimulatedFlow | None = None

    def scene_at(self, value: float) -> Scene:
        """Return the scene at a value of the parameter.

        Raises:
            SceneError: Nothing has the name of the parameter, or the value is out of range.
        """
        if self._parameter == SLOPE:
            return self._sloping(self._gravity(value))
        return with_numbers(self.scene, {self._parameter: value})

    def flow(self, value: float | None = None) -> SimulatedFlow:
        """Return the motion at a value of the parameter; None for the scene as it is."""
        if value is None or not self._parameter:
            self._flow = self._flow or build_flow(self.scene, self.task)
            return self._flow
        if value not in self._flows:
            if len(self._flows) > _MOST_FLOWS:
                self._flows.pop(next(iter(self._flows)))
            self._flows[value] = build_flow(self.scene_at(value), self.task)
        return self._flows[value]

    def of(self, section: Segment, travel: Travel) -> Callable[[float], ReturnMap]:
        """Return a function from the value of the parameter to the return map."""

        def at(value: float) -> ReturnMap:
            flow = self.flow(value)
            return ReturnMap(flow, flow.with_own_guard(section), travel, self.task.cycles)

        return at

    def value(self) -> float | None:
        """Return the slope of the scene; None for other parameters."""
        if self._parameter == SLOPE:
            x, _, z = self._gravity_components()
            return math.atan2(x, -z)
        return None

    def _sloping(self, gravity: list[float]) -> Scene:
        """Return the scene with another gravity, and the same inertias."""
        robot = self.scene.entries.get("robot") or {}
        if "gravity" in robot:
            scene = with_sections(self.scene, robot={**robot, "gravity": gravity})
        else:
            scene = with_sections(self.scene, gravity=gravity)
        changed = any(model_source.inertias for model_source in self.scene.robot.model_sources)
        return with_inertias(scene, self.scene.robot.inertias()) if changed else scene

    def _gravity_components(self) -> tuple[float, float, float]:
        """Return gravity along the downhill direction, 0, and along the normal [m/s^2]."""
        x, y, z = (float(g) for g in self.scene.robot.model.gravity.linear)
        return math.hypot(x, y) * (1.0 if (x, y) >= (0.0, 0.0) else -1.0), 0.0, z

    def _gravity(self, slope: float) -> list[float]:
        """Return gravity on ground that falls by an angle along x, or along a given gravity."""
        x, y, z = (float(g) for g in self.scene.robot.model.gravity.linear)
        size, flat = math.sqrt(x * x + y * y + z * z), math.hypot(x, y)
        along = (x / flat, y / flat) if flat > 0.0 else (1.0, 0.0)
        if along < (0.0, 0.0):
            along = (-along[0], -along[1])
        down = size * math.sin(slope)
        return [down * along[0], down * along[1], -size * math.cos(slope)]


def build_flow(scene: Scene, task: GaitTask) -> SimulatedFlow:
    """Build the motion of a scene, cycle by cycle.

    Args:
        task: Task, of which the event, the longest cycle and the integrator are used.

    Raises:
        SceneError: No event ends a cycle; the message names the events of the scene.
    """
    solver = {"type": scene.solver.tier, "backend": scene.solver.backend}
    plain = build_simulation(scene, integrator=task.integrator, solver=solver)
    parts = plain.system, plain.integrator, plain.stabilization, plain.dt
    joints = [joint.v for joint in scene.robot.joints if joint.kind != "prismatic"]
    numbers = plain.system.integrated(np.arange(float(scene.robot.model.nv)))
    turning = np.flatnonzero(np.isin(numbers, joints))
    return SimulatedFlow(*parts, _end_of_cycle(scene, plain, task), task.longest, turning)


def _end_of_cycle(scene: Scene, plain: Simulation, task: GaitTask) -> EndsCycle:
    """Return the predicate that ends a cycle: a named event, or a return to the first phase."""
    if not plain.guards:
        raise SceneError(
            f"{scene.name}: the scene has no events that could end a cycle; give it phases, "
            "contacts or stops"
        )
    if task.event is not None:
        names = [g for g in plain.guards if task.event in (g, g.partition(".")[2])]
        if not names:
            there = ", ".join(nearest(task.event, plain.guards) or plain.guards)
            raise SceneError(
                f"{task.source or scene.name}: gait.event: no event is called '{task.event}', "
                f"there are: {there}"
            )
        return lambda segment: bool(set(names) & set(segment.event))
    system = plain.system
    if not isinstance(system, PhasedSystem):
        there = ", ".join(plain.guards)
        raise SceneError(
            f"{task.source or scene.name}: gait.event: is missing; name the event that ends a "
            f"cycle, one of: {there}"
        )
    exits = {label(phase, e.name) for phase in system.phases for e in phase.exits}
    return lambda s: s.after.mode[0] == system.first and bool(exits & set(s.event))


def choose_travel(flow: SimulatedFlow, segments: Sequence[Segment], task: GaitTask) -> Travel:
    """Return the travel of a gait: the named one, or the one that is found.

    Raises:
        SceneError: A name is not a coordinate along which the gait can travel.
    """
    known = {coordinate.name: coordinate for coordinate in travel_candidates(flow.system)}
    if task.travel is None:
        return find_travel(flow, segments, tuple(known.values()))
    for name in task.travel:
        if name not in known:
            there = ", ".join(known) or "none"
            raise SceneError(
                f"{task.source}: gait.travel: '{name}' does not travel, there are: {there}"
            )
    return Travel(tuple(known[name] for name in task.travel))


def find_travel(
    flow: Any, segments: Sequence[Segment], coordinates: Sequence[TravelCoordinate]
) -> Travel:
    """Find the directions along which neither rates nor rows nor guards nor resets change.

    Args:
        segments: A cycle of the gait.
        coordinates: Coordinates that may be such directions.
    """
    if not coordinates:
        return Travel()
    changes, sizes = [], [1.0]
    for x, invariants in _invariants(flow, segments):
        along = Travel(coordinates).tangents(x, flow.size)
        near = invariants(x)
        sizes.append(float(np.abs(near).max(initial=0.0)))
        sides = [
            [invariants(flow.plus(x, sign * _ASIDE * column)) for column in along.T]
            for sign in (1.0, -1.0)
        ]
        changes.append((np.array(sides[0]) - np.array(sides[1])).T / (2.0 * _ASIDE))
    _, values, right = np.linalg.svd(np.vstack(changes), full_matrices=True)
    count = int(np.sum(values > _UNCHANGED * max(sizes)))
    return Travel(coordinates, right[count:])


def _invariants(flow: Any, segments: Sequence[Segment]) -> Iterator[tuple[State, Any]]:
    """Yield states, and functions of the state that a travel must not change."""

    def within(x: State) -> Array:
        return np.concatenate((flow.rate(x), flow.residual(x)))

    for segment in segments:
        yield segment.begin, within

        def at_end(x: State, segment: Segment = segment) -> Array:
            after = flow.minus(flow.reset(segment, x), x)
            return np.concatenate((within(x), [flow.value(segment, x)], after))

        yield segment.end, at_end


def travel_candidates(system: Any) -> tuple[TravelCoordinate, ...]:
    """Return the translations of free bodies, and of slides between the world and a robot."""
    robot, model = system.robot, system.model
    index_of = {int(v): i for i, v in enumerate(system.integrated(np.arange(float(model.nv))))}
    chart = system.chart.model
    q_of = {int(j.idx_v): int(j.idx_q) for j in chart.joints if j.nv}
    coordinates = [
        TravelCoordinate(f"{base.name}.position.{axis}", q_of[index_of[base.v.start]], v, number)
        for base in robot.bases
        if (v := index_of.get(base.v.start)) is not None
        for number, axis in enumerate("xyz")
    ]
    carried = {0}
    for joint in robot.joints:
        index = next(i for i, j in enumerate(model.joints) if j.nv and j.idx_v == joint.v)
        if joint.kind != "prismatic" or int(model.parents[index]) not in carried:
            continue
        carried.add(index)
        if joint.v in index_of:
            v = index_of[joint.v]
            coordinates.append(TravelCoordinate(joint.name, q_of[v], v))
    return tuple(coordinates)
