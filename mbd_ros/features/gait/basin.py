"""Basin of attraction: which starts lead to a gait, and which fall."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.compiled.build.compiler import cores
from mbd_ros.core.state import State
from mbd_ros.errors import DataError, FallError, SolveError
from mbd_ros.features.gait.search import (
    Gait,
    SceneFamily,
    Start,
    build_flow,
    grid_starts,
    place_start,
    travel_candidates,
)
from mbd_ros.features.gait.task import BasinTask, gait_task
from mbd_ros.jobs.workers.opening import do_all, open_workers, watched
from mbd_ros.jobs.workers.task import Task
from mbd_ros.methods.sensitivities.flow import Travel
from mbd_ros.methods.sensitivities.simulated_flow import SimulatedFlow
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene

FELL, UNDECIDED, NOT_PLACED = 0, -1, -2
_TASKS_A_WORKER = 8
_LONGEST_CYCLE = 5.0  # periods: longest duration of a cycle


def scan_basin(
    family: SceneFamily,
    gaits: Sequence[Gait],
    options: BasinTask,
    workers: int | None,
    scheduler: str | None,
) -> list[Outcome]:
    """Simulate every start of a grid until its outcome is known.

    Args:
        family: The scene and its task.
        gaits: The gaits; only stable ones count, unless there are none.
        options: Grid, cycles and tolerance.
        workers: Number of processes.
        scheduler: Address of a Dask cluster.

    Raises:
        DataError: A worker has failed.
    """
    scene, starts = family.scene, list(grid_starts(options.grid))
    order = _order(family, gaits, options)
    alone = scene.path is None or scene.code or (workers == 1 and scheduler is None)
    if alone or len(starts) < 2:
        results = _scan(scene, order, starts)
        return [Outcome(start, *pair) for start, pair in zip(starts, results, strict=True)]
    with open_workers(scheduler, workers or cores()) as opened:
        size = -(-len(starts) // (_TASKS_A_WORKER * max(opened.count, 1)))
        tasks = [
            Task(f"starts {i}", f"{__name__}:scan", {**order, "starts": starts[i : i + size]})
            for i in range(0, len(starts), size)
        ]
        done = {t.name: r for t, r in watched(do_all(opened, tasks), tasks, opened.count)}
    outcomes = []
    for task in tasks:
        if done[task.name].failure:
            raise DataError(f"{task.name}: {done[task.name].failure}")
        pairs = zip(task.argument["starts"], done[task.name].value, strict=True)
        outcomes += [Outcome(start, *result) for start, result in pairs]
    return outcomes


class Outcome(NamedTuple):
    """Outcome of a start.

    Attributes:
        start: Values of joints.
        number: Number of the gait, from 1 on, or one of `FELL`, `UNDECIDED`, `NOT_PLACED`.
        cycles: Cycles until the outcome was known.
    """

    start: Start
    number: int
    cycles: int


def _order(family: SceneFamily, gaits: Sequence[Gait], options: BasinTask) -> dict[str, Any]:
    stable = [g.motion.is_stable for g in gaits]
    chosen = [(i, g) for i, g in enumerate(gaits, 1) if stable[i - 1] or not any(stable)]
    first, task = gaits[0], family.task
    period = max(g.motion.passage.period for g in gaits) / task.cycles
    return {
        "scene": str(family.scene.path),
        "task": {"integrator": dict(task.integrator), "longest": _LONGEST_CYCLE * period}
        | ({} if task.event is None else {"event": task.event}),
        "travel": first.travel.directions.tolist(),
        "gaits": [[i, *_to_list(g.motion.state)] for i, g in chosen],
        "start": _to_list(first.motion.state),
        "cycles": options.cycles,
        "near": options.near,
    }


def _to_list(x: State) -> list[Any]:
    return [x.t, x.q.tolist(), x.v.tolist(), x.z.tolist(), list(x.mode)]


def _scan(
    scene: Scene, order: Mapping[str, Any], starts: Sequence[Start]
) -> list[tuple[int, int]]:
    """Return number and cycles of each start."""
    flow = build_flow(scene, gait_task(order["task"], "basin"))
    coordinates = travel_candidates(flow.system)
    directions = np.array(order["travel"]).reshape(-1, len(coordinates))
    travel = Travel(coordinates, directions)
    gaits = {number: _state(listed) for number, *listed in order["gaits"]}
    first, outcomes = _state(order["start"]), []
    for start in starts:
        try:
            x = place_start(scene, flow, first, start)
        except SolveError:
            outcomes.append((NOT_PLACED, 0))
            continue
        outcomes.append(_follow(flow, travel, x, gaits, order))
    return outcomes


def _state(listed: Sequence[Any]) -> State:
    t, q, v, z, mode = listed
    return State(t, np.array(q), np.array(v), np.array(z), tuple(mode))


def _follow(
    flow: SimulatedFlow,
    travel: Travel,
    x: State,
    gaits: Mapping[int, State],
    order: Mapping[str, Any],
) -> tuple[int, int]:
    for cycle in range(1, int(order["cycles"]) + 1):
        try:
            x = flow.cycle(x)[-1].after
        except FallError:
            return FELL, cycle
        for number, gait in gaits.items():
            difference = flow.minus(travel.move_back(flow, x, gait), gait)
            if float(np.abs(difference).max()) < float(order["near"]):
                return number, cycle
    return UNDECIDED, int(order["cycles"])


def scan(order: Mapping[str, Any]) -> list[list[int]]:
    """Scan some of the starts in a worker, and return number and cycles of each."""
    return [list(outcome) for outcome in _scan(load_scene(order["scene"]), order, order["starts"])]


def outcome_text(number: int) -> str:
    """Return the outcome of a start for people."""
    texts = {FELL: "fell", UNDECIDED: "undecided", NOT_PLACED: "not placed"}
    return texts.get(number, f"gait {number}")
