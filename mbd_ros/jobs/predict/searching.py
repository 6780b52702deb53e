"""Several guesses, and several values of numbers of a scene, one after the other."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from mbd_ros.core.prediction.unknowns import PhaseMotion
from mbd_ros.core.state import Array
from mbd_ros.errors import SceneError
from mbd_ros.jobs.lines import Say
from mbd_ros.jobs.predict.problem import Problem, problem_of
from mbd_ros.jobs.predict.solving import Found, solve
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.predict_task import PredictTask

_WAVES = 3  # half waves of a random guess
_HEIGHT = 0.5  # of the range of all positions


class Step(NamedTuple):
    """A value of a continuation.

    Attributes:
        numbers: Of the scene, by name.
        found: The solution there.
    """

    numbers: dict[str, float]
    found: Found


def search(scene: Scene, task: PredictTask, say: Say) -> list[Step]:
    """The solutions along the continuation of a task; one without.

    Args:
        scene: The scene.
        task: The task.
        say: Is told a line a mesh.

    Raises:
        SceneError: Values that do not belong together.
    """
    found = list[Step]()
    for numbers in _values(task):
        if numbers:
            say("with " + ", ".join(f"{name} = {value:.9g}" for name, value in numbers.items()))
        problem = problem_of(scene.with_(numbers) if numbers else scene, task)
        for line in problem.changes:
            say(line)
        if found:
            last = found[-1].found.solution
            more = {"parameters": last.parameters, "links": last.links}
            problem = problem._replace(guesses=list(last.motions), **more)
            best = solve(problem, task, say)
        else:
            best = _best(problem, task, say)
        found.append(Step(numbers, best))
        if not best.is_converged:
            break
    return found


def _values(task: PredictTask) -> Iterator[dict[str, float]]:
    counts = {len(values) for values in task.continuation.values()}
    if len(counts) > 1:
        raise SceneError(f"{task.source}: predict.continuation: as many values of every number")
    if not counts:
        yield {}
    for i in range(counts.pop() if counts else 0):
        yield {name: values[i] for name, values in task.continuation.items()}


def _best(problem: Problem, task: PredictTask, say: Say) -> Found:
    """The cheapest solution from the guess and from random ones around it."""
    best = solve(problem, task, say)
    for number in range(1, task.starts):
        if best.is_interrupted:
            break
        say(f"start {number + 1} of {task.starts}")
        random = np.random.default_rng(number)
        guesses = [_shaken(motion, random) for motion in problem.guesses]
        other = solve(problem._replace(guesses=guesses), task, say)
        if other.is_converged and not (best.is_converged and best.cost <= other.cost):
            best = other
    return best


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
