"""Checks of motion by the laws of mechanics, beside the code that computed it.

M a + h - tau - J' lam = 0    by Newton-Euler (rnea), J by differences of g
g'' = 0                       by differences of g along q + s v + s^2 a / 2
lower <= lam <= upper, w lam  of bounded rows
E(t) - E(0) = work            of everything but gravity and joint springs, by quadrature
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.applications.report.stability.scene_text import Entry, LoadedScene
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import NONE, Array, State
from mbd_ros.scene.built_scene import Scene

Rows = Callable[[Any, float, Array], Any]  # Pinocchio data with placements, t, q -> g, shape (m,)
Place = tuple[int, Any]  # joint that carries a frame, and where it is there
_STEP = 1.0e-6  # rad or m, of central differences
_BALANCE = 1.0e-6  # of the terms of an equation of motion; differences of g leave 1e-9
_ROUNDED = 1.0e-8  # of the largest terms, within which small ones drown: times `_BALANCE`
_NOISE = 1.0e-3  # error of J by differences, in `_BALANCE`
_SECOND = 1.0e-5  # of the terms of g''
_FAR = 4.0e-3  # of the time in which a joint moves by one: truncation and rounding are alike
_COMPLEMENTARY = 1.0e-6
_STENCIL = ((-2, -1.0), (-1, 16.0), (0, -30.0), (1, 16.0), (2, -1.0))  # twelfths


class Oracle:
    """The equations of a scene, evaluated independently."""

    def __init__(self, loaded: LoadedScene) -> None:
        self.robot = loaded.scene.robot
        self._model, self._data = self.robot.model, self.robot.model.createData()
        self._rows, self._bounded = bilateral_rows(loaded), bounded_rows(loaded)
        self._forces = OracleForces(loaded)

    def residual(self, t: float, q: Array) -> Array:
        """Residual g of couplings and bilateral constraints, shape (m,)."""
        pin.forwardKinematics(self._model, self._data, q)
        return np.concatenate([[], *(rows(self._data, t, q) for rows in self._rows)])

    def violation(self, x: State) -> float:
        """Largest |g| [m or rad]."""
        return float(np.abs(self.residual(x.t, x.q)).max(initial=0.0)) if self._rows else 0.0

    def rate(self, x: State) -> float:
        """Largest |g'| [m/s or rad/s]."""
        if not self._rows:
            return 0.0
        s = _STEP / max(1.0, float(np.abs(x.v).max()))
        change = self._along(x, x.v, s) - self._along(x, x.v, -s)
        return float(np.abs(change).max()) / (2.0 * s)

    def energy(self, x: State) -> tuple[float, float]:
        """Kinetic and stored potential energy [J]."""
        return self._forces.stored(x)

    def power(self, system: System, y: State) -> float:
        """Work that everything but gravity and joint springs does per time [W].

        Args:
            system: The system that solves for the multipliers.
            y: State of its integrated coordinates.
        """
        x, (a, lam, bounded) = system.expand(y), self._solved(system, y)
        power = float(self._forces.not_stored(x).dot(x.v))
        if self._rows:
            s = _STEP / max(1.0, float(np.abs(x.v).max()))
            moved = self._along(x, x.v, s, x.t) - self._along(x, x.v, -s, x.t)
            power += float(lam.dot(moved)) / (2.0 * s)
        for row, value in zip(self._bounded or (), bounded, strict=False):
            power += row.margin(x, a)[0] * value * float(x.v[row.v])
        return power

    def complaints(self, system: System, y: State) -> list[str]:
        """Faults of the accelerations and multipliers that a system finds.

        Args:
            y: Consistent state of its integrated coordinates.
        """
        x, (a, lam, bounded) = system.expand(y), self._solved(system, y)
        if not (np.isfinite(a).all() and np.isfinite(lam).all() and np.isfinite(bounded).all()):
            return ["accelerations or multipliers are not finite"]
        found = [self._row_motion(x, a)] if self._rows else []
        if self._bounded is not None:
            found += [self._balance(x, a, lam, bounded), *self._bounds(x, a, bounded)]
        return [text for text in found if text]

    def _solved(self, system: System, y: State) -> tuple[Array, Array, Array]:
        """Accelerations, multipliers of bilateral and of bounded rows."""
        _, a, _, lam, _ = system.evaluate(system.expand(y))
        parts = (
            [lam[block.slots] for block in system.layout.rigid],
            [lam[block.slots] for block in system.layout.yielding],
        )
        rigid, yielding = (np.concatenate([lam[:0], *part]) for part in parts)
        return a, rigid, yielding

    def _balance(self, x: State, a: Array, lam: Array, bounded: Array) -> str:
        model, data, size = self._model, self._data, np.abs
        pushed, scale = np.zeros(model.nv), np.zeros(model.nv)
        if self._rows:
            J = self._jacobian(x)
            pushed, scale = lam.dot(J), size(lam).dot(size(J)) + _NOISE * size(lam).sum()
        for row, value in zip(self._bounded or (), bounded, strict=True):
            pushed[row.v] += row.margin(x, a)[0] * value
            scale[row.v] += abs(value)
        tau = self._forces.total(x)
        h = pin.rnea(model, data, x.q, x.v, np.zeros(model.nv))
        left = pin.rnea(model, data, x.q, x.v, a) - tau - pushed
        M = pin.crba(model, data, x.q)
        scale += size(M).dot(size(a)) + size(h) + size(tau)
        scale += _ROUNDED * scale.max()
        worst = int(np.argmax(size(left) / (scale + 1.0e-12)))
        if size(left[worst]) <= _BALANCE * scale[worst] + 1.0e-12:
            return ""
        return (
            f"equation of motion {worst} is {left[worst]:.3g} off, {scale[worst]:.3g} in all, "
            f"at t = {x.t:.6g} s"
        )

    def _row_motion(self, x: State, a: Array) -> str:
        """Text if g'' does not vanish."""
        pace = float(np.abs(x.v).sum()) + math.sqrt(float(np.abs(a).sum())) + 1.0e-3
        s = _FAR / pace
        bent = sum(c * self._path(x, a, k * s) for k, c in _STENCIL) / (12.0 * s * s)
        worst = int(np.argmax(np.abs(bent)))
        if abs(bent[worst]) <= _SECOND * pace * pace:
            return ""
        return (
            f"row {worst} accelerates by {bent[worst]:.3g} where joints do by "
            f"{np.abs(a).max():.3g}, at t = {x.t:.6g} s"
        )

    def _bounds(self, x: State, a: Array, lam: Array) -> list[str]:
        texts = []
        for row, value in zip(self._bounded or (), lam, strict=True):
            _, w = row.margin(x, a)
            lower, upper = row.limits
            slack = _COMPLEMENTARY * (1.0 + abs(value))
            near = _COMPLEMENTARY * (1.0 + float(np.abs(a).max()) + sum(row.gains))
            pushes, pulls = value > lower + slack, value < upper - slack
            is_inside = lower - slack <= value <= upper + slack
            if not is_inside or (w > near and pushes) or (w < -near and pulls):
                text = f"bounded row at velocity {row.v}: w = {w:.3g} with multiplier {value:.3g}"
                texts.append(f"{text}, at t = {x.t:.6g} s")
        return texts

    def _jacobian(self, x: State) -> Array:
        """Central differences dg/dq, shape (m, nv)."""
        columns = []
        for direction in np.eye(self._model.nv):
            change = self._along(x, direction, _STEP, x.t) - self._along(x, direction, -_STEP, x.t)
            columns.append(change / (2.0 * _STEP))
        return np.array(columns).T

    def _along(self, x: State, v: Array, s: float, t: float | None = None) -> Array:
        """Residual at q + s v, at the time x.t + s or t."""
        return self.residual(x.t + s if t is None else t, self._moved(x.q, s * v))

    def _path(self, x: State, a: Array, s: float) -> Array:
        return self.residual(x.t + s, self._moved(x.q, s * x.v + 0.5 * s * s * a))

    def _moved(self, q: Array, dq: Array) -> Any:
        return pin.integrate(self._model, q, dq)


