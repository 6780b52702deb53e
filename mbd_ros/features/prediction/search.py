"""Several guesses of a motion, here or on workers; the cheapest solution counts."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.compiled.build.compiler import cores
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, SceneError
from mbd_ros.features.prediction.problem import Problem, problem_of
from mbd_ros.features.prediction.solving import STOPPED, Found, solve
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
_EQUAL = 1.0e-8  # costs that are so near are one minimum: the first start that found it counts


class Where(NamedTuple):
    """Where starts are tried.

    Attributes:
        workers: How many processes; None for one a core.
        scheduler: Of a Dask cluster, in place of them.
        order: What a worker has to know; None where everything is done here.
    """

    workers: int | None = 1
    scheduler: str | None = None
    order: Mapping[str, Any] | None = None

    def with_numbers(self, numbers: Mapping[str, float]) -> Where:
        """The same for a scene with other numbers."""
        order = None if self.order is None else {**self.order, "numbers": dict(numbers)}
        return self._replace(order=order)


HERE = Where()


def search(scene: Scene, task: PredictTask, say: Say, where: Where = HERE) -> list[Step]:
    """The solutions along the continuation of a task; one without.

    Args:
        say: Is told a line a mesh.
        where: Where several starts are tried.

    Raises:
        SceneError: Values that do not belong together.
    """
    found = list[Step]()
    for numbers in _values(task):
        if numbers:
            say("with " + ", ".join(f"{name} = {value:.9g}" for name, value in numbers.items()))
        problem = problem_of(with_numbers(scene, numbers) if numbers else scene, task)
        for line in problem.changes:
            say(line)
        if found:
            last = found[-1].found.solution
            more = {"parameters": last.parameters, "links": last.links}
            problem = problem._replace(guesses=list(last.motions), **more)
            best, starts = solve(problem, task, say), list[Start]()
        else:
            best, starts = best_of(problem, task, say, where.with_numbers(numbers))
        found.append(Step(numbers, best, starts))
        if not best.is_converged:
            break
    return found


class Step(NamedTuple):
    """A value of a continuation.

    Attributes:
        numbers: Of the scene, by name.
        found: The solution there.
        starts: What became of each start; empty for one alone.
    """

    numbers: dict[str, float]
    found: Found
    starts: Sequence[Start] = ()


def _values(task: PredictTask) -> Iterator[dict[str, float]]:
    counts = {len(values) for values in task.continuation.values()}
    if len(counts) > 1:
        raise SceneError(f"{task.source}: predict.continuation: as many values of every number")
    if not counts:
        yield {}
    for i in range(counts.pop() if counts else 0):
        yield {name: values[i] for name, values in task.continuation.items()}


def best_of(
    problem: Problem, task: PredictTask, say: Say, where: Where = HERE
) -> tuple[Found, list[Start]]:
    """The cheapest solution from the guess and from random ones around it.

    Args:
        problem: What is solved.
        say: Is told a line a mesh, or a line a start.
        where: Where they are tried.
    """
    if task.starts == 1:
        return solve(problem, task, say), []
    if where.order is None or (where.workers == 1 and where.scheduler is None):
        return _one_by_one(problem, task, say)
    starts = list(_on_workers(task.starts, say, where))
    best = chosen(starts).number if starts else 1
    say(f"the best is start {best}")
    return solve(started(problem, best), task, say), starts


def _one_by_one(problem: Problem, task: PredictTask, say: Say) -> tuple[Found, list[Start]]:
    starts, best = list[Start](), None
    for number in range(1, task.starts + 1):
        if number > 1:
            say(f"start {number} of {task.starts}")
        found = solve(started(problem, number), task, say)
        is_stopped = found.is_interrupted or found.solution.solved.status == STOPPED
        if best is None or not is_stopped:
            starts.append(_told(number, found))
            best = found if chosen(starts).number == number else best
        if is_stopped:
            break
    assert best is not None
    return best, starts


def _told(number: int, found: Found) -> Start:
    return Start(number, found.cost, found.is_converged, found.iterations, found.worst)


def _on_workers(count: int, say: Say, where: Where) -> Iterator[Start]:
    """All starts, or those that were done until Ctrl-C, in their order."""
    order, done = dict(where.order or {}), list[Start]()
    try:
        with open_workers(where.scheduler, where.workers or cores()) as opened:
            tasks = [
                Task(f"start {number}", f"{__name__}:try_start", {**order, "number": number})
                for number in range(1, count + 1)
            ]
            for one, result in watched(do_all(opened, tasks), tasks, opened.count):
                if result.failure:
                    raise DataError(f"{one.name}: {result.failure}")
                done.append(Start(*result.value))
                say(_line(done[-1], count))
    except KeyboardInterrupt:
        say(f"interrupted after {len(done)} of {count} starts")
    return iter(sorted(done))


def _line(one: Start, count: int) -> str:
    word = "" if one.is_converged else ", not converged"
    return (
        f"start {one.number} of {count}: cost {one.cost:.12g}, {one.iterations} iterations{word}"
    )


def try_start(order: Mapping[str, Any]) -> list[Any]:
    """Solve from one guess, in a worker."""
    scene, given = load_scene(order["scene"]), order["task"]
    if isinstance(given, str):
        task = read_task(given, scene).parts["predict"]
    else:
        task = predict_task(given, "predict")
    numbers = order.get("numbers")
    problem = problem_of(with_numbers(scene, numbers) if numbers else scene, task)
    number = int(order["number"])
    return list(_told(number, solve(started(problem, number), task, lambda line: None)))


def chosen(starts: list[Start]) -> Start:
    """The first of the cheapest solutions; of last iterates where there is none."""
    good = [one for one in starts if one.is_converged] or starts
    least = min(one.cost for one in good)
    near = [one for one in good if one.cost <= least + _EQUAL * abs(least)]
    return min(near, key=lambda one: one.number)


class Start(NamedTuple):
    """What became of a guess.

    Attributes:
        number: 1 for the given guess, others have waves on it.
        cost: Of the solution, or of the last iterate.
        is_converged: Whether it is a solution.
        iterations: On all meshes.
        error: Between nodes, relative.
    """

    number: int
    cost: float
    is_converged: bool
    iterations: int
    error: float


def where_of(scene: Scene, task: Any, workers: int | None, scheduler: str | None) -> Where:
    """Where starts of a task are tried: here, if a worker could not read scene and task.

    Args:
        task: Task file, or keys of its section.
        workers: How many processes; None for one a core.
        scheduler: Of a Dask cluster.

    Raises:
        DataError: Workers are asked for, and the scene is no file or calls functions.
    """
    given = task
    if isinstance(task, str | Path):  # a name is a task that comes with the package
        given = str(Path(task).absolute()) if Path(task).exists() else str(task)
    can_travel = scene.path is not None and not scene.code
    try:
        json.dumps(given)
    except TypeError:
        can_travel = False
    if can_travel:
        return Where(workers, scheduler, {"scene": str(scene.path), "task": given})
    if scheduler is not None or (workers or 1) > 1:
        raise DataError(
            f"{scene.name}: starts on workers need a scene from a file, without functions"
        )
    return HERE


def started(problem: Problem, number: int) -> Problem:
    """The problem with the guess of a start: the given one, or with random waves of its own."""
    if number == 1:
        return problem
    random = np.random.default_rng(number - 1)
    return problem._replace(guesses=[_shaken(motion, random) for motion in problem.guesses])


def _shaken(motion: PhaseMotion, random: np.random.Generator) -> PhaseMotion:
    """A guess with random waves on its positions, none at the ends."""
    mesh, flat = motion.mesh, not motion.bases
    nq = motion.nodes["q"].shape[1]
    size = max(float(np.ptp(motion.nodes["q"], axis=0).max(initial=0.0)), 1.0) * _HEIGHT
    heights = size * random.standard_normal((_WAVES, nq)) * flat
    nodes, points = dict(motion.nodes), dict(motion.points)
    for shares, found in ((mesh.knots, nodes), (mesh.shares, points)):
        wave, slope = _waves(shares)
        found["q"] = found["q"] + wave @ heights
        if flat:
            found["v"] = found["v"] + slope @ heights / motion.duration
    return motion._replace(nodes=nodes, points=points)


def _waves(shares: Array) -> tuple[Array, Array]:
    turns = np.pi * np.arange(1, _WAVES + 1)
    return np.sin(shares[:, None] * turns), np.cos(shares[:, None] * turns) * turns
