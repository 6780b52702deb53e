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


def path_of(robot: Robot, given: Any, where: str) -> Path:
    """The path of an entry.

    Args:
        given: `points` from end to end, perhaps with `wraps`; `joints` with radius or
            coefficients; `polynomial` of several joints; or some of these.
        where: File and key, for the messages.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    path: Path = schema.call(_path, given, where, robot, where)
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
        given = enumerate(points)
        via = [
            schema.call(_via, one, f"{where}.points[{i}]", robot, f"{where}.points[{i}]")
            for i, one in given
        ]
        paths.append(path_through(robot, via, _wraps(robot, wraps, where) if wraps else ()))
    elif wraps:
        raise ModelError("wraps need points")
    if joints:
        paths.append(JointPath(robot, {name: _term(one) for name, one in joints.items()}))
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
    given = {axis: one for axis, one in zip("xyz", (x, y, z), strict=True) if one is not None}
    if not given:
        raise ModelError("give x, y or z as a function of the position of the joint")
    return joint, {
        axis: schema.call(one_function, one, f"{where}.{axis}", f"{where}.{axis}")
        for axis, one in given.items()
    }


def _wraps(robot: Robot, wraps: Sequence[Any], where: str) -> Any:
    if len(wraps) > MAX_POINTS:
        raise ModelError(f"{len(wraps)} wraps, accepted are {MAX_POINTS}")
    return [read_wrap(robot, one, f"{where}.wraps[{i}]") for i, one in enumerate(wraps)]


def _term(given: float | Sequence[float]) -> CouplingFunction:
    """Radius of a pulley [m], or coefficients of a polynomial."""
    return Linear(given) if isinstance(given, float) else Polynomial(given)


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
    hints, found = typing.get_type_hints(part.__init__), dict(entry)
    for key in found.keys() & hints.keys():
        given = found[key]
        if given is None or Path not in (hints[key], *typing.get_args(hints[key])):
            continue
        if isinstance(given, str) and given not in known:
            accepted = ", ".join(known) or "none: the scene has no `paths`"
            raise SceneError(f"{where}.{key}: no path '{given}', accepted: {accepted}")
        is_name = isinstance(given, str)
        found[key] = known[given] if is_name else path_of(robot, given, f"{where}.{key}")
    return found


def read_wrap(robot: Robot, given: Any, where: str) -> Wrap:
    """A wrap: a frame, one surface and perhaps pose, side and range.

    Args:
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
