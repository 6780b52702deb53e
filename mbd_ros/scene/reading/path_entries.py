"""Entries of paths -> paths, and the paths that parts name."""

import math
import typing
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from mbd_ros.core.model.coupling_functions import CouplingFunction, Linear, Polynomial
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.paths.paths import JoinedPaths, JointPath, Path
from mbd_ros.core.paths.point_path import path_through
from mbd_ros.core.paths.polynomial_path import PolynomialPath
from mbd_ros.core.paths.via_points import Interval, MovingViaPoint, ViaPoint
from mbd_ros.core.ranges import Unit, Unlimited, Vector
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.scene.reading.coupling_entries import one_function
from mbd_ros.scene.schema import schema

MAX_POINTS = 1000  # of one path


def path_of(robot: Robot, given: Any, where: str) -> Path:
    """The path of an entry.

    Args:
        robot: The robot.
        given: `points` from end to end, perhaps with `wraps`; `joints` with radius or
            coefficients; `polynomial` of several joints; or some of these.
        where: File and key, for the messages.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    path: Path = schema.call(_path, given, where, robot, where)
    return path


def with_paths(
    part: type, entry: Mapping[str, Any], where: str, robot: Robot, known: Mapping[str, Path]
) -> dict[str, Any]:
    """An entry with paths in place of their names, for arguments annotated as `Path`.

    Args:
        part: The class that takes the entry.
        entry: What the file holds.
        where: File and key, for the messages.
        robot: The robot.
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


def _polynomial(
    robot: Robot, *, joints: Mapping[str, Sequence[float]], terms: Sequence[Sequence[float]]
) -> Path:
    return PolynomialPath(robot, joints, terms)


def _wraps(robot: Robot, wraps: Sequence[Any], where: str) -> Any:
    from mbd_ros.scene.reading.wrap_entries import read_wrap

    if len(wraps) > MAX_POINTS:
        raise ModelError(f"{len(wraps)} wraps, accepted are {MAX_POINTS}")
    return [read_wrap(robot, one, f"{where}.wraps[{i}]") for i, one in enumerate(wraps)]


def _term(given: float | Sequence[float]) -> CouplingFunction:
    """Radius of a pulley [m], or coefficients of a polynomial."""
    return Linear(given) if isinstance(given, float) else Polynomial(given)


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


def _interval(
    robot: Robot, *, joint: str, lower: Unlimited = -math.inf, upper: Unlimited = math.inf
) -> Interval:
    if not lower <= upper:
        raise ModelError(f"lower {lower:g} is above upper {upper:g}")
    return Interval(robot.joint(joint), lower, upper)
