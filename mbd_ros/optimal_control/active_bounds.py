"""What an optimum says: active bounds, and costates."""

from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.optimal_control.defects import COLLOCATION, MOTION
from mbd_ros.optimal_control.limits import PATH
from mbd_ros.optimal_control.mesh import Status
from mbd_ros.optimal_control.motion_phase import MotionPhase
from mbd_ros.optimal_control.motion_program import Solution
from mbd_ros.optimal_control.sparse_program import Block


class ActiveBound(NamedTuple):
    """A bound that is active.

    Attributes:
        name: Of the quantity.
        side: -1 for the lower bound, 1 for the upper one.
        share: Of the points of the phase.
    """

    name: str
    side: int
    share: float
    value: float


def active_bounds(phase: MotionPhase, number: int, solution: Solution) -> list[ActiveBound]:
    """Bounds that are active at some points of a phase."""
    status, unknowns = bound_status(phase, number, solution), solution.unknowns[number]
    ends = phase.bounds_on(unknowns, len(solution.solved.x))
    named = [
        (phase.quantities.name_of(letter, i), [one[places[0]] for one in ends])
        for letter in "uqvz"
        for i, places in enumerate(unknowns.points[letter].T)
    ]
    named += [(one.name, list(bounds)) for one, bounds in phase.derived_bounds]
    found = list[ActiveBound]()
    for (name, bounds), sides in zip(named, status.T, strict=True):
        for side, value in zip((-1, 1), bounds, strict=True):
            share = float(np.mean(sides == side))
            if share > 0.0:
                found.append(ActiveBound(name, side, share, float(value)))
    return found


def bound_status(phase: MotionPhase, number: int, solution: Solution) -> Status:
    """At every point: inputs, q, v, z, then quantities of `bounds` that are no unknowns.

    A bound is active where its multiplier is larger than what is left to it, both in usual sizes.
    """
    places = np.hstack([solution.unknowns[number].points[letter] for letter in "uqvz"])
    return np.hstack((_of_unknowns(phase, number, solution)[places], _of_rows(solution, number)))


def _of_unknowns(phase: MotionPhase, number: int, solution: Solution) -> Status:
    """Of all unknowns of a program."""
    unknowns, solved = solution.unknowns[number], solution.solved
    sizes, cost = solution.program.sizes, solution.program.cost_size
    lower, upper = phase.bounds_on(unknowns, len(solved.x))
    room = np.minimum(solved.x - lower, upper - solved.x) / sizes
    pull = np.abs(solved.bound_forces) * sizes / cost
    side = np.where(solved.x - lower < upper - solved.x, -1, 1)
    found: Status = np.where((pull > room) & (lower < upper), side, 0)
    return found


def _of_rows(solution: Solution, number: int) -> Status:
    """Of rows of `bounds`."""
    found = _rows_of_bounds(solution, number)
    if found is None:
        return np.zeros((len(solution.unknowns[number].points["q"]), 0), dtype=np.int_)
    block, rows = found
    shape = block.count, block.form.rows
    values = solution.solved.rows[rows].reshape(shape).T
    pulls = solution.solved.row_forces[rows].reshape(shape).T
    return _side(values, pulls * block.size / solution.program.cost_size, block).T


def _rows_of_bounds(solution: Solution, number: int) -> tuple[Block, slice] | None:
    program, seen = solution.program, -1
    for block, rows in zip(program.blocks, program.slices, strict=True):
        seen += block.name == MOTION
        if block.name == PATH and seen == number:
            return block, rows
    return None


def _side(values: Array, pulls: Array, block: Block) -> Status:
    lower, upper, size = block.lower, block.upper, block.size
    room = np.minimum(values - lower, upper - values) / size
    side = np.where(values - lower < upper - values, -1, 1)
    found: Status = np.where((np.abs(pulls) > room) & (lower < upper), side, 0)
    return found


def initial_status(phase: MotionPhase, number: int, solution: Solution) -> Status:
    """At the first node of every interval: q, v and z."""
    places = solution.unknowns[number].state[:-1]
    found: Status = _of_unknowns(phase, number, solution)[places]
    return found


def path_forces(solution: Solution, number: int) -> Array:
    """Sizes of multipliers of quantities of `bounds` that are no unknowns, shape (m, k)."""
    found = _rows_of_bounds(solution, number)
    if found is None:
        return np.zeros((len(solution.unknowns[number].points["q"]), 0))
    block, rows = found
    return np.abs(solution.solved.row_forces[rows]).reshape(block.count, block.form.rows)


def costates(solution: Solution, number: int) -> dict[str, Array]:
    """Derivatives of the cost by q, v and z at nodes, letter -> shape (n + 1, ..).

    A node is the beginning of the interval that follows, whose equations depend on it; the last
    one is the end of the last interval. Those of poses of free bodies are zero.
    """
    unknowns, forces = solution.unknowns[number], solution.solved.row_forces
    found, last = np.zeros(len(solution.solved.x)), unknowns.state[-1]
    program = solution.program
    for block, rows in zip(program.blocks, program.slices, strict=True):
        if block.name == COLLOCATION:
            own = -forces[rows].reshape(block.count, block.form.rows)
            found[block.places[0]] = own.sum(axis=1)
            ends = block.places[2 * block.form.rows - 1]
            is_last = np.isin(ends, last)
            found[ends[is_last]] = own[is_last, -1]
    return {letter: found[places] for letter, places in unknowns.nodes.items()}
