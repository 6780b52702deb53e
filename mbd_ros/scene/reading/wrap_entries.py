"""Entries of wraps of a path -> surfaces on links."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import pinocchio as pin

from mbd_ros.core.model.robot import Robot
from mbd_ros.core.paths.wrapping.cylinder import Cylinder
from mbd_ros.core.paths.wrapping.ellipsoid import Ellipsoid
from mbd_ros.core.paths.wrapping.sphere import Sphere
from mbd_ros.core.paths.wrapping.surface import Side, Surface
from mbd_ros.core.paths.wrapping.torus import Torus
from mbd_ros.core.paths.wrapping.wrapped_path import Wrap
from mbd_ros.core.ranges import Length, Positive, Unit
from mbd_ros.errors import ModelError
from mbd_ros.scene.reading.pose_entry import read_pose
from mbd_ros.scene.schema import schema

_SHAPES = ("cylinder", "sphere", "ellipsoid", "torus")


def read_wrap(robot: Robot, given: Any, where: str) -> Wrap:
    """A wrap: a frame, one surface and perhaps pose, side and range.

    Args:
        robot: The robot.
        given: What the file holds.
        where: File and key, for the messages.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    wrap: Wrap = schema.call(_wrap, given, where, robot, where)
    return wrap


def _wrap(
    robot: Robot,
    where: str,
    *,
    frame: str,
    name: str = "",
    cylinder: Any = None,
    sphere: Annotated[Positive, Unit("m")] | None = None,
    ellipsoid: Annotated[Sequence[Positive], Length(3), Unit("m")] | None = None,
    torus: Any = None,
    pose: Any = None,
    side: Side = "all",
    between: Annotated[Sequence[int], Length(2)] | None = None,
    method: Literal["hybrid", "midpoint", "axial"] = "hybrid",
) -> Wrap:
    given = {"cylinder": cylinder, "sphere": sphere, "ellipsoid": ellipsoid, "torus": torus}
    shapes = {shape: value for shape, value in given.items() if value is not None}
    if len(shapes) != 1:
        raise ModelError(f"give one of {', '.join(_SHAPES)}; got {', '.join(shapes) or 'none'}")
    ((shape, value),) = shapes.items()
    place = read_pose({} if pose is None else pose, f"{where}.pose")
    rpy = pin.rpy.matrixToRpy(pin.Quaternion(place[3:]).toRotationMatrix())
    surface = _surface(shape, value, side, f"{where}.{shape}")
    ends = None if between is None else (between[0], between[1])
    return Wrap(robot, name or shape, frame, surface, place[:3].tolist(), rpy.tolist(), ends)


def _surface(shape: str, given: Any, side: Side, where: str) -> Surface:
    if shape == "sphere":
        return Sphere(given, side)
    if shape == "ellipsoid":
        return Ellipsoid(given, side)
    made: Surface = schema.call(_cylinder if shape == "cylinder" else _torus, given, where, side)
    return made


def _cylinder(
    side: Side,
    *,
    radius: Annotated[Positive, Unit("m")],
    length: Annotated[Positive, Unit("m")],
) -> Cylinder:
    return Cylinder(radius, length, side)


def _torus(
    side: Side, *, inner: Annotated[Positive, Unit("m")], outer: Annotated[Positive, Unit("m")]
) -> Torus:
    if not inner < outer:
        raise ModelError(f"inner {inner:g} is not below outer {outer:g}")
    return Torus(inner, outer, side)
