"""Columns of joints and rows, and what a result says of where it comes from."""

import platform
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from mbd_ros.core.model.joints import Joint
from mbd_ros.core.names import without_multiplier
from mbd_ros.core.outputs import Output
from mbd_ros.core.rows.constraint import Row
from mbd_ros.core.state import Array
from mbd_ros.files.recordings import name_of
from mbd_ros.files.table import Column, Result
from mbd_ros.scene.built_scene import Scene

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
    """Topic of a bag with multipliers, see `files.bag_streams`; none without rows.

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


def metadata_of(
    job: str, scene: Scene, inputs: Mapping[str, Any], topics: Mapping[str, Any]
) -> dict[str, Any]:
    """Metadata of a result.

    Args:
        job: Name of the command.
        scene: The scene.
        inputs: What the job was asked for; files by their names, None is left out.
        topics: Topics of a bag, see `bag_streams`.
    """
    given = {key: _plain(value) for key, value in inputs.items() if value is not None}
    return {
        "job": job,
        "scene": scene.name,
        "inputs": given,
        "versions": dict(_versions()),
        "topics": dict(topics),
    }


def _plain(value: Any) -> Any:
    if isinstance(value, Result):
        return {"job": value.metadata.get("job", ""), "inputs": value.metadata.get("inputs", {})}
    return value if isinstance(value, int | float | str | list | dict) else name_of(value)


@cache
def _versions() -> tuple[tuple[str, str], ...]:
    found = [("python", platform.python_version())]
    for package, name in (("mbd_ros", "mbd_ros"), ("pinocchio", "pin"), ("numpy", "numpy")):
        try:
            found.append((package, version(name)))
        except PackageNotFoundError:  # colcon and conda install without what pip knows
            found.append((package, "unknown"))
    return tuple(found)
