"""Bounds of multipliers in a mode, and rows that all are at one: forces that are known."""

from collections.abc import Callable, Collection
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.kinematics.kinematics import Reads
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import Array, Mode, State

Pushing = Callable[[float, Array, Array, Array], Array]
"""Acceleration at t, q and v from the one without the rows."""


def is_idle(rows: ConstraintRows, at: NDArray[np.intp], mode: Mode) -> bool:
    """Whether no row acts in a mode, as far as that is known while building.

    Args:
        rows: Rows that give way.
        at: Which of them go from event to event, shape (n,).
        mode: Begins with one entry each of these.
    """
    return (
        len(mode) > 0
        and not rows.varies
        and all(way == 1 and rows.lower[i] == 0.0 for way, i in zip(mode, at, strict=False))
    )


def pushing(motion: Any, rows: ConstraintRows, at: NDArray[np.intp], mode: Mode) -> Pushing | None:
    """What adds the forces of rows at their bounds; None where one has to be solved for.

    Args:
        motion: The `FreeMotion` without rows that give way.
        rows: Rows that give way.
        at: Which of them go from event to event, shape (n,).
        mode: Begins with one entry each of these.
    """
    n = len(at)
    if len(rows.rows) > n or len(mode) < n or not all(mode[:n]):
        return None
    k, at_lower = motion.mechanism.k, np.array(mode[:n]) == 1
    pairs = zip(rows.parts, rows.slices, strict=True)
    known = np.where(at_lower, rows.lower, rows.upper)
    acting = [(part, mine) for part, mine in pairs if rows.varies or known[mine].any()]
    reads = max((part.reads for part, _ in acting), default=Reads.NOTHING)

    def pushed(t: float, q: Array, v: Array, a: Array) -> Array:
        joint_q, joint_v, joint_a = motion.joint_motion(q, v, a)
        x = State(t, joint_q, joint_v, motion.mechanism.z)
        k.refresh(joint_q, joint_v, reads)
        lam = known
        if rows.varies:
            rows.limit(k, x)
            lam = np.where(at_lower, rows.lower, rows.upper)
        force = sum(lam[mine].dot(part.jacobian(k, x)) for part, mine in acting)
        response = motion.respond(q, np.reshape(force, (-1, 1)))[:, 0]
        return cast(Array, motion.coordinates.integrated(joint_a + response))

    return pushed if acting else None


def bounds_in(
    rows: ConstraintRows, at: NDArray[np.intp], mode: Mode, free: Collection[int]
) -> tuple[Array, Array]:
    """Smallest and largest multipliers of all rows in a mode.

    Args:
        rows: Rows that give way.
        at: Which of them go from event to event, shape (n,).
        mode: Begins with one entry each of these.
        free: Those whose mode is looked for.
    """
    lower, upper = rows.lower.copy(), rows.upper.copy()
    for i, (row, way) in enumerate(zip(at, mode, strict=False)):
        if i in free:
            continue
        if way == 0:
            lower[row], upper[row] = -np.inf, np.inf
        elif way == 1:
            upper[row] = lower[row]
        else:
            lower[row] = upper[row]
    return lower, upper
