"""A program solved on finer and finer meshes, until errors between nodes are small enough."""

import time
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.features.prediction.attempts import Beginning, solved_from
from mbd_ros.features.prediction.mesh_errors import SAVED, Look, Passing, look_at, next_mesh
from mbd_ros.features.prediction.problem import Problem
from mbd_ros.features.prediction.task import PredictTask
from mbd_ros.jobs.lines import Say
from mbd_ros.jobs.progress import PERIOD, announce
from mbd_ros.optimal_control.error_estimate import errors_of
from mbd_ros.optimal_control.mesh import Mesh
from mbd_ros.optimal_control.unknowns import PhaseMotion, steps_of

if TYPE_CHECKING:
    from mbd_ros.optimal_control.ipopt import Progress
    from mbd_ros.optimal_control.motion_program import Solution

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

# Ctrl-C ends a search after an iteration instead of the process, so that what it has is kept.


class Interruption:
    """Whether somebody asked for the end.

    Attributes:
        is_asked: Whether it was.
    """

    def __init__(self) -> None:
        self.is_asked = False


@contextmanager
def interruptible() -> Iterator[Interruption]:
    """Take SIGINT for as long as the context lasts; nothing in other threads than the main one."""
    found = Interruption()
    if threading.current_thread() is not threading.main_thread():
        yield found
        return

    def ask(number: int, frame: object) -> None:
        found.is_asked = True

    before = signal.signal(signal.SIGINT, ask)
    try:
        yield found
    finally:
        signal.signal(signal.SIGINT, before)


STOPPED = "User_Requested_Stop"
_LEAST = 1.0e-9  # of the usual size of a cost: less is none
_CLOSE = 1.0e-2  # error with which a solution beside a recording leads to that of another mesh
_STAYING, _ALIKE, _NEAR = 40, 1.0e-4, 1.0e-3  # iterations, their costs, their violations


class Found(NamedTuple):
    """A solution, or the last iterate.

    Attributes:
        problem: What was solved.
        solution: Of the last mesh.
        errors: Relative errors between nodes, of each interval of each phase.
        is_fine: Whether the errors are within the tolerance, and no bound is passed too far.
        iterations: On all meshes.
        lines: One a mesh, for people.
        passings: Bounds that are passed between nodes, the worst one first.
        is_interrupted: Whether somebody ended it between two meshes.
        keeps_limits: Whether contacts that are held neither pull nor slip, as far as is known.
    """

    problem: Problem
    solution: "Solution"
    errors: list[Array]
    is_fine: bool
    iterations: int
    lines: list[str]
    passings: tuple[Passing, ...] = ()
    is_interrupted: bool = False
    keeps_limits: bool = True

    @property
    def is_converged(self) -> bool:
        """Whether conditions of optimality hold and errors are within the tolerance."""
        return self.solution.solved.is_good and self.is_fine

    @property
    def cost(self) -> float:
        """The cost."""
        return self.solution.solved.cost

    @property
    def worst(self) -> float:
        """Largest relative error between nodes."""
        return max(float(one.max(initial=0.0)) for one in self.errors)


def solve(problem: Problem, task: PredictTask, say: Say) -> Found:
    """Solve on the first mesh, and on refined ones.

    Args:
        problem: What is solved.
        task: The task.
        say: Is told a line a mesh.
    """
    with interruptible() as interruption:
        found = _refined(problem, task, say, interruption)
        if found.keeps_limits or found.is_interrupted:
            return found
        say("contacts that are held would pull or slip: once more within what they can exert")
        limited = problem._replace(program=problem.program.limited())
        near, last = limited, found.solution
        if last.solved.is_good:
            near = limited._replace(
                guesses=list(last.motions), parameters=last.parameters, links=last.links
            )
        again = _refined(near, task, say, interruption)
        if near is not limited and not again.is_converged and not again.is_interrupted:
            again = _refined(limited, task, say, interruption)
        return again._replace(keeps_limits=True, iterations=found.iterations + again.iterations)


def _refined(problem: Problem, task: PredictTask, say: Say, interruption: Interruption) -> Found:
    begin = Beginning(list(problem.guesses), problem.parameters, problem.links)
    total, lines, costs = 0, list[str](), list[float]()
    has_pieces = problem.recording is None and problem.program.has_pieces
    for round_ in range(task.mesh.refinements + 1):
        watcher = _Watcher(round_, interruption, has_pieces=has_pieces)
        solution, spent = solved_from(problem, begin, task, watcher, say)
        solved = solution.solved
        total += spent
        found, looks = _judged(problem, solution, task, total, lines)
        lines.append(mesh_line(round_, solution, found.worst))
        say(lines[-1])
        if not problem.program.keeps_limits(solution):
            return found._replace(keeps_limits=False)
        costs.append(solved.cost)
        is_settled = all(one.is_settled for one in looks) or _is_same(costs, task.tolerance)
        is_done = solved.is_good and found.is_fine and is_settled
        if is_done or not (solved.is_good or watcher.is_staying):
            return found
        if interruption.is_asked:
            return found._replace(is_fine=False, is_interrupted=True)
        guesses = [
            moved(motion, next_mesh(motion.mesh, error, look, task.tolerance))
            for motion, error, look in zip(solution.motions, found.errors, looks, strict=True)
        ]
        size = max(abs(solved.cost), _LEAST * begin.cost_size)
        near = problem.recording is None or found.worst < _CLOSE
        begin = Beginning(guesses, solution.parameters, solution.links, size, near)
    return found


