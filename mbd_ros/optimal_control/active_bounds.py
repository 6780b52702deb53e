"""Active bounds and costates of an optimum."""

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
        name: Name of the quantity.
        side: -1 for the lower bound, 1 for the upper one.
        share: Share of the points of the phase at which it is active.
        value: The bound.
    """

    name: str
    side: int
    share: float
    value: float


def active_bounds(phase: MotionPhase, number: int, solution: Solution) -> list[ActiveBound]:
    """Return the bounds that are active at some points of a phase."""
    status, unknowns = bound_status(phase, number, solution), solution.unknowns[number]
    ends = phase.bounds_on(unknowns, len(solution.solved.x))
    named = [
        (phase.quantities.name_of(letter, i), [end[places[0]] for end in ends])
        for letter in "uqvz"
        for i, places in enumerate(unknowns.points[letter].T)
    ]
    named += [(quantity.name, list(bounds)) for quantity, bounds in phase.derived_bounds]
    active = list[ActiveBound]()
    for (name, bounds), sides in zip(named, status.T, strict=True):
        for side, value in zip((-1, 1), bounds, strict=True):
            share = float(np.mean(sides == side))
            if share > 0.0:
                active.append(ActiveBound(name, side, share, float(value)))
    return active


def bound_status(phase: MotionPhase, number: int, solution: Solution) -> Status:
    """Return the status at every point: inputs, q, v, z, then quantities that are not unknowns.

    A bound is active where its multiplier is larger than the distance to it, both scaled.
    """
    places = np.hstack([solution.unknowns[number].points[letter] for letter in "uqvz"])
    return np.hstack((_of_unknowns(phase, number, solution)[places], _of_rows(solution, number)))


def _of_unknowns(phase: MotionPhase, number: int, solution: Solution) -> Status:
    """Return the status of all unknowns of a program."""
    unknowns, solved = solution.unknowns[number], solution.solved
    sizes, cost = solution.program.sizes, solution.program.cost_size
    lower, upper = phase.bounds_on(unknowns, len(solved.x))
    room = np.minimum(solved.x - lower, upper - solved.x) / sizes
    pull = np.abs(solved.bound_forces) * sizes / cost
    side = np.where(solved.x - lower < upper - solved.x, -1, 1)
    status: Status = np.where((pull > room) & (lower < upper), side, 0)
    return status


def _of_rows(solution: Solution, number: int) -> Status:
    """Return the status of the rows of path bounds."""
    path = _rows_of_bounds(solution, number)
    if path is None:
        return np.zeros((len(solution.unknowns[number].points["q"]), 0), dtype=np.int_)
    block, rows = path
    shape = block.count, block.form.rows
    values = solution.solved.rows[rows].reshape(shape).T
    pulls = solution.solved.row_forces[rows].reshape(shape).T
    return _side(values, pulls * block.size / solution.program.cost_size, block).T


def _rows_of_bounds(solution: Solution, number: int) -> tuple[Block, slice] | None:
    program, phase = solution.program, -1
    for block, rows in zip(program.blocks, program.slices, strict=True):
        phase += block.name == MOTION
        if block.name == PATH and phase == number:
            return block, rows
    return None


def _side(values: Array, pulls: Array, block: Block) -> Status:
    lower, upper, size = block.lower, block.upper, block.size
    room = np.minimum(values - lower, upper - values) / size
    side = np.where(values - lower < upper - values, -1, 1)
    status: Status = np.where((np.abs(pulls) > room) & (lower < upper), side, 0)
    return status


def initial_status(phase: MotionPhase, number: int, solution: Solution) -> Status:
    """Return the status of q, v and z at the first node of every interval."""
    places = solution.unknowns[number].state[:-1]
    status: Status = _of_unknowns(phase, number, solution)[places]
    return status


def path_forces(solution: Solution, number: int) -> Array:
    """Return absolute multipliers of bounded quantities that are not unknowns, shape (m, k)."""
    path = _rows_of_bounds(solution, number)
    if path is None:
        return np.zeros((len(solution.unknowns[number].points["q"]), 0))
    block, rows = path
    return np.abs(solution.solved.row_forces[rows]).reshape(block.count, block.form.rows)


def costates(solution: Solution, number: int) -> dict[str, Array]:
    """Return the derivatives of the cost by q, v and z at nodes, letter -> (n + 1, ..).

    A node is the beginning of the next interval, whose equations depend on it; the last node is
    the end of the last interval. Costates of poses of free bodies are zero.
    """
    unknowns, forces = solution.unknowns[number], solution.solved.row_forces
    values, last = np.zeros(len(solution.solved.x)), unknowns.state[-1]
    program = solution.program
    for block, rows in zip(program.blocks, program.slices, strict=True):
        if block.name == COLLOCATION:
            multipliers = -forces[rows].reshape(block.count, block.form.rows)
            values[block.places[0]] = multipliers.sum(axis=1)
            ends = block.places[2 * block.form.rows - 1]
            is_last = np.isin(ends, last)
            values[ends[is_last]] = multipliers[is_last, -1]
    return {letter: values[places] for letter, places in unknowns.nodes.items()}
