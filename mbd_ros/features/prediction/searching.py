"""Several guesses, and several values of numbers of a scene, one after the other."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from mbd_ros.errors import SceneError
from mbd_ros.features.prediction.problem import problem_of
from mbd_ros.features.prediction.solving import Found, solve
from mbd_ros.features.prediction.starts import HERE, Start, Where, best_of
from mbd_ros.features.prediction.task import PredictTask
from mbd_ros.jobs.lines import Say
from mbd_ros.scene.built_scene import Scene


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


def search(scene: Scene, task: PredictTask, say: Say, where: Where = HERE) -> list[Step]:
    """The solutions along the continuation of a task; one without.

    Args:
        scene: The scene.
        task: The task.
        say: Is told a line a mesh.
        where: Where several starts are tried.

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
            best, starts = solve(problem, task, say), list[Start]()
        else:
            best, starts = best_of(problem, task, say, where.with_numbers(numbers))
        found.append(Step(numbers, best, starts))
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
