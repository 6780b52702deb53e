"""Rows that give way in steps of velocities, what solves for them, and how rows come back."""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.rows.row_layout import RowBlock
from mbd_ros.core.state import Array
from mbd_ros.core.time_stepping.bounded_rows import GivingWay
from mbd_ros.core.time_stepping.unilateral_rows import StepRows


def rows_of_step(
    system: System, mechanism: Mechanism, rows: ConstraintRows, theta: float
) -> tuple[StepRows, GivingWay]:
    """The rows that give way in steps, and what solves for them."""
    if not rows.cones:
        return StepRows(mechanism, rows), GivingWay(rows)
    from mbd_ros.core.time_stepping.contact_screening import NearContacts
    from mbd_ros.core.time_stepping.contact_solver import ContactsInStep

    is_whole = system.nv == system.model.nv
    return NearContacts(mechanism, rows, is_whole), ContactsInStep(rows, theta)


def returns(blocks: Sequence[RowBlock], gains: tuple[float, float] | None = None) -> Array:
    """Rates [1/s] with which rows come back to 0, kp / kd, one a row; 0 without gains."""
    found = [np.zeros(0)]
    for block in blocks:
        kp, kd = (np.broadcast_to(gain, len(block.rows)) for gain in gains or block.gains)
        found.append(np.divide(kp, kd, out=np.zeros(len(kp)), where=kd > 0.0))
    return np.concatenate(found)
