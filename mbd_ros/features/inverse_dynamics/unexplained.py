"""How far torques are off the measured ones, both behind the low-pass of the motion."""

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array, Motion
from mbd_ros.files.table import Table
from mbd_ros.motion.long_stamps import Windows
from mbd_ros.motion.zero_phase import Rows, low_passed


def unexplained(motion: Motion, table: Table, cutoff: Array) -> Iterator[str]:
    """A line, where the motion has measured efforts.

    Args:
        motion: With the measured efforts; joints without are left out.
        table: With the torques.
        cutoff: Of the low-pass of each of the first joints of the motion [Hz].
    """
    effort = motion.effort
    if effort is None or table.rows != len(motion.stamps):
        return
    pairs = driven(motion.names[: len(cutoff)], list(table), np.isfinite(effort).all(axis=0))
    if not pairs:
        return
    tau = [*(effort[:, j] for j, _ in pairs), *(table[name] for _, name in pairs)]
    windows, own = Windows(motion.stamps, cutoff), cutoff[[j for j, _ in pairs]]
    yield from off_the_effort(windows, np.column_stack(tau), own)


def driven(
    joints: Sequence[str], columns: Sequence[str], measured: NDArray[np.bool_]
) -> list[tuple[int, str]]:
    """Joints whose effort is measured, by their place, and the columns of their torque."""
    ours = [name for name in columns if name.endswith(".effort")]
    pairs = [(name.removesuffix(".effort"), name) for name in ours]
    found = [(joints.index(joint), name) for joint, name in pairs if joint in joints]
    return [(j, name) for j, name in found if measured[j]]


def off_the_effort(windows: Windows, tau: Rows, cutoff: Array) -> Iterator[str]:
    """A line, where measured efforts are not 0.

    Args:
        windows: Of all stamps and the cut-offs.
        tau: Measured efforts, then torques, of the same m joints, shape (n, 2 m).
        cutoff: Of the low-pass of each joint [Hz], shape (m,).
    """
    total, off = 0.0, 0.0
    for passed, step in low_passed(windows, tau, np.tile(cutoff, 2)):
        known, found = np.split(passed, 2, axis=1)
        unit = max(np.abs(known).max(initial=0.0), np.abs(found).max(initial=0.0))
        if not np.isfinite(unit):
            return
        if unit > 0.0:  # squares may overflow
            known, found, weight = known / unit, found / unit, unit * math.sqrt(step)
            total = math.hypot(total, weight * math.sqrt(np.square(known).sum()))
            off = math.hypot(off, weight * math.sqrt(np.square(found - known).sum()))
    if total > 0.0 and math.isfinite(off):
        yield (
            f"off the measured effort by {100.0 * off / total:.3g} % (norm of differences over "
            "norm of efforts, all behind the same low-pass)"
        )
