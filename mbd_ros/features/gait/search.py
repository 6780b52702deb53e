"""The search for the gaits of a scene, from guesses of a task and grids of values of joints."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array, State
from mbd_ros.errors import FallError, MbdError, ModelError, SceneError, SolveError
from mbd_ros.features.gait.flows import SceneFamily
from mbd_ros.features.gait.periodic import PeriodicMotion, ReturnMap, periodic_motion
from mbd_ros.features.gait.task import GaitTask, Grid
from mbd_ros.features.gait.travel import travel_for
from mbd_ros.jobs.progress import Say, progress
from mbd_ros.methods.sensitivities.flow import Segment
from mbd_ros.methods.sensitivities.simulated_flow import SimulatedFlow
from mbd_ros.methods.sensitivities.travel import Travel
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.variants import with_sections

Start = Mapping[str, float]
"""Values of `<joint>.position` and `<joint>.velocity`."""

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


class Gait(NamedTuple):
    """A periodic motion of a scene.

    Attributes:
        section: Segment that ends with the event of the section.
        travel: Along which it moves on.
    """

    motion: PeriodicMotion
    section: Segment
    travel: Travel


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
