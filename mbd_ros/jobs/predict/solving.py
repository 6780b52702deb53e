"""A program solved on finer and finer meshes, until errors between nodes are small enough."""

import time
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbd_ros.core.prediction.error_estimate import beyond_bounds, errors_of, looked_at
from mbd_ros.core.prediction.mesh import Mesh
from mbd_ros.core.prediction.refinement import refined
from mbd_ros.core.prediction.structure import bracketed, changes, is_settled, with_knots
from mbd_ros.core.prediction.unknowns import PhaseMotion, steps_of
from mbd_ros.core.state import Array
from mbd_ros.jobs.lines import Say
from mbd_ros.jobs.predict.interruption import Interruption, interruptible
from mbd_ros.jobs.predict.problem import Problem
from mbd_ros.jobs.progress import PERIOD, announce
from mbd_ros.scene.predict_task import PredictTask

if TYPE_CHECKING:
    from mbd_ros.compiled.program.motion_program import Solution

_SAVED = 0.03  # of the tolerance: what passing bounds between points may save of the cost
STOPPED = "User_Requested_Stop"


class Found(NamedTuple):
    """A solution, or the last iterate.

    Attributes:
        problem: What was solved.
        solution: Of the last mesh.
        errors: Relative errors between nodes, of each interval of each phase.
        is_fine: Whether the errors are within the tolerance.
        iterations: On all meshes.
        lines: One a mesh, for people.
        is_interrupted: Whether somebody ended it between two meshes.
    """

    problem: Problem
    solution: "Solution"
    errors: list[Array]
    is_fine: bool
    iterations: int
    lines: list[str]
    is_interrupted: bool = False

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
        return _solve(problem, task, say, interruption)


def _solve(problem: Problem, task: PredictTask, say: Say, interruption: Interruption) -> Found:
    guesses, parameters, cost_size = list(problem.guesses), problem.parameters, 1.0
    total, lines, is_near = 0, list[str](), False
    for round_ in range(task.mesh.refinements + 1):
        solution = problem.program.solve(
            guesses,
            parameters,
            accuracy=task.accuracy,
            cost_size=cost_size,
            most=task.iterations,
            is_near=is_near,
            tell=_Watcher(round_, interruption),
        )
        solved = solution.solved
        total += solved.iterations
        errors = [
            error_of(phase, motion, solution.parameters)
            for phase, motion in zip(problem.program.phases, solution.motions, strict=True)
        ]
        worst = max(float(one.max(initial=0.0)) for one in errors)
        lines.append(mesh_line(round_, solution, worst))
        say(lines[-1])
        looks = [look_at(problem, i, solution, task.tolerance) for i in range(len(errors))]
        is_fine = worst <= task.tolerance and not any(one.passed.any() for one in looks)
        found = Found(problem, solution, errors, is_fine, total, lines)
        if (is_fine and all(one.is_settled for one in looks)) or not solved.is_good:
            return found
        if interruption.is_asked:
            return found._replace(is_fine=False, is_interrupted=True)
        guesses = [
            moved(motion, next_mesh(motion.mesh, error, look, task.tolerance))
            for motion, error, look in zip(solution.motions, errors, looks, strict=True)
        ]
        parameters = solution.parameters
        cost_size, is_near = abs(solved.cost) or 1.0, True
    return found


class Look(NamedTuple):
    """What a solution says of the mesh that it wants.

    Attributes:
        knots: Where bounds of inputs change, as shares of the duration.
        status: Of bounds of states at the points.
        passed: Which intervals pass bounds of states between their points.
        is_settled: Whether every change of inputs is at a node that could move.
    """

    knots: list[float]
    status: Any
    passed: Any
    is_settled: bool


def look_at(problem: Problem, number: int, solution: "Solution", tolerance: float) -> Look:
    """Look at the bounds of a phase.

    Bounds of states are passed too far where that is more than the tolerance, or where it saves
    more than a share of it of the cost, by the multipliers of the bounds.
    """
    from mbd_ros.compiled.program.active_bounds import path_forces, status_of

    phase, motion = problem.program.phases[number], solution.motions[number]
    unknowns, solved = solution.unknowns[number], solution.solved
    status, nu = status_of(phase, number, solution), motion.points["u"].shape[1]
    knots = changes(motion.mesh, status, motion.points["u"])
    shares, values = looked_at(motion)
    off = beyond_bounds(*phase.held_between(unknowns, shares, values, solution.parameters))
    places = np.hstack([unknowns.points[letter] for letter in "qvz"])
    sizes = 1.0 + np.abs(solved.x[places]).max(axis=0, initial=0.0)
    sizes = np.append(sizes, np.ones(off.shape[1] - len(sizes)))
    pulls = np.hstack((np.abs(solved.bound_forces[places]), path_forces(solution, number)))
    held = np.add.reduceat(pulls, motion.mesh.first_points[:-1], axis=0)
    saved = (held * off).sum(axis=1) / (abs(solved.cost) or 1.0)
    passed = (off / sizes).max(axis=1, initial=0.0) > tolerance
    if saved.sum() > _SAVED * tolerance:
        passed |= saved > _SAVED * tolerance / (2.0 * len(saved))
    return Look(knots, status[:, nu:], passed, is_settled(motion.mesh, knots))


def next_mesh(mesh: Mesh, errors: Array, look: Look, tolerance: float) -> Mesh:
    """A mesh on which errors are smaller."""
    if look.passed.any():
        return bracketed(mesh, look.status, look.passed | (errors > tolerance))
    return with_knots(refined(mesh, errors, tolerance), look.knots)


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
        found = phase.equations.solved(values, motion.begin + motion.duration * shares, p)
        return found["a"], found["w"]

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
    """Says on a terminal how far the solver is."""

    def __init__(self, round_: int, interruption: Interruption) -> None:
        self._round, self._interruption, self._due = round_, interruption, 0.0

    def __call__(self, iteration: int, cost: float, violation: float) -> bool:
        if time.monotonic() >= self._due:
            self._due = time.monotonic() + PERIOD
            announce(
                f"predict: mesh {self._round + 1}, iteration {iteration}, cost {cost:.6g}, "
                f"violation {violation:.1e}"
            )
        return self._interruption.is_asked
