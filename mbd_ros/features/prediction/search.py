"""Search from several guesses, in this process or on workers; the cheapest solution counts."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.compiled.build.compiler import cores
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, SceneError
from mbd_ros.features.prediction.problem import Problem, build_problem
from mbd_ros.features.prediction.solving import STOPPED, Prediction, solve
from mbd_ros.features.prediction.task import PredictTask, predict_task
from mbd_ros.jobs.progress import Say
from mbd_ros.jobs.workers.opening import do_all, open_workers, watched
from mbd_ros.jobs.workers.task import Task
from mbd_ros.optimal_control.phase_motion import PhaseMotion
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.task_reader import read_task
from mbd_ros.scene.variants import with_numbers

_WAVES = 3  # half waves of a random guess
_HEIGHT = 0.5  # of the range of all positions
_EQUAL = 1.0e-8  # relative difference of costs of one minimum; its first start counts


class StartWorkers(NamedTuple):
    """Where the starts of a task are solved.

    Attributes:
        workers: Number of processes; None for one per core.
        scheduler: Address of a Dask cluster that replaces them.
        order: Instructions for a worker; None where all starts are solved in this process.
    """

    workers: int | None = 1
    scheduler: str | None = None
    order: Mapping[str, Any] | None = None

    def with_numbers(self, numbers: Mapping[str, float]) -> StartWorkers:
        """Return the same workers for a scene with other numbers."""
        order = None if self.order is None else {**self.order, "numbers": dict(numbers)}
        return self._replace(order=order)


LOCAL = StartWorkers()


def search(scene: Scene, task: PredictTask, say: Say, workers: StartWorkers = LOCAL) -> list[Step]:
    """Return the solutions along the continuation of a task; a single one without continuation.

    Args:
        say: Receives a line for each mesh.
        workers: Where several starts are solved.

    Raises:
        SceneError: The lists of values differ in length.
    """
    steps = list[Step]()
    for numbers in _values(task):
        if numbers:
            say("with " + ", ".join(f"{name} = {value:.9g}" for name, value in numbers.items()))
        problem = build_problem(with_numbers(scene, numbers) if numbers else scene, task)
        for line in problem.changes:
            say(line)
        if steps:
            last = steps[-1].prediction.solution
            more = {"parameters": last.parameters, "links": last.links}
            problem = problem._replace(guesses=list(last.motions), **more)
            best, starts = solve(problem, task, say), list[Start]()
        else:
            best, starts = best_start(problem, task, say, workers.with_numbers(numbers))
        steps.append(Step(numbers, best, starts))
        if not best.is_converged:
            break
    return steps


class Step(NamedTuple):
    """One step of a continuation.

    Attributes:
        numbers: Numbers of the scene by name.
        prediction: The solution for these numbers.
        starts: Results of all starts; empty for a single one.
    """

    numbers: dict[str, float]
    prediction: Prediction
    starts: Sequence[Start] = ()


def _values(task: PredictTask) -> Iterator[dict[str, float]]:
    counts = {len(values) for values in task.continuation.values()}
    if len(counts) > 1:
        raise SceneError(
            f"{task.source}: predict.continuation: all numbers need equally many values"
        )
    if not counts:
        yield {}
    for i in range(counts.pop() if counts else 0):
        yield {name: values[i] for name, values in task.continuation.items()}


def best_start(
    problem: Problem, task: PredictTask, say: Say, workers: StartWorkers = LOCAL
) -> tuple[Prediction, list[Start]]:
    """Return the cheapest solution from the given guess and from random ones around it.

    Args:
        problem: Problem with the given guess.
        say: Receives a line for each mesh, or for each start.
        workers: Where the starts are solved.
    """
    if task.starts == 1:
        return solve(problem, task, say), []
    if workers.order is None or (workers.workers == 1 and workers.scheduler is None):
        return _one_by_one(problem, task, say)
    starts = list(_start_on_workers(task.starts, say, workers))
    best = cheapest_start(starts).number if starts else 1
    say(f"the best is start {best}")
    return solve(with_start(problem, best), task, say), starts


def _one_by_one(problem: Problem, task: PredictTask, say: Say) -> tuple[Prediction, list[Start]]:
    starts, best = list[Start](), None
    for number in range(1, task.starts + 1):
        if number > 1:
            say(f"start {number} of {task.starts}")
        prediction = solve(with_start(problem, number), task, say)
        status = prediction.solution.solved.status
        is_stopped = prediction.is_interrupted or status == STOPPED
        if best is None or not is_stopped:
            starts.append(_start_result(number, prediction))
            best = prediction if cheapest_start(starts).number == number else best
        if is_stopped:
            break
    assert best is not None
    return best, starts


def _start_result(number: int, prediction: Prediction) -> Start:
    iterations, worst = prediction.iterations, prediction.worst
    return Start(number, prediction.cost, prediction.is_converged, iterations, worst)


def _start_on_workers(count: int, say: Say, workers: StartWorkers) -> Iterator[Start]:
    """Yield the results of all starts, or of those solved until Ctrl-C, in their order."""
    order, done = dict(workers.order or {}), list[Start]()
    try:
        with open_workers(workers.scheduler, workers.workers or cores()) as pool:
            tasks = [
                Task(f"start {number}", f"{__name__}:try_start", {**order, "number": number})
                for number in range(1, count + 1)
            ]
            for worker_task, result in watched(do_all(pool, tasks), tasks, pool.count):
                if result.failure:
                    raise DataError(f"{worker_task.name}: {result.failure}")
                done.append(Start(*result.value))
                say(_start_line(done[-1], count))
    except KeyboardInterrupt:
        say(f"interrupted after {len(done)} of {count} starts")
    return iter(sorted(done))


def _start_line(start: Start, count: int) -> str:
    word = "" if start.is_converged else ", not converged"
    return (
        f"start {start.number} of {count}: cost {start.cost:.12g}, {start.iterations} "
        f"iterations{word}"
    )


def try_start(order: Mapping[str, Any]) -> list[Any]:
    """Solve from one guess in a worker, and return the fields of a `Start`."""
    scene, section = load_scene(order["scene"]), order["task"]
    if isinstance(section, str):
        task = read_task(section, scene).parts["predict"]
    else:
        task = predict_task(section, "predict")
    numbers = order.get("numbers")
    problem = build_problem(with_numbers(scene, numbers) if numbers else scene, task)
    number = int(order["number"])
    return list(_start_result(number, solve(with_start(problem, number), task, lambda line: None)))


def cheapest_start(starts: list[Start]) -> Start:
    """Return the first of the cheapest solutions, or of last iterates without a solution."""
    good = [start for start in starts if start.is_converged] or starts
    least = min(start.cost for start in good)
    near = [start for start in good if start.cost <= least + _EQUAL * abs(least)]
    return min(near, key=lambda start: start.number)


class Start(NamedTuple):
    """Result of the search from one guess.

    Attributes:
        number: 1 for the given guess; others have random waves added to it.
        cost: Cost of the solution, or of the last iterate.
        is_converged: Whether it is a solution.
        iterations: Iterations on all meshes.
        error: Relative error between nodes.
    """

    """
    """

    number: int
    cost: float
    is_converged: bool
    iterations: int
    error: float


def choose_workers(
    scene: Scene, task: Any, workers: int | None, scheduler: str | None
) -> StartWorkers:
    """Choose where starts are solved: in this process if workers cannot read scene and task.

    Args:
        task: Task file, or keys of its section.
        workers: Number of processes; None for one per core.
        scheduler: Address of a Dask cluster.

    Raises:
        DataError: Workers are requested, but the scene is no file or calls functions.
    """
    section = task
    if isinstance(task, str | Path):  # a name is a task that comes with the package
        section = str(Path(task).absolute()) if Path(task).exists() else str(task)
    can_travel = scene.path is not None and not scene.code
    try:
        json.dumps(section)
    except TypeError:
        can_travel = False
    if can_travel:
        return StartWorkers(workers, scheduler, {"scene": str(scene.path), "task": section})
    if scheduler is not None or (workers or 1) > 1:
        raise DataError(
            f"{scene.name}: starts on workers need a scene from a file, without functions; use "
            "workers=1, or save the scene"
        )
    return LOCAL


def with_start(problem: Problem, number: int) -> Problem:
    """Return the problem with the guess of a start: the given one, or one with random waves."""
    if number == 1:
        return problem
    random = np.random.default_rng(number - 1)
    return problem._replace(guesses=[_add_waves(motion, random) for motion in problem.guesses])


def _add_waves(motion: PhaseMotion, random: np.random.Generator) -> PhaseMotion:
    """Add random waves that vanish at the ends to the positions of a guess."""
    mesh, flat = motion.mesh, not motion.bases
    nq = motion.nodes["q"].shape[1]
    size = max(float(np.ptp(motion.nodes["q"], axis=0).max(initial=0.0)), 1.0) * _HEIGHT
    heights = size * random.standard_normal((_WAVES, nq)) * flat
    nodes, points = dict(motion.nodes), dict(motion.points)
    for shares, values in ((mesh.knots, nodes), (mesh.shares, points)):
        wave, slope = _waves(shares)
        values["q"] = values["q"] + wave @ heights
        if flat:
            values["v"] = values["v"] + slope @ heights / motion.duration
    return motion._replace(nodes=nodes, points=points)


def _waves(shares: Array) -> tuple[Array, Array]:
    turns = np.pi * np.arange(1, _WAVES + 1)
    return np.sin(shares[:, None] * turns), np.cos(shares[:, None] * turns) * turns
