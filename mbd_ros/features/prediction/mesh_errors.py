"""What a solution says of the mesh that it wants: where bounds begin, end and are passed."""

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.features.prediction.problem import Problem
from mbd_ros.features.prediction.task import PredictTask
from mbd_ros.optimal_control.bound_structure import bracketed, changes, is_settled, with_knots
from mbd_ros.optimal_control.error_estimate import beyond_bounds, looked_at
from mbd_ros.optimal_control.mesh import Mesh
from mbd_ros.optimal_control.refinement import refined

if TYPE_CHECKING:
    from mbd_ros.optimal_control.motion_program import Solution

SAVED = 0.03  # of the tolerance: what passing bounds between points may save of the cost
_PART = 0.1  # of what the worst bound of an interval saves: less does not matter


class Passing(NamedTuple):
    """A bound that is passed between nodes.

    Attributes:
        name: Of the quantity.
        side: -1 for the lower bound, 1 for the upper one.
        bound: The bound.
        time: Where it is passed furthest [s].
        by: How far there.
        relative: The same, relative to 1 + the largest value.
        saved: What all passing of this bound saves, of the cost.
        severity: The same, relative to what is accepted: too far above 1.
    """

    name: str
    side: int
    bound: float
    time: float
    by: float
    relative: float
    saved: float
    severity: float


class Look(NamedTuple):
    """What a solution says of the mesh that it wants.

    Attributes:
        knots: Where bounds of inputs change, as shares of the duration.
        status: Of bounds of states at the points.
        begins: The same at the first node of each interval.
        passed: Which intervals pass which bounds of states too far between their points, (n, k).
        passings: Bounds that are passed at all, the worst one first.
        is_settled: Whether every change of inputs is at a node that could move.
    """

    knots: list[float]
    status: Any
    begins: Any
    passed: Any
    passings: list[Passing]
    is_settled: bool


def accepted_passing(task: PredictTask) -> float:
    """How far a bound may be passed between nodes, relative to 1 + the largest value.

    Next to a bound whose multiplier is nearly zero a solution wavers by the root of the accuracy
    of the solver, on any mesh. What it saves is held against the tolerance apart from this.
    """
    return max(task.tolerance, math.sqrt(task.accuracy))


def look_at(problem: Problem, number: int, solution: "Solution", task: PredictTask) -> Look:
    """Look at the bounds of a phase.

    Bounds of states are passed too far where that is more than `accepted_passing`, or where it
    saves more than a share of the tolerance of the cost, by the multipliers of the bounds.
    """
    from mbd_ros.optimal_control.active_bounds import begins_of, path_forces, status_of

    phase, motion = problem.program.phases[number], solution.motions[number]
    unknowns, solved = solution.unknowns[number], solution.solved
    status, nu = status_of(phase, number, solution), motion.points["u"].shape[1]
    knots = changes(motion.mesh, status, motion.points["u"])
    shares, values = looked_at(motion)
    held = phase.held_between(unknowns, shares, values, solution.parameters)
    off = beyond_bounds(*held)
    places = np.hstack([unknowns.points[letter] for letter in "qvz"])
    sizes = 1.0 + np.abs(solved.x[places]).max(axis=0, initial=0.0)
    sizes = np.append(sizes, 1.0 + np.abs(held[0][:, len(sizes) :]).max(axis=0, initial=0.0))
    pulls = np.hstack((np.abs(solved.bound_forces[places]), path_forces(solution, number)))
    pulls = np.add.reduceat(pulls, motion.mesh.first_points[:-1], axis=0)
    saved = pulls * off / (abs(solved.cost) or 1.0)
    passed = (off / sizes > accepted_passing(task)) | _saving(saved, SAVED * task.tolerance)
    return Look(
        knots,
        status[:, nu:],
        begins_of(phase, number, solution),
        passed,
        _passings(phase, motion, held, sizes, saved, task),
        is_settled(motion.mesh, knots),
    )


def next_mesh(mesh: Mesh, errors: Array, look: Look, tolerance: float) -> Mesh:
    """A mesh on which errors are smaller."""
    if look.passed.any():
        wanted = look.passed | (errors > tolerance)[:, None]
        return bracketed(mesh, look.status, look.begins, wanted)
    return with_knots(refined(mesh, errors, tolerance), look.knots)


def _saving(saved: Array, most: float) -> Any:
    """Which bounds save too much in which intervals, shape (n, k)."""
    of_each = saved.sum(axis=1, keepdims=True)
    if of_each.sum() <= most:
        return np.zeros(saved.shape, dtype=np.bool_)
    rising = np.argsort(of_each[:, 0])
    is_left = np.cumsum(of_each[rising, 0]) <= most / 2.0
    matters = saved > _PART * saved.max(axis=1, keepdims=True)
    matters[rising[is_left]] = False
    return matters


def _passings(
    phase: Any, motion: Any, held: Any, sizes: Array, saved: Array, task: PredictTask
) -> list[Passing]:
    """Bounds that are passed, the worst one first."""
    values, lower, upper = held
    off = np.maximum(np.maximum(lower - values, values - upper), 0.0)
    shares, _ = looked_at(motion)
    found = list[Passing]()
    for k, name in enumerate(phase.names_held()):
        i = int(off[:, k].argmax())
        if off[i, k] > 0.0:
            side = 1 if values[i, k] > upper[k] else -1
            bound = float(upper[k] if side > 0 else lower[k])
            time = float(motion.begin + motion.duration * shares[i])
            by, cost = float(off[i, k]), float(saved[:, k].sum())
            relative = by / float(sizes[k])
            severity = max(relative / accepted_passing(task), cost / (SAVED * task.tolerance))
            found.append(Passing(name, side, bound, time, by, relative, cost, severity))
    return sorted(found, key=lambda one: -one.severity)
