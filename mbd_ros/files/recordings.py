"""Motions and wrenches from tables and bags: one meaning for both."""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array, Motion, WrenchSamples
from mbd_ros.errors import DataError
from mbd_ros.files.bag_paths import is_bag
from mbd_ros.files.records import Recording
from mbd_ros.files.tables import Table, read_table

TIME_LIMIT = 9e9  # s: int64 nanoseconds end at 9.22e9 s


def read_motion(
    path: str | Path,
    joints: Sequence[str],
    *,
    topic: str = "/joint_states",
    required: Collection[str] | None = None,
) -> Recording:
    """Samples of the joints asked for; others in the file are ignored.

    A bag message is dropped, and counted, if it is malformed, if a required joint lacks a finite
    position, or if its stamp is not newer than all before it. Velocities and efforts that are not
    finite are absent. One zero stamp makes all stamps those of the log.

    Args:
        path: Table with columns `<joint>.position`, `.velocity`, `.acceleration`, `.effort`,
            `.command`, or a bag, which has no commands.
        joints: Names, in the order of the columns of the motion.
        topic: JointState topic of a bag.
        required: Joints whose position must be there; all without it. The others may be NaN.

    Raises:
        DataError: A file that cannot be read, a required joint that is nowhere in it, or nothing
            usable on the topic.
    """
    needed = [name for name in joints if required is None or name in required]
    if is_bag(path):
        from mbd_ros.files.bag_recordings import bag_motion

        return bag_motion(Path(path), joints, topic, needed)
    table = read_table(path)
    _check_columns(table, [f"{name}.position" for name in needed])
    position, velocity, acceleration, effort, command = (
        _columns(table, [f"{name}.{field}" for name in joints])
        for field in ("position", "velocity", "acceleration", "effort", "command")
    )
    if position is None:
        position = np.full((len(table.values), len(joints)), np.nan)
    fields = position, velocity, acceleration, effort, command
    motion = Motion(tuple(joints), _stamps(table), *fields)
    return Recording(motion, Counter())


def _check_columns(table: Table, names: Iterable[str]) -> None:
    """Raise DataError that lists the columns a table lacks, and those it has."""
    lacking = [name for name in names if name not in table.columns]
    if lacking:
        raise DataError(
            f"{table.path}: no column {', '.join(lacking)}; there are: {', '.join(table.columns)}"
        )


def _stamps(table: Table) -> NDArray[np.int64]:
    """Column time as stamps [ns], shape (n,).

    Raises:
        DataError: Times outside of int64 nanoseconds, or equal when rounded to them.
    """
    time = table.values[:, 0]
    if np.abs(time[[0, -1]]).max() > TIME_LIMIT:
        raise DataError(f"{table.path}: column time: beyond {TIME_LIMIT:g} s")
    stamps = np.round(time * 1e9).astype(np.int64)
    if (np.diff(stamps) <= 0).any():
        line = np.flatnonzero(np.diff(stamps) <= 0)[0] + 3
        raise DataError(f"{table.path}: line {line}, column time: less than 1 ns after the last")
    return stamps


def _columns(table: Table, names: list[str]) -> Array | None:
    """The named columns, NaN where the table has none; None where it has none of them."""
    place = {column: i for i, column in enumerate(table.columns)}
    if not any(name in place for name in names):
        return None
    values = np.full((len(table.values), len(names)), np.nan)
    for i, name in enumerate(names):
        if name in place:
            values[:, i] = table.values[:, place[name]]
    return values


def read_wrenches(
    path: str | Path,
    names: Mapping[str, str | None],
    *,
    dropped: Counter[str] | None = None,
) -> dict[str, WrenchSamples]:
    """Measured wrench of every load, about the origin of the frame it is given in.

    In a table, columns `<name>.point.{x,y,z}` make the force act there: the torque about the
    origin is torque + point x force. A point may be `nan`, which counts where there is force.

    Args:
        path: Table with columns `<name>.force.{x,y,z}` [N], `<name>.torque.{x,y,z}` [N·m], and
            perhaps `<name>.point.{x,y,z}` [m], or a bag.
        names: Loads, each with its WrenchStamped topic, which only a bag needs.
        dropped: Messages of a bag that are left out are counted here by reason: not finite, or
            not newer than all before them.

    Raises:
        DataError: A file that cannot be read, a missing column or topic, or nothing usable on it.
    """
    if not names:
        return {}
    if is_bag(path):
        from mbd_ros.files.bag_recordings import bag_wrenches

        return bag_wrenches(Path(path), names, Counter() if dropped is None else dropped)
    points = {f"{name}.point.{axis}" for name in names for axis in "xyz"}
    table = read_table(path, points.__contains__)
    stamps = _stamps(table)
    return {name: WrenchSamples(stamps, _wrench(table, name)) for name in names}


def _wrench(table: Table, name: str) -> Array:
    fields = ["force", "torque"]
    if any(column.startswith(f"{name}.point.") for column in table.columns):
        fields.append("point")
    columns = [f"{name}.{field}.{axis}" for field in fields for axis in "xyz"]
    _check_columns(table, columns)
    values = table.values[:, [table.columns.index(column) for column in columns]]
    if len(fields) == 2:
        return values
    force, torque, point = values[:, :3], values[:, 3:6], values[:, 6:]
    pushed = (force != 0).any(axis=1)
    torque[pushed] += np.cross(point[pushed], force[pushed])
    return values[:, :6]
