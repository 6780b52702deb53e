"""Entries of paths and their wraps -> paths, and the paths that parts name."""

import math
import typing
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

import pinocchio as pin

from mbd_ros.core.kinematics.paths.cylinder import Cylinder
from mbd_ros.core.kinematics.paths.ellipsoid import Ellipsoid
from mbd_ros.core.kinematics.paths.paths import JoinedPaths, JointPath, Path
from mbd_ros.core.kinematics.paths.point_path import path_through
from mbd_ros.core.kinematics.paths.polynomial_path import PolynomialPath
from mbd_ros.core.kinematics.paths.sphere import Sphere
from mbd_ros.core.kinematics.paths.torus import Torus
from mbd_ros.core.kinematics.paths.via_point import Interval, MovingViaPoint, ViaPoint
from mbd_ros.core.kinematics.paths.wrap_surface import Side, Surface, Wrap
from mbd_ros.core.model.coupling_functions import CouplingFunction, Linear, Polynomial
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Length, Positive, Unit, Unlimited, Vector
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.scene.reading.coupling_entries import one_function
from mbd_ros.scene.reading.single_entries import read_pose
from mbd_ros.scene.schema import schema

MAX_POINTS = 1000  # of one path
_SHAPES = ("cylinder", "sphere", "ellipsoid", "torus")


def path_of(robot: Robot, entry: Any, where: str) -> Path:
    """The path of an entry.

    Args:
        entry: `points` from end to end, perhaps with `wraps`; `joints` with radius or
            coefficients; `polynomial` of several joints; or some of these.
        where: File and key, for the messages.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    path: Path = schema.call(_path, entry, where, robot, where)
    return path


def _path(
    robot: Robot,
    where: str,
    *,
    points: Sequence[Any] | None = None,
    joints: Mapping[str, float | Sequence[float]] | None = None,
    wraps: Sequence[Any] | None = None,
    polynomial: Mapping[str, Any] | None = None,
) -> Path:
    if not points and not joints and not polynomial:
        raise ModelError("a path needs points, joints or polynomial")
    if len(points or ()) > MAX_POINTS:
        raise ModelError(f"{len(points or ())} points, accepted are {MAX_POINTS}")
    paths: list[Path] = []
    if points:
        listed = enumerate(points)
        via = [
            schema.call(_via, value, f"{where}.points[{i}]", robot, f"{where}.points[{i}]")
            for i, value in listed
        ]
        paths.append(path_through(robot, via, _wraps(robot, wraps, where) if wraps else ()))
    elif wraps:
        raise ModelError("wraps need points")
    if joints:
        paths.append(JointPath(robot, {name: _term(value) for name, value in joints.items()}))
    if polynomial:
        paths.append(schema.call(_polynomial, polynomial, f"{where}.polynomial", robot))
    return paths[0] if len(paths) == 1 else JoinedPaths(paths)


def _via(
    robot: Robot,
    where: str,
    *,
    frame: str,
    xyz: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
    moves: Any = None,
    within: Any = None,
) -> ViaPoint:
    interval = None if within is None else schema.call(_interval, within, f"{where}.within", robot)
    if moves is None:
        return ViaPoint(robot, frame, xyz, interval)
    joint, functions = schema.call(_moves, moves, f"{where}.moves", f"{where}.moves")
    return MovingViaPoint(robot, frame, xyz, joint, functions, interval)


def _interval(
    robot: Robot, *, joint: str, lower: Unlimited = -math.inf, upper: Unlimited = math.inf
) -> Interval:
    if not lower <= upper:
        raise ModelError(f"lower {lower:g} is above upper {upper:g}")
    return Interval(robot.joint(joint), lower, upper)


def _moves(
    where: str, *, joint: str, x: Any = None, y: Any = None, z: Any = None
) -> tuple[str, dict[str, CouplingFunction]]:
    factors = {
        axis: entry for axis, entry in zip("xyz", (x, y, z), strict=True) if entry is not None
    }
    if not factors:
        raise ModelError("give x, y or z as a function of the position of the joint")
    return joint, {
        axis: schema.call(one_function, entry, f"{where}.{axis}", f"{where}.{axis}")
        for axis, entry in factors.items()
    }


def _wraps(robot: Robot, wraps: Sequence[Any], where: str) -> Any:
    if len(wraps) > MAX_POINTS:
        raise ModelError(f"{len(wraps)} wraps, accepted are {MAX_POINTS}")
    return [read_wrap(robot, entry, f"{where}.wraps[{i}]") for i, entry in enumerate(wraps)]


def _term(coefficients: float | Sequence[float]) -> CouplingFunction:
    """Radius of a pulley [m], or coefficients of a polynomial."""
    return Linear(coefficients) if isinstance(coefficients, float) else Polynomial(coefficients)


def _polynomial(
    robot: Robot, *, joints: Mapping[str, Sequence[float]], terms: Sequence[Sequence[float]]
) -> Path:
    return PolynomialPath(robot, joints, terms)


def with_paths(
    part: type, entry: Mapping[str, Any], where: str, robot: Robot, known: Mapping[str, Path]
) -> dict[str, Any]:
    """An entry with paths in place of their names, for arguments annotated as `Path`.

    Args:
        part: The class that takes the entry.
        entry: What the file holds.
        where: File and key, for the messages.
        known: The paths of the scene by name.

    Raises:
        SceneError: An unknown name, or an entry that is no path.
    """
    hints, arguments = typing.get_type_hints(part.__init__), dict(entry)
    for key in arguments.keys() & hints.keys():
        value = arguments[key]
        if value is None or Path not in (hints[key], *typing.get_args(hints[key])):
            continue
        if isinstance(value, str) and value not in known:
            accepted = ", ".join(known) or "none: the scene has no `paths`"
            raise SceneError(f"{where}.{key}: no path '{value}', accepted: {accepted}")
        is_name = isinstance(value, str)
        arguments[key] = known[value] if is_name else path_of(robot, value, f"{where}.{key}")
    return arguments


def read_wrap(robot: Robot, entry: Any, where: str) -> Wrap:
    """A wrap: a frame, one surface and perhaps pose, side and range.

    Args:
        entry: What the file holds.
        where: File and key, for the messages.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    wrap: Wrap = schema.call(_wrap, entry, where, robot, where)
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
    surfaces = {"cylinder": cylinder, "sphere": sphere, "ellipsoid": ellipsoid, "torus": torus}
    shapes = {shape: value for shape, value in surfaces.items() if value is not None}
    if len(shapes) != 1:
        raise ModelError(f"give one of {', '.join(_SHAPES)}; got {', '.join(shapes) or 'none'}")
    ((shape, value),) = shapes.items()
    place = read_pose({} if pose is None else pose, f"{where}.pose")
    rpy = pin.rpy.matrixToRpy(pin.Quaternion(place[3:]).toRotationMatrix())
    surface = _surface(shape, value, side, f"{where}.{shape}")
    ends = None if between is None else (between[0], between[1])
    return Wrap(robot, name or shape, frame, surface, place[:3].tolist(), rpy.tolist(), ends)


def _surface(shape: str, size: Any, side: Side, where: str) -> Surface:
    if shape == "sphere":
        return Sphere(size, side)
    if shape == "ellipsoid":
        return Ellipsoid(size, side)
    made: Surface = schema.call(_cylinder if shape == "cylinder" else _torus, size, where, side)
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
