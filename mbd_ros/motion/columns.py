"""Columns of joints, free bodies and rows, and topics of a bag that hold them."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_ros.core.contracts.outputs import Output
from mbd_ros.core.kinematics.free_bases import world_pose
from mbd_ros.core.kinematics.poses import with_steady_signs
from mbd_ros.core.model.joints import Joint
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.names import without_multiplier
from mbd_ros.core.rows.constraint import Row
from mbd_ros.core.state import Array, BodyMotion
from mbd_ros.files.body_columns import motion_columns, residual_columns
from mbd_ros.files.table import Column
from mbd_ros.files.topics import by_member, joint_state_topic, odometry_topic

_UNITS = {  # quantity -> of a joint that turns, of one that slides
    "position": ("rad", "m"),
    "velocity": ("rad/s", "m/s"),
    "acceleration": ("rad/s^2", "m/s^2"),
}
_EFFORT = ("N·m", "N")


def joint_columns(joints: Sequence[Joint], quantity: str, values: Array) -> list[Column]:
    """Columns `<joint>.<quantity>`.

    Args:
        joints: The joints.
        quantity: position, velocity, acceleration; all else is a torque or force.
        values: Shape (n, len(joints)).
    """
    units = _UNITS.get(quantity, _EFFORT)
    return [
        Column(f"{joint.name}.{quantity}", column, units[joint.kind == "prismatic"])
        for joint, column in zip(joints, values.T, strict=True)
    ]


def body_columns(
    robot: Robot, motions: Sequence[tuple[Array, Array, Array | None]]
) -> list[Column]:
    """Columns of the free bodies.

    Args:
        robot: The robot.
        motions: Coordinates, velocity and acceleration of each body, in the order of time, shape
            (n, 7) and twice (n, 6); None for accelerations that nobody knows.
    """
    columns = []
    for base, (q, v, a) in zip(robot.bases, motions, strict=True):
        pose = with_steady_signs(world_pose(robot, q))
        columns += motion_columns(BodyMotion(base.name, pose, v, a), base.frame)
    return columns


def whole_bodies(
    robot: Robot, q: Array, v: Array, a: Array | None
) -> list[tuple[Array, Array, Array | None]]:
    """The free bodies in motions of all coordinates, for `body_columns`.

    Args:
        robot: The robot.
        q: Shape (n, nq).
        v: Shape (n, nv).
        a: Shape (n, nv).
    """
    return [
        (q[:, base.q], v[:, base.v], None if a is None else a[:, base.v]) for base in robot.bases
    ]


def carried_columns(robot: Robot, residual: Array) -> list[Column]:
    """Columns of what nothing carries of the free bodies; residual of shape (n, 6 k)."""
    parts = np.split(residual, len(robot.bases), axis=1) if robot.bases else []
    pairs = zip(robot.bases, parts, strict=True)
    return [c for base, part in pairs for c in residual_columns(base.name, base.frame, part)]


def body_topics(robot: Robot) -> dict[str, Any]:
    """Topics of a bag with the motion of free bodies, see `files.bags.bag_streams`."""
    return {f"/{odometry_topic(base.name)}": {"body": base.name} for base in robot.bases}


def state_topics(robot: Robot, quantities: Sequence[str]) -> dict[str, Any]:
    """Topics of a bag with joint states, one a robot, see `files.bags.bag_streams`.

    Args:
        robot: The robot.
        quantities: Those of `position`, `velocity` and `effort` that there are.
    """
    named = by_member([joint.name for joint in robot.joints], robot.members)
    if not any(named):
        return {f"/{joint_state_topic('')}": {quantity: quantity for quantity in quantities}}
    return {
        f"/{joint_state_topic(member)}": {
            quantity: {own: f"{name}.{quantity}" for own, name in joints.items()}
            for quantity in quantities
        }
        for member, joints in named.items()
    }


def output_columns(outputs: Sequence[Output], values: Array) -> list[Column]:
    """Columns of what parts show, multipliers first.

    Args:
        outputs: As `Showing` names them.
        values: Shape (n, len(outputs)).
    """
    return [
        Column(output.name, column, output.unit, output.frame)
        for output, column in zip(outputs, values.T, strict=True)
    ]


def force_topic(rows: Sequence[Row]) -> dict[str, Any]:
    """Topic of a bag with multipliers, see `files.bags.bag_streams`; none without rows.

    Args:
        rows: As `RowLayout` names them.
    """
    names = {without_multiplier(row.name): row.name for row in rows}
    return {"/constraint_forces": {"effort": names}} if names else {}


def command_columns(names: Sequence[str], commands: Array) -> list[Column]:
    """Columns `<name>.command`.

    Args:
        names: As `inputs.command_names` gives them.
        commands: Shape (n, len(names)).
    """
    pairs = zip(names, commands.T, strict=True)
    return [Column(f"{name}.command", column) for name, column in pairs]
