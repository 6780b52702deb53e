"""A program solved from a guess, and from others where that leads nowhere."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

from mbd_ros.core.state import Array
from mbd_ros.features.prediction.problem import Problem
from mbd_ros.features.prediction.task import PredictTask
from mbd_ros.jobs.lines import Say
from mbd_ros.optimal_control.free_body_names import body_names
from mbd_ros.optimal_control.unknowns import PhaseMotion

if TYPE_CHECKING:
    from mbd_ros.optimal_control.ipopt import Tell
    from mbd_ros.optimal_control.motion_program import Solution

import numpy as np

from mbd_ros.core.state import State
from mbd_ros.errors import MbdError
from mbd_ros.features.prediction.replay import simulation_of
from mbd_ros.optimal_control.unknowns import steps_of

# The motion that a scene has by itself as a guess: without inputs its equations hold exactly.

_ACCURATE = 1.0e-3  # error of a motion that is a guess
_SAMPLES = 200
_LARGEST = 1.0e3  # times the usual sizes: a motion that goes further is no guess


def passive(problem: Problem) -> list[PhaseMotion] | None:
    """The motion from the beginning of the guess without inputs; None where there is none.

    Args:
        problem: Of one phase of a scene without phases and recording.
    """
    if len(problem.guesses) > 1 or problem.scene.phases or problem.recording is not None:
        return None
    (guess,) = problem.guesses
    idle = np.array(problem.modes[0].system.loads.idle, dtype=np.float64)
    points = {**guess.points, "u": np.tile(idle, (len(guess.points["u"]), 1))}
    still = guess._replace(points=points)
    simulation = simulation_of(problem.scene, [still], _ACCURATE, _SAMPLES)
    first = State(guess.begin, *(guess.nodes[key][0] for key in "qvz"))
    x = simulation.system.expand(first)
    x = x._replace(mode=problem.modes[0].mode) if problem.modes[0].mode else x
    states = [simulation.system.reduce(x)]
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            states += [simulation.system.reduce(at) for at in simulation.run(x, guess.duration)]
    except MbdError:
        return None
    sampled = {key: np.array([getattr(one, key) for one in states]) for key in "qvz"}
    if not all(np.abs(one).max(initial=0.0) < _LARGEST for one in sampled.values()):
        return None
    times = np.array([one.t for one in states])
    return [_written(still, (times - guess.begin) / guess.duration, sampled)]


def _written(motion: PhaseMotion, shares: Array, sampled: dict[str, Array]) -> PhaseMotion:
    nodes, points = dict(motion.nodes), dict(motion.points)
    for at, found in ((motion.mesh.knots, nodes), (motion.mesh.shares, points)):
        for key, values in sampled.items():
            columns = [np.interp(at, shares, one) for one in values.T]
            found[key] = np.array(columns).reshape(-1, len(at)).T
    for q, _ in motion.bases:
        for found in (nodes, points):
            turn = found["q"][:, q + 3 : q + 7]
            turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    points["d"] = steps_of(motion.mesh, nodes["q"], points["q"], motion.bases)
    return motion._replace(nodes=nodes, points=points)


_PATIENCE = 200  # iterations from a guess before another one is tried
_LOST = (  # the solver found no way, which says nothing of the program
    "Maximum_Iterations_Exceeded",
    "Search_Direction_Becomes_Too_Small",
    "Restoration_Failed",
    "Error_In_Step_Computation",
    "Invalid_Number_Detected",
)


class Beginning(NamedTuple):
    """What a program begins with.

    Attributes:
        guesses: Of each phase.
        parameters: Values of parameters.
        links: Unknowns of what links phases; None for zeros.
        cost_size: Usual size of the cost.
        is_near: Whether that solves a program that is nearly this one.
    """

    guesses: list[PhaseMotion]
    parameters: Array
    links: Array | None = None
    cost_size: float = 1.0
    is_near: bool = False


def solved_from(
    problem: Problem, begin: Beginning, task: PredictTask, tell: "Tell", say: Say
) -> "tuple[Solution, int]":
    """The solution from a guess, or the last iterate, and the iterations that all of it took.

    From a solution on another mesh the solver looks nearby, then further away; from a guess it
    looks for some time, then from the motion without inputs, then from the guess until the end.
    Free bodies that go where they like begin with the motion without inputs.

    Args:
        problem: What is solved.
        begin: What the program begins with.
        task: The task.
        tell: See `MotionProgram.solve`.
        say: Is told where another guess is tried.
    """
    total = 0
    for number, (one, most, word) in enumerate(_attempts(problem, begin, task)):
        if number:
            say(f"no way found from there: once more from {word}")
        solution = problem.program.solve(
            one.guesses,
            one.parameters,
            accuracy=task.accuracy,
            cost_size=one.cost_size,
            most=most,
            is_near=one.is_near,
            links=one.links,
            has_kinks=problem.recording is not None,
            tell=tell,
        )
        total += solution.solved.iterations
        if solution.solved.status not in _LOST:
            break
    return solution, total


def _attempts(
    problem: Problem, begin: Beginning, task: PredictTask
) -> Iterator[tuple[Beginning, int, str]]:
    """What is begun with, at most so many iterations, and what that is called."""
    most = task.iterations
    some = min(_PATIENCE, most)
    if begin.is_near:
        yield begin, some, ""
        yield begin._replace(is_near=False), most, "a wider search on this mesh"
        return
    if most <= some or problem.recording is not None:
        yield begin, most, ""
        return
    given, drifts = (begin, some, "the given guess"), _drifts(problem, task)
    if not drifts:
        yield given
    by_itself = passive(problem)
    if by_itself is not None:
        yield begin._replace(guesses=by_itself), some, "the motion without inputs"
    if drifts:
        yield given
    yield begin, most, "the given guess, for longer"


def _drifts(problem: Problem, task: PredictTask) -> bool:
    """Whether free bodies go where nothing but their motion says, so that no line leads there."""
    if task.guess or task.guess_file is not None:
        return False
    phase = problem.program.phases[0]
    bodies = {name for base in problem.scene.robot.bases for name in body_names(base.name)}
    found = (one.name for name in phase.problem.end for one in phase.quantities.find(name))
    return bool(bodies) and bodies.isdisjoint(found)
