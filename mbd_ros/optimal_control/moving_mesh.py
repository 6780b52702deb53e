"""Nodes of a mesh that move with the motion: widths of intervals that are unknown."""

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.optimal_control.program_block import Block, Form
from mbd_ros.optimal_control.unknowns import Unknowns

NARROWEST = 1.0e-3  # of its width: what a node that moves leaves of an interval


def bound_widths(unknowns: Unknowns, lower: Array, upper: Array) -> None:
    """Write bounds of the widths: fixed, but beside nodes that may move."""
    mesh, free = unknowns.mesh, unknowns.mesh.free
    lower[unknowns.widths] = upper[unknowns.widths] = mesh.widths
    beside: NDArray[np.bool_] = free | np.concatenate(([False], free[:-1]))
    moving = np.flatnonzero(beside)
    lower[unknowns.widths[moving]] = NARROWEST * mesh.widths[moving]
    upper[unknowns.widths[moving]] = 1.0


def moving_knots(unknowns: Unknowns) -> list[Block]:
    """Intervals between nodes that stand keep their sum."""
    found, run = list[Block](), list[int]()
    for i, moves in enumerate(unknowns.mesh.free):
        run.append(i)
        if not moves and len(run) > 1:
            x = ca.SX.sym("w", len(run))
            total = float(unknowns.mesh.widths[run].sum())
            form = Form(x, ca.SX(0, 1), ca.sum1(x))
            found.append(Block("knots", form, unknowns.widths[run][:, None], None, total, total))
        run = run if moves else []
    return found
