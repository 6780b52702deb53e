"""Columns of joints, free bodies and rows, and the axes they were recorded in."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import permutations, product
from typing import Any

import numpy as np

from mbd_ros.core.contracts import Output, without_multiplier
from mbd_ros.core.kinematics.poses import with_continuous_signs, world_pose
from mbd_ros.core.model.robot import Joint, Robot
from mbd_ros.core.rows.constraint import Row
from mbd_ros.core.state import Array, BodyMotion
from mbd_ros.errors import DataError
from mbd_ros.files.bag_paths import by_member, joint_state_topic, odometry_topic
from mbd_ros.files.body_columns import motion_columns, residual_columns
from mbd_ros.files.laboratory.markers import SCREEN
from mbd_ros.files.table import Column

_UNITS = {  # quantity -> of a joint that turns, of one that slides
    "position": ("rad", "m"),
    "velocity": ("rad/s", "m/s"),
    "acceleration": ("rad/s^2", "m/s^2"),
}
_EFFORT = ("N·m", "N")
_AS_RECORDED = "x,y,z"
_ACCEPTED = "accepted: three of x, y, z, -x, -y, -z, as x,z,-y, or screen"


def joint_columns(joints: Sequence[Joint], quantity: str, values: Array) -> list[Column]:
    """Return columns `<joint>.<quantity>`.

    Args:
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
    """Return columns of the free bodies.

    Args:
        motions: Coordinates, velocity and acceleration of each body, in the order of time, shape
            (n, 7) and twice (n, 6); None for accelerations that nobody knows.
    """
    columns = []
    for base, (q, v, a) in zip(robot.bases, motions, strict=True):
        pose = with_continuous_signs(world_pose(robot, q))
        columns += motion_columns(BodyMotion(base.name, pose, v, a), base.frame)
    return columns


def whole_bodies(
    robot: Robot, q: Array, v: Array, a: Array | None
) -> list[tuple[Array, Array, Array | None]]:
    """Return the motions of the free bodies from all coordinates, for `body_columns`.

    Args:
        q: Shape (n, nq).
        v: Shape (n, nv).
        a: Shape (n, nv).
    """
    return [
        (q[:, base.q], v[:, base.v], None if a is None else a[:, base.v]) for base in robot.bases
    ]


def carried_columns(robot: Robot, residual: Array) -> list[Column]:
    """Return columns of the residual wrenches of k free bodies; residual of shape (n, 6 k)."""
    parts = np.split(residual, len(robot.bases), axis=1) if robot.bases else []
    pairs = zip(robot.bases, parts, strict=True)
    return [c for base, part in pairs for c in residual_columns(base.name, base.frame, part)]


def state_topics(robot: Robot, quantities: Sequence[str]) -> dict[str, Any]:
    """Return the topics of a bag with joint states, one a robot, see `files.bags.bag_writer`.

    Args:
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
    """Return the topic of a bag with multipliers, see `files.bags.bag_writer`; none without rows.

    Args:
        rows: As `RowLayout` names them.
    """
    names = {without_multiplier(row.name): row.name for row in rows}
    return {"/constraint_forces": {"effort": names}} if names else {}


def command_columns(names: Sequence[str], commands: Array) -> list[Column]:
    """Return columns `<name>.command`.

    Args:
        names: As `inputs.command_names` gives them.
        commands: Shape (n, len(names)).
    """
    pairs = zip(names, commands.T, strict=True)
    return [Column(f"{name}.command", column) for name, column in pairs]


def body_topics(robot: Robot) -> dict[str, Any]:
    """Return the topics of a bag with the motion of free bodies, see `files.bags.bag_writer`."""
    return {f"/{odometry_topic(base.name)}": {"body": base.name} for base in robot.bases}


def axes_matrix(where: str, axes: str, screen: Sequence[str] = ()) -> Array:
    """Return the rotation from recorded axes to those of the scene, shape (3, 3).

    Args:
        where: File and option, for messages.
        axes: `x,z,-y` or the like; or `screen`.
        screen: Recorded axes to the right and upwards on a screen, as `+X`, `+Z`, which `screen`
            takes as x and y of the scene; empty where the recording does not say them.

    Raises:
        DataError: The axes are not valid or a mirror image, or the recording does not state its
            screen axes.
    """
    if axes == SCREEN:
        if not screen:
            raise DataError(f"{where} screen: it has no POINT:X_SCREEN, Y_SCREEN")
        axes = _right_handed(where, screen)
    names = [name.strip().lower().removeprefix("+") for name in axes.split(",")]
    if sorted(name.removeprefix("-") for name in names) != ["x", "y", "z"]:
        raise DataError(f"{where} {axes}: {_ACCEPTED}")
    rows = _rows(names)
    if np.linalg.det(rows) < 0.0:
        raise DataError(f"{where} {axes} is a mirror image; {_ACCEPTED}")
    return rows


def _right_handed(where: str, screen: Sequence[str]) -> str:
    """Return three axes, the last one perpendicular to the screen."""
    names = [name.strip().lower().removeprefix("+") for name in screen]
    remaining = set("xyz") - {name.removeprefix("-") for name in names}
    if len(remaining) != 1 or not all(name.removeprefix("-") in ("x", "y", "z") for name in names):
        recorded = ", ".join(screen)
        raise DataError(
            f"{where} screen: POINT:X_SCREEN, Y_SCREEN are {recorded}, accepted: +X, +Z"
        )
    last = remaining.pop()
    sign = "" if np.linalg.det(_rows([*names, last])) > 0.0 else "-"
    return ",".join([*names, sign + last])


def _rows(names: Sequence[str]) -> Array:
    """Return one unit vector per name."""
    rows = np.zeros((3, 3))
    for i, name in enumerate(names):
        rows[i, "xyz".index(name[-1])] = -1.0 if name.startswith("-") else 1.0
    return rows


def other_axes() -> Iterator[tuple[str, Array]]:
    """Yield all rotations by right angles except the identity, with their matrices."""
    for order, signs in product(permutations("xyz"), product(("", "-"), repeat=3)):
        names = [sign + axis for sign, axis in zip(signs, order, strict=True)]
        rows, axes = _rows(names), ",".join(names)
        if axes != _AS_RECORDED and np.linalg.det(rows) > 0.0:
            yield axes, rows
