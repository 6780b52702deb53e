"""Constraints evaluated from frame placements and from the scene file.

It shares with the constraints that it checks only the names of links and joints, and the values
of coupling functions. Types that are not known here fall back on the residual of the part.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.applications.report.stability.scene_text import Entry, LoadedScene
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array, State
from mbd_ros.scene.built_scene import Scene

Rows = Callable[[Any, float, Array], Any]  # Pinocchio data with placements, t, q -> g, shape (m,)
Place = tuple[int, Any]  # joint that carries a frame, and where it is there


class JointRow(NamedTuple):
    """A bounded row on one joint: g = sign (q - end), w = g'' + kd g' + kp g.

    Attributes:
        q: Index of the joint in q.
        v: Index of the joint in v.
        ends: Lower and upper end; equal for one that is not a stop, None for friction.
        limits: Smallest and largest multiplier.
        gains: kp [1/s^2] and kd [1/s].
    """

    q: int
    v: int
    ends: tuple[float, float] | None
    limits: tuple[float, float]
    gains: tuple[float, float]

    def margin(self, x: State, a: Array) -> tuple[float, float]:
        """Sign of the row and w at a state with accelerations a."""
        kp, kd = self.gains
        q, v, sign = float(x.q[self.q]), float(x.v[self.v]), 1.0
        g = 0.0
        if self.ends is not None:
            lower, upper = self.ends
            ahead = q + kd / kp * v
            sign = 1.0 if ahead - lower <= upper - ahead else -1.0
            g = q - lower if sign > 0 else upper - q
        return sign, sign * float(a[self.v]) + kd * sign * v + kp * g


def bilateral_rows(loaded: LoadedScene) -> list[Rows]:
    """Couplings, then every constraint that holds whatever that takes."""
    scene, rows = loaded.scene, list[Rows]()
    if scene.couplings.dependent:
        rows.append(_couplings(scene))
    for entry, part in _constraints(loaded):
        if part.law.is_rigid:
            make = _KNOWN.get(entry["type"])
            rows.append(_own(scene.robot, part) if make is None else make(scene.robot, entry))
    return rows


def bounded_rows(loaded: LoadedScene) -> list[JointRow] | None:
    """Every row that gives way; None where one of them is of a type that is not known here."""
    rows: list[JointRow] = []
    for entry, part in _constraints(loaded):
        if part.law.is_rigid:
            continue
        if entry["type"] not in ("joint_stop", "dry_friction") or "joint" not in entry:
            return None
        rows.append(_bounded(loaded.scene.robot, entry))
    return rows


def _bounded(robot: Robot, entry: Entry) -> JointRow:
    joint = robot.joint(entry["joint"])
    if entry["type"] == "dry_friction":
        T, limit = entry.get("time_constant", 0.002), entry["limit"]
        return JointRow(joint.q, joint.v, None, (-limit, limit), (0.0, 1.0 / T))
    T = entry.get("time_constant", 0.01)
    ends = entry.get("lower", joint.lower), entry.get("upper", joint.upper)
    return JointRow(joint.q, joint.v, ends, (0.0, math.inf), (1.0 / T**2, 2.0 / T))


def _constraints(loaded: LoadedScene) -> list[tuple[Entry, Any]]:
    entries: Sequence[Entry] = loaded.entries.get("constraints") or []
    return list(zip(entries, loaded.scene.constraints, strict=True))


def _own(robot: Robot, part: Any) -> Rows:
    k, rest = Kinematics(robot), np.zeros(robot.model.nv)

    def rows(data: Any, t: float, q: Array) -> Any:
        k.refresh(q, rest, part.reads)
        return part.residual(k, State(t, q, rest))

    return rows


def _couplings(scene: Scene) -> Rows:
    links = scene.couplings.pairs

    def rows(data: Any, t: float, q: Array) -> Any:
        return [q[i.child_q] - i.function(float(q[i.parent_q]))[0] for i in links]

    return rows


def _place(robot: Robot, frame: str, point: Sequence[float], rpy: Sequence[float]) -> Place:
    link = robot.model.frames[robot.frame(frame)]
    there = pin.SE3(pin.rpy.rpyToMatrix(np.array(rpy, dtype=float)), np.array(point, dtype=float))
    return int(link.parentJoint), link.placement * there


def _end(robot: Robot, entry: Entry, end: str) -> Place:
    zero = (0.0, 0.0, 0.0)
    frame, point, rpy = (f"{key}_{end}" for key in ("frame", "point", "rpy"))
    return _place(robot, entry[frame], entry.get(point, zero), entry.get(rpy, zero))


def _at(data: Any, place: Place) -> Any:
    return data.oMi[place[0]] * place[1]


def _loop_closure(robot: Robot, entry: Entry) -> Rows:
    ends = [_end(robot, entry, end) for end in "ab"]
    chosen = ["xyz".index(axis) for axis in entry.get("directions", "xyz")]
    kind, axis = entry.get("kind", "point"), "xyz".index(entry.get("axis", "z"))
    across = [i for i in range(3) if i != axis]

    def rows(data: Any, t: float, q: Array) -> Any:
        a, b = (_at(data, place) for place in ends)
        seen = a.actInv(b)
        gap = seen.translation[chosen]
        if kind == "point":
            return gap
        turned = pin.log3(seen.rotation)
        if kind == "revolute":
            turned = np.cross(np.eye(3)[axis], seen.rotation[:, axis])[across]
        return np.concatenate((gap, turned))

    return rows


def _frame_anchor(robot: Robot, entry: Entry) -> Rows:
    zero = (0.0, 0.0, 0.0)
    held = _place(robot, entry["frame"], entry.get("point", zero), entry.get("rpy", zero))
    position, orientation = entry["position"] - robot.origin, entry.get("orientation")

    def rows(data: Any, t: float, q: Array) -> Any:
        place = _at(data, held)
        if orientation is None:
            return place.translation - position
        wanted = pin.rpy.rpyToMatrix(np.array(orientation, dtype=float))
        turned = pin.log3(place.rotation.dot(wanted.T))
        return np.concatenate((place.translation - position, turned))

    return rows


def _distance(robot: Robot, entry: Entry) -> Rows:
    ends, length = [_end(robot, entry, end) for end in "ab"], entry["distance"]

    def rows(data: Any, t: float, q: Array) -> Any:
        a, b = (_at(data, place).translation for place in ends)
        return [np.linalg.norm(b - a) - length]

    return rows


def _point_on_plane(robot: Robot, entry: Entry) -> Rows:
    zero = (0.0, 0.0, 0.0)
    point = _place(robot, entry["frame"], entry.get("point", zero), zero)
    plane = _place(robot, entry["plane_frame"], entry.get("plane_point", zero), zero)
    normal = np.array(entry["normal"], dtype=float)
    normal = normal / np.linalg.norm(normal)

    def rows(data: Any, t: float, q: Array) -> Any:
        return [normal.dot(_at(data, plane).actInv(_at(data, point)).translation)]

    return rows


def _screw(robot: Robot, entry: Entry) -> Rows:
    slider, turner = robot.joint(entry["joint"]).q, robot.joint(entry["parent"]).q
    lead, offset = entry["pitch"] / (2.0 * math.pi), entry.get("offset", 0.0)
    return lambda data, t, q: [q[slider] - lead * q[turner] - offset]


_KNOWN: Mapping[str, Callable[[Robot, Entry], Rows]] = {
    "loop_closure": _loop_closure,
    "frame_anchor": _frame_anchor,
    "distance": _distance,
    "point_on_plane": _point_on_plane,
    "screw": _screw,
}
