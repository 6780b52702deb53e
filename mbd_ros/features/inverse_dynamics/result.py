"""A result of inverse dynamics: its metadata, its check, and its error against measured efforts.

Metadata and check are the same for a motion that is read at once and for one that is read piece by
piece.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array, Motion
from mbd_ros.errors import DataError
from mbd_ros.files.table import TIME, Table
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import TorqueComponents
from mbd_ros.motion.filters import Rows, low_passed
from mbd_ros.motion.long_stamps import Windows
from mbd_ros.motion.recordings import metadata_of
from mbd_ros.motion.samples import Task
from mbd_ros.scene.built_scene import Scene


def result_metadata(scene: Scene, task: Task, topics: Mapping[str, object]) -> dict[str, Any]:
    """Return the metadata of a result of inverse dynamics.

    Args:
        scene: The scene.
        task: The motion, and what was computed.
        topics: Topics of a bag for open chains or loops; those of the causes are added.
    """
    source, cutoff, half_width = task.derivatives
    inputs = {
        "motion": task.motion,
        "wrenches": task.wrenches,
        "derivatives": source,
        "time_range": task.time_range and list(task.time_range),
        "external": task.external,
        "cutoff": cutoff,
        "half_width": half_width,
        **{name: getattr(task, name) for name in ("parts", "bounds", "power", "wrench_axes")},
        "stance": None if task.stance is None else task.stance.method,
    }
    causes = TorqueComponents._fields if task.parts else ()
    by_cause = {f"/joint_torques/{cause}": {"effort": cause} for cause in causes}
    metadata = metadata_of("inverse", scene, inputs, {**topics, **by_cause})
    return {**metadata, "stamps": "recorded"}


def check_finite(where: str, table: Table) -> None:
    """Refuse efforts and multipliers that are not finite."""
    kinds = ("position", "velocity", "acceleration", TIME, "stamp")
    forces = [v for name, v in table.items() if name.rpartition(".")[2] not in kinds]
    bad = [int(np.flatnonzero(~np.isfinite(v))[0]) for v in forces if not np.isfinite(v).all()]
    if bad:
        raise DataError(f"{where}: torques at {table[TIME][min(bad)]} s are not finite")


def effort_residual(motion: Motion, table: Table, cutoff: Array) -> Iterator[str]:
    """Yield a line about the error of torques against measured efforts, if there are any.

    Args:
        motion: Motion with measured efforts; joints without efforts are ignored.
        table: Table with the torques.
        cutoff: Cutoff of the low-pass filter for each of the first joints of the motion [Hz].
    """
    effort = motion.effort
    if effort is None or table.rows != len(motion.stamps):
        return
    pairs = measured_columns(
        motion.names[: len(cutoff)], list(table), np.isfinite(effort).all(axis=0)
    )
    if not pairs:
        return
    tau = [*(effort[:, j] for j, _ in pairs), *(table[name] for _, name in pairs)]
    cutoffs = cutoff[[j for j, _ in pairs]]
    windows = Windows(motion.stamps, cutoff)
    yield from residual_of_rows(windows, np.column_stack(tau), cutoffs)


def measured_columns(
    joints: Sequence[str], columns: Sequence[str], measured: NDArray[np.bool_]
) -> list[tuple[int, str]]:
    """Return the indices of joints with measured efforts, and the columns of their torques."""
    efforts = {name.removesuffix(".effort"): name for name in columns if name.endswith(".effort")}
    pairs = [(joints.index(joint), name) for joint, name in efforts.items() if joint in joints]
    return [(j, name) for j, name in pairs if measured[j]]


def residual_of_rows(windows: Windows, tau: Rows, cutoff: Array) -> Iterator[str]:
    """Yield a line with the norm of (torque - measured effort) over that of the efforts.

    Both pass the low-pass filter of the motion. There is no line if all efforts are 0.

    Args:
        windows: Windows of all stamps and cutoffs.
        tau: Measured efforts, then torques, of the same m joints, shape (n, 2 m).
        cutoff: Cutoff of the low-pass filter of each joint [Hz], shape (m,).
    """
    total, off = 0.0, 0.0
    for passed, step in low_passed(windows, tau, np.tile(cutoff, 2)):
        known, computed = np.split(passed, 2, axis=1)
        unit = max(np.abs(known).max(initial=0.0), np.abs(computed).max(initial=0.0))
        if not np.isfinite(unit):
            return
        if unit > 0.0:  # squares may overflow
            known, computed, weight = known / unit, computed / unit, unit * math.sqrt(step)
            total = math.hypot(total, weight * math.sqrt(np.square(known).sum()))
            off = math.hypot(off, weight * math.sqrt(np.square(computed - known).sum()))
    if total > 0.0 and math.isfinite(off):
        yield (
            f"off the measured effort by {100.0 * off / total:.3g} % (norm of differences over "
            "norm of efforts, all behind the same low-pass)"
        )
