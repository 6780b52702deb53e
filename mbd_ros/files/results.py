"""Torques and simulated motions into tables and bags."""

from pathlib import Path

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.files.csv import write_table
from mbd_ros.files.formats import is_bag
from mbd_ros.files.records import SimulationRecord, TorqueRecord


def write_torques(path: str | Path, torques: TorqueRecord) -> None:
    """Write a result as table or bag; nothing is left behind if that fails.

    A table has `<joint>.position`, `.velocity`, `.acceleration`, `.effort` and one column a part
    of the independent joints, and `<joint>.multiplier` of the dependent ones. A bag has JointState
    topics /joint_torques, /joint_torques/<part> and /constraint_forces (effort = multiplier), and
    no accelerations. Of a scene with loops there is the motion of all joints, in a bag as
    /joint_states, the effort of the actuated ones, and `<row>.multiplier` of every constraint row.

    Raises:
        DataError: A place that cannot be written to.
    """
    if is_bag(path):
        from mbd_ros.files.bag_recordings import write_bag_torques

        write_bag_torques(Path(path), torques)
        return
    motion = {f: getattr(torques, f) for f in ("position", "velocity", "acceleration")}
    efforts = {"effort": torques.effort, **torques.parts}
    driven = torques.joints if torques.driven is None else torques.driven
    columns = [f"{joint}.{field}" for field in motion for joint in torques.joints]
    columns += [f"{joint}.{field}" for field in efforts for joint in driven]
    columns += [f"{joint}.multiplier" for joint in torques.dependent]
    fields = (*motion.values(), *efforts.values())
    values = np.column_stack([torques.stamps / 1e9, *fields, torques.multiplier])
    columns, values = _with_commands(columns, values, torques)
    write_table(path, ["time", *columns], values)


def _with_commands(
    columns: list[str], values: Array, record: TorqueRecord | SimulationRecord
) -> tuple[list[str], Array]:
    if record.command is None:
        return columns, values
    commands = [f"{joint}.command" for joint in record.commanded]
    return [*columns, *commands], np.column_stack([values, record.command])


def write_simulation(path: str | Path, record: SimulationRecord) -> None:
    """Write a simulated motion as table or bag; nothing is left behind if that fails.

    A table has `<joint>.position`, `.velocity`, `.acceleration`, `.effort`, `<row>.multiplier`,
    `energy`, `drift.position` and `drift.velocity`. A bag has JointState topics /joint_states and
    /constraint_forces (effort = multiplier) and a Float64MultiArray /energy_and_drift.

    Raises:
        DataError: A place that cannot be written to.
    """
    if is_bag(path):
        from mbd_ros.files.bag_recordings import write_bag_simulation

        stamps = np.where(record.stamps == 0, 1, record.stamps)  # 0 means no stamp in ROS
        write_bag_simulation(Path(path), record._replace(stamps=stamps))
        return
    fields = ("position", "velocity", "acceleration", "effort")
    columns = [f"{joint}.{field}" for field in fields for joint in record.joints]
    columns += [f"{row}.multiplier" for row in record.rows]
    columns += ["energy", "drift.position", "drift.velocity"]
    motion = [getattr(record, field) for field in fields]
    values = np.column_stack([record.times, *motion, record.multiplier, record.balance])
    columns, values = _with_commands(columns, values, record)
    write_table(path, ["time", *columns], values)
