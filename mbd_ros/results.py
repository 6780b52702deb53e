"""Torques into tables and bags."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.recordings import is_bag
from mbd_ros.tables import write_table


class TorqueRecord(NamedTuple):
    """Result of inverse dynamics over a motion of n samples.

    Attributes:
        stamps: [ns], shape (n,), int64.
        joints: Names of the independent joints.
        position: [rad or m], shape (n, len(joints)).
        velocity: [rad/s or m/s], same shape.
        acceleration: [rad/s^2 or m/s^2], same shape.
        effort: Torque or force of the independent joints [N·m or N], same shape.
        dependent: Names of the dependent joints.
        multiplier: Their coupling torque or force [N·m or N], shape (n, len(dependent)).
        parts: Shares of `effort` by name (gravity, coriolis, ...), each of its shape.
    """

    stamps: NDArray[np.int64]
    joints: tuple[str, ...]
    position: Array
    velocity: Array
    acceleration: Array
    effort: Array
    dependent: tuple[str, ...]
    multiplier: Array
    parts: Mapping[str, Array] = MappingProxyType({})


def write_torques(path: str | Path, torques: TorqueRecord) -> None:
    """Write a result as table or bag; nothing is left behind if that fails.

    A table has `<joint>.position`, `.velocity`, `.acceleration`, `.effort` and one column a part
    of the independent joints, and `<joint>.multiplier` of the dependent ones. A bag has JointState
    topics /joint_torques, /joint_torques/<part> and /constraint_forces (effort = multiplier), and
    no accelerations.

    Raises:
        DataError: A place that cannot be written to.
    """
    if is_bag(path):
        from mbd_ros.bag_recordings import write_bag_torques

        write_bag_torques(Path(path), torques)
        return
    fields = {
        **{f: getattr(torques, f) for f in ("position", "velocity", "acceleration", "effort")},
        **torques.parts,
    }
    columns = [f"{joint}.{field}" for field in fields for joint in torques.joints]
    columns += [f"{joint}.multiplier" for joint in torques.dependent]
    values = np.column_stack([torques.stamps / 1e9, *fields.values(), torques.multiplier])
    write_table(path, ["time", *columns], values)
