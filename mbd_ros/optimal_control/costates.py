"""What the cost gains where a state of a solution is changed: costates, at nodes."""

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.optimal_control.defects import COLLOCATION
from mbd_ros.optimal_control.motion_program import Solution


def costates(solution: Solution, number: int) -> dict[str, Array]:
    """Derivatives of the cost by q, v and z at nodes, letter -> shape (n + 1, ..).

    A node is the beginning of the interval that follows, whose equations depend on it; the last
    one is the end of the last interval. Those of poses of free bodies are zero.

    Args:
        solution: The solution.
        number: Of the phase.
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