class OracleForces:
    """Generalized forces of a scene without commands.

    Types that are not known here fall back on the part itself.
    """

    def __init__(self, loaded: LoadedScene) -> None:
        scene = loaded.scene
        entries: Sequence[Entry] = loaded.entries.get("forces") or []
        self._model, self._data = scene.robot.model, scene.robot.model.createData()
        self._zero = np.zeros(self._model.nv)
        self._known = [
            (e["type"], scene.robot.joint(e["joint"]), e) for e in entries if e["type"] in _RESIST
        ]
        pairs = zip(entries, scene.forces, strict=True)
        self._others = [part for entry, part in pairs if entry["type"] not in _RESIST]
        self._drives = Loads(scene.robot.model.nv, (), scene.actuators)
        self._k = Kinematics(scene.robot, self._data)

    def total(self, x: State) -> Array:
        """All of them, shape (nv,)."""
        tau = self.not_stored(x)
        for kind, joint, entry in self._known:
            if kind == "joint_spring":
                stretch = float(x.q[joint.q]) - entry.get("rest", 0.0)
                tau[joint.v] -= entry["stiffness"] * stretch
        return tau

    def not_stored(self, x: State) -> Array:
        """Those that `stored` leaves out, shape (nv,)."""
        tau = self._zero.copy()
        for kind, joint, entry in self._known:
            tau[joint.v] += _RESIST[kind](entry, float(x.v[joint.v]))
        if self._others:
            self._k.refresh(x.q, x.v)
            tau += sum(part.force(self._k, x, NONE) for part in self._others)
        return tau + self._drives.actuator_torque(self._k, x, None)

    def stored(self, x: State) -> tuple[float, float]:
        """Kinetic energy, and potential energy of masses and joint springs [J]."""
        model, data = self._model, self._data
        kinetic = float(pin.computeKineticEnergy(model, data, x.q, x.v))
        potential = float(pin.computePotentialEnergy(model, data, x.q))
        for kind, joint, entry in self._known:
            if kind == "joint_spring":
                stretch = float(x.q[joint.q]) - entry.get("rest", 0.0)
                potential += 0.5 * entry["stiffness"] * stretch**2
        return kinetic, potential