def _judged(
    problem: Problem, solution: "Solution", task: PredictTask, total: int, lines: list[str]
) -> tuple[Found, list[Look]]:
    """What there is, and what it says of the mesh that it wants."""
    pairs = zip(problem.program.phases, solution.motions, strict=True)
    errors = [error_of(*pair, solution.parameters) for pair in pairs]
    looks = [look_at(problem, i, solution, task) for i in range(len(errors))]
    every = [passing for one in looks for passing in one.passings]
    passings = tuple(sorted(every, key=lambda one: -one.severity))
    found = Found(problem, solution, errors, False, total, lines, passings)
    is_fine = found.worst <= task.tolerance and not any(one.passed.any() for one in looks)
    return found._replace(is_fine=is_fine), looks


def _is_same(costs: Sequence[float], tolerance: float) -> bool:
    """Whether the last mesh changed the cost by less than matters, wherever inputs change."""
    if len(costs) < 2:
        return False
    return abs(costs[-1] - costs[-2]) <= SAVED * tolerance * abs(costs[-1])


def mesh_line(round_: int, solution: "Solution", worst: float) -> str:
    """What is said of a mesh."""
    intervals = sum(motion.mesh.intervals for motion in solution.motions)
    points = sum(int(motion.mesh.degrees.sum()) for motion in solution.motions)
    solved = solution.solved
    return (
        f"mesh {round_ + 1}: {intervals} intervals, {points} points, {solved.iterations} "
        f"iterations, cost {solved.cost:.12g}, error between nodes {worst:.2g}"
    )


def error_of(phase: Any, motion: PhaseMotion, p: Array) -> Array:
    """Relative error of each interval of a phase, shape (n,)."""

    def rates(shares: Array, values: dict[str, Array]) -> tuple[Array, Array]:
        times, interval = motion.begin + motion.duration * shares, motion.mesh.find(shares)[0]
        found = phase.equations.solved(values, times, p)
        spans = motion.duration * motion.mesh.widths[interval]
        return found["a"], phase.equations.calmed(values, found["w"], times, spans, p)

    return errors_of(motion, rates).relative


def moved(motion: PhaseMotion, mesh: Mesh) -> PhaseMotion:
    """A motion on another mesh."""
    at = motion.at(mesh.shares)
    knots = motion.at(mesh.knots[:-1])
    nodes = {key: np.vstack((knots[key], motion.nodes[key][-1])) for key in "qvz"}
    points: dict[str, Array] = {key: at[key] for key in "qvzawul"}
    points["d"] = steps_of(mesh, nodes["q"], points["q"], motion.bases)
    return PhaseMotion(mesh, motion.begin, motion.duration, nodes, points, motion.bases)


class _Watcher:
    """Says on a terminal how far the solver is, and ends what only goes to and fro.

    Where slopes jump at the best motion, steps go from one piece to the other for ever; another
    mesh has its points elsewhere.

    Args:
        round_: Number of the mesh.
        interruption: What ends the solver.
        has_pieces: Whether slopes of the equations may jump.

    Attributes:
        is_staying: Whether it has ended that.
    """

    def __init__(self, round_: int, interruption: Interruption, *, has_pieces: bool) -> None:
        self._round, self._interruption, self._due = round_, interruption, 0.0
        self._recent = deque[tuple[float, float]](maxlen=_STAYING) if has_pieces else None
        self.is_staying = False

    def __call__(self, iteration: int, progress: "Progress") -> bool:
        if self._recent is not None:
            self._recent.append(progress())
            costs, violations = np.array(self._recent).T
            is_alike = np.ptp(costs) <= _ALIKE * np.abs(costs).max() and violations.max() <= _NEAR
            self.is_staying = len(costs) == _STAYING and bool(is_alike)
        if time.monotonic() >= self._due:
            self._due = time.monotonic() + PERIOD
            cost, violation = progress()
            announce(
                f"predict: mesh {self._round + 1}, iteration {iteration}, cost {cost:.6g}, "
                f"violation {violation:.1e}"
            )
        return self._interruption.is_asked or self.is_staying