def _friction(entry: Entry, v: float) -> float:
    dry = entry.get("coulomb", 0.0) * np.tanh(v / entry.get("smoothing", 1.0e-2))
    return float(-dry - entry.get("viscous", 0.0) * v)


_RESIST: Mapping[str, Any] = {
    "joint_spring": lambda entry, v: -entry.get("damping", 0.0) * v,
    "joint_friction": _friction,
    "joint_torque": lambda entry, v: entry["torque"],
}


def bilateral_rows(loaded: LoadedScene) -> list[Rows]:
    """Couplings, then every constraint that holds whatever that takes."""
    scene, rows = loaded.scene, list[Rows]()
    if scene.couplings.dependent:
        rows.append(_couplings(scene))
    for entry, part in _constraints(loaded):
        if part.law.is_rigid:
            make = _KNOWN.get(entry["type"])
            rows.append(
                _rows_of_part(scene.robot, part) if make is None else make(scene.robot, entry)
            )
    return rows


def _couplings(scene: Scene) -> Rows:
    links = scene.couplings.pairs

    def rows(data: Any, t: float, q: Array) -> Any:
        return [q[i.child_q] - i.function(float(q[i.parent_q]))[0] for i in links]

    return rows


def _constraints(loaded: LoadedScene) -> list[tuple[Entry, Any]]:
    entries: Sequence[Entry] = loaded.entries.get("constraints") or []
    return list(zip(entries, loaded.scene.constraints, strict=True))


def _rows_of_part(robot: Robot, part: Any) -> Rows:
    k, rest = Kinematics(robot), np.zeros(robot.model.nv)

    def rows(data: Any, t: float, q: Array) -> Any:
        k.refresh(q, rest, part.reads)
        return part.residual(k, State(t, q, rest))

    return rows


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
    anchor = _place(robot, entry["frame"], entry.get("point", zero), entry.get("rpy", zero))
    position, orientation = entry["position"] - robot.origin, entry.get("orientation")

    def rows(data: Any, t: float, q: Array) -> Any:
        place = _at(data, anchor)
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


def _bounded(robot: Robot, entry: Entry) -> JointRow:
    joint = robot.joint(entry["joint"])
    if entry["type"] == "dry_friction":
        T, limit = entry.get("time_constant", 0.002), entry["limit"]
        return JointRow(joint.q, joint.v, None, (-limit, limit), (0.0, 1.0 / T))
    T = entry.get("time_constant", 0.01)
    ends = entry.get("lower", joint.lower), entry.get("upper", joint.upper)
    return JointRow(joint.q, joint.v, ends, (0.0, math.inf), (1.0 / T**2, 2.0 / T))


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
