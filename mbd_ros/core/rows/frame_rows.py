"""Rows that fix a frame on one body to a frame on another.

Positions: with the origins p_a, p_b of the frames and the rotation R_a of frame a,

    g = R_a' (p_b - p_a),   g' = R_a' (v_b - v_a - omega_a x (p_b - p_a)) = J v

in the constrained directions; `relative_motion` evaluates g, J and the rest of g''. Source: R.
Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 8.

Rotations: R is the rotation from the axes of b to those of a; omega, the angular velocity of b
relative to a, and its derivative alpha stand in the axes of a: R' = [omega] x R. The
misalignment of the axes by an angle theta is measured by residuals of the length
2 sin(theta / 2). They vanish only where the axes agree, unlike sines and dot products of axes,
which vanish at 180 degrees too; their derivatives are exact up to there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from mbd_ros.core.contracts import Now, Value, Wrench, exerted_on
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.kinematics.relative_motion import PairMotion, Placed
from mbd_ros.core.model.points import Pair, Point
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.rows.constraint import Constraint, Row
from mbd_ros.core.rows.delassus import configurations
from mbd_ros.core.state import Array, State, is_symbol
from mbd_ros.core.thresholds import ROUNDED_ROW
from mbd_ros.errors import ModelError

_OPPOSITE = 1.0e-9  # 1 + cos(theta) below which two axes count as opposite
DIRECTIONS: dict[str, Any] = {
    "x": slice(0, 1),
    "y": slice(1, 2),
    "z": slice(2, 3),
    "xy": slice(0, 2),
    "xz": slice(0, 3, 2),
    "yz": slice(1, 3),
    "xyz": slice(0, 3),
    "zxy": [2, 0, 1],
}
_ROTATIONS, _ALL = slice(3, 6), slice(0, 6)


class PairRows(Constraint):
    """Rows that fix the origin of b to that of a in some directions, and some of the axes.

    Args:
        pair: Frame a and frame b.
        directions: Key of `DIRECTIONS`: axes of a along which the origins must coincide.
        rotation: Residual of the axes; None leaves them free.
    """

    reads = Reads.DRIFT

    def __init__(
        self,
        pair: Pair,
        directions: str,
        rotation: RotationResidual | None = None,
    ) -> None:
        self._pair = pair
        self._rows = DIRECTIONS[directions]
        self._rotation = rotation
        self._count = len(directions)
        a, turns = pair.a.frame, () if rotation is None else rotation.names
        self.rows = (
            *(Row(f"force_{axis}", "N", a) for axis in directions),
            *(Row(f"torque_{axis}", "N·m", a) for axis in turns),
        )
        self.outputs = (exerted_on(pair.a, pair.b), exerted_on(pair.b, pair.b))

    def residual(self, k: Kinematics, x: State) -> Array:
        """Return distances [m] in axes of a, then the rotation residual [rad]."""
        motion = k.motion(self._pair)
        offset = motion.offset()[self._rows]
        if self._rotation is None:
            return offset
        return np.concatenate((offset, self._rotation.residual(motion.rotation())))

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Return dg/dq, shape (m, nv)."""
        motion = k.motion(self._pair)
        return self._jacobian(motion, self._placed(motion), self._orientation(motion))

    def drift(self, k: Kinematics, x: State) -> Array:
        """Return J' v, shape (m,)."""
        motion = k.motion(self._pair)
        return self._drift(motion, self._placed(motion), self._orientation(motion))

    def accelerations(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """Return `jacobian` and `drift` from one placement of the frames."""
        motion = k.motion(self._pair)
        placed, R = self._placed(motion), self._orientation(motion)
        return self._jacobian(motion, placed, R), self._drift(motion, placed, R)

    def _placed(self, motion: PairMotion) -> Placed | None:
        return motion.placed() if self._rotation is None else motion.place()

    def _orientation(self, motion: PairMotion) -> Any:
        return None if self._rotation is None else motion.rotation()

    def _jacobian(self, motion: PairMotion, placed: Placed | None, R: Any) -> Array:
        if self._rotation is None:
            return motion.jacobian(placed, self._rows)
        J = motion.jacobian(placed, _ALL)
        turns = self._rotation.slope(R).dot(J[_ROTATIONS])
        return np.concatenate((J[self._rows], turns))

    def _drift(self, motion: PairMotion, placed: Placed | None, R: Any) -> Array:
        if self._rotation is None:
            return motion.acceleration(placed)[self._rows]
        assert placed is not None
        linear, omega, alpha = motion.motion(placed)
        return np.concatenate((linear[self._rows], self._rotation.drift(R, omega, alpha)))

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> Sequence[Value]:
        """Return the wrenches between a and b."""
        return [wrench.numbers for wrench in self.wrenches(k, x, now.lam)]

    def wrenches(self, k: Kinematics, x: State, lam: Array) -> tuple[Wrench, ...]:
        """Return the wrenches between a and b at the origin of b: on a, then on b."""
        _, a, b, _ = self._pair
        axes, point = k.rotation(a), k.position(b)
        force = axes[:, self._rows].dot(lam[: self._count])
        torque = np.zeros(3)
        if self._rotation is not None:
            slope = self._rotation.slope(k.motion(self._pair).rotation())
            torque = axes.dot(slope.T.dot(lam[self._count :]))
        return Wrench(a.frame, point, -force, -torque), Wrench(b.frame, point, force, torque)


class FullRotation:
    """Residual of equal axes: g = 2 e, where (e, w) is the quaternion of R with w >= 0.

    g' = (w - [e] x) omega and g'' = (w - [e] x) alpha - |omega|^2 g / 4.

    Source: R. Featherstone, Rigid Body Dynamics Algorithms, 2008, sec. 4.5 (rate of the Euler
    parameters); differentiated once more.
    """

    names: tuple[str, ...] = ("x", "y", "z")

    def residual(self, R: Array) -> Array:
        """Return the misalignment g [rad], shape (3,)."""
        x, y, z, _ = _quaternion(R)
        return np.array((2.0 * x, 2.0 * y, 2.0 * z))

    def slope(self, R: Array) -> Array:
        """Return the matrix from omega to g', shape (3, 3)."""
        x, y, z, w = _quaternion(R)
        return np.array(((w, z, -y), (-z, w, x), (y, -x, w)))

    def drift(self, R: Array, omega: Array, alpha: Array) -> Array:
        """Return g'' at these angular velocities and accelerations, shape (3,)."""
        x, y, z, w = _quaternion(R)
        ax, ay, az = alpha.tolist()
        bend = 0.5 * omega.dot(omega)
        return np.array(
            (
                w * ax + z * ay - y * az - bend * x,
                w * ay + x * az - z * ax - bend * y,
                w * az + y * ax - x * ay - bend * z,
            )
        )


def _quaternion(R: Array) -> tuple[float, float, float, float]:
    """Return x, y, z, w as floats, w >= 0; NaN where R is no rotation.

    Source: K. Shoemake, Animating rotation with quaternion curves, 1985; as Eigen has it.
    """
    m = R.tolist()
    trace = m[0][0] + (m[1][1] + m[2][2])
    if is_symbol(trace) or trace > 0.0:  # rows that are traced stay closed: NaN below -1
        root = _root(trace + 1.0)
        t = 0.5 / root
        x, y, z = (m[2][1] - m[1][2]) * t, (m[0][2] - m[2][0]) * t, (m[1][0] - m[0][1]) * t
        return x, y, z, 0.5 * root
    i = 1 if m[1][1] > m[0][0] else 0
    i = 2 if m[2][2] > m[i][i] else i
    j, k = (i + 1) % 3, (i + 2) % 3
    square = m[i][i] - m[j][j] - m[k][k] + 1.0
    if not square > 0.0:
        return math.nan, math.nan, math.nan, math.nan
    root = math.sqrt(square)
    t = 0.5 / root
    w = (m[k][j] - m[j][k]) * t
    sign = -1.0 if w < 0.0 else 1.0
    e = [0.0, 0.0, 0.0]
    e[i], e[j], e[k] = 0.5 * root, (m[j][i] + m[i][j]) * t, (m[k][i] + m[i][k]) * t
    return sign * e[0], sign * e[1], sign * e[2], sign * w


def _root(square: Any) -> Any:
    return square.sqrt() if is_symbol(square) else math.sqrt(square)


class AxisRotation:
    """Residual of one common axis: g = s m, transverse components of m = e x c.

    e is the axis in a, c = R e that of b, k = e . c, and s = sqrt(2 / (1 + k)) turns the length
    sin(theta) of m into 2 sin(theta / 2). From c' = omega x c:

        m' = k omega - (e . omega) c,   k' = -m . omega,
        g' = s m' + s' m,               s' = -f k',   f = s / (2 + 2 k)

    Args:
        axis: x, y or z.
    """

    def __init__(self, axis: str) -> None:
        along = "xyz".index(axis)
        self._cycle = along, (along + 1) % 3, (along + 2) % 3  # right-handed: e, second, third
        self._across = sorted(self._cycle[1:])
        self.names: tuple[str, ...] = tuple("xyz"[i] for i in self._across)

    def residual(self, R: Array) -> Array:
        """Return the misalignment g [rad], shape (2,)."""
        _, c2, c3, s = self._axis(R)
        return self._rows(-s * c3, s * c2)

    def slope(self, R: Array) -> Array:
        """Return the matrix from omega to g', shape (2, 3)."""
        k, c2, c3, s = self._axis(R)
        f = 0.5 * s / (1.0 + k)
        first, second, third = self._cycle
        slope = np.empty((3, 3), dtype=R.dtype)
        slope[second, first], slope[third, first] = -s * c2, -s * c3
        slope[second, second], slope[third, third] = s * k + f * c3 * c3, s * k + f * c2 * c2
        slope[second, third] = slope[third, second] = -f * c2 * c3
        across: Array = slope[self._across]
        return across

    def drift(self, R: Array, omega: Array, alpha: Array) -> Array:
        """Return g'' at these angular velocities and accelerations, shape (2,)."""
        k, c2, c3, s = self._axis(R)
        first, second, third = self._cycle
        turn = omega.tolist()
        w1, w2, w3 = turn[first], turn[second], turn[third]
        k_rate, c2_rate, c3_rate = c3 * w2 - c2 * w3, k * w3 - c3 * w1, c2 * w1 - k * w2
        f = 0.5 * s / (1.0 + k)
        bend = 1.5 * f * k_rate * k_rate / (1.0 + k) - f * (c3_rate * w2 - c2_rate * w3)
        m2_rate, m3_rate = k * w2 - w1 * c2, k * w3 - w1 * c3
        bent: Array = self.slope(R).dot(alpha) + self._rows(
            s * (k_rate * w2 - w1 * c2_rate) - 2.0 * f * k_rate * m2_rate - bend * c3,
            s * (k_rate * w3 - w1 * c3_rate) - 2.0 * f * k_rate * m3_rate + bend * c2,
        )
        return bent

    def _axis(self, R: Array) -> tuple[float, float, float, float]:
        """Return the components of c along the axis (k) and across it, and s."""
        first, second, third = self._cycle
        c = R[:, first].tolist()
        k, c2, c3 = c[first], c[second], c[third]
        # opposite axes: all directions back are equally short, so one is chosen
        if not is_symbol(k) and k < _OPPOSITE - 1.0:
            k = _OPPOSITE - 1.0
            c2, c3 = math.sqrt(1.0 - k * k), 0.0
        return k, c2, c3, _root(2.0 / (1.0 + k))

    def _rows(self, second: float, third: float) -> Array:
        """Return the components across the axis in the order of x, y, z."""
        if self._cycle[1] < self._cycle[2]:
            return np.array((second, third))
        return np.array((third, second))


class RotationResidual(Protocol):
    """g(R) with g' = slope omega; `drift` is the whole g'', slope alpha included.

    Attributes:
        names: Axis about which the multiplier of every row turns, in the axes of a.
    """

    names: tuple[str, ...]

    def residual(self, R: Array) -> Array:
        """Return the misalignment g [rad], shape (m,)."""

    def slope(self, R: Array) -> Array:
        """Return the matrix from omega to g', shape (m, 3)."""

    def drift(self, R: Array, omega: Array, alpha: Array) -> Array:
        """Return g'' at these angular velocities and accelerations, shape (m,)."""


def plane_of(robot: Robot, point: Point, normal: Sequence[float]) -> Point:
    """Return the point of a plane, with z along a normal that is expressed in its axes."""
    along = np.array(normal, dtype=np.float64)
    along = along / np.abs(along).max()  # so that its square neither vanishes nor overflows
    return robot.rotated(point, _rotation_to(along / np.linalg.norm(along)))


def _rotation_to(normal: Array) -> Array:
    """Return a rotation whose z axis is the normal."""
    x = np.eye(3)[int(np.argmin(np.abs(normal)))]
    x = x - normal * normal.dot(x)
    x /= np.linalg.norm(x)
    a, b, c = normal.tolist()
    across = np.array(((0.0, -c, b), (c, 0.0, -a), (-b, a, 0.0)))
    return np.column_stack((x, across.dot(x), normal))


class HeldContact(Constraint):
    """Rows of a rigid contact as bilateral rows: gap = 0, and no slip.

    A round body rolls on it. Tangents along which no joint moves are left out.

    Args:
        contact: The contact, a constraint with the law `cone`.

    Attributes:
        name: Name of the contact, whose multipliers these are.

    Raises:
        ModelError: No joint moves the bodies against each other.
    """

    reads = Reads.DRIFT

    def __init__(self, robot: Robot, contact: Any) -> None:
        self.contact = contact
        self.name = contact.name
        self.reads = contact.reads
        numbers = np.flatnonzero(_largest_entries(robot, contact))
        if not len(numbers):
            raise ModelError(
                f"contact {contact.name} cannot be held: no joint moves its bodies against "
                "each other"
            )
        self._numbers = numbers
        self.rows = tuple(contact.rows[i] for i in numbers)

    def residual(self, k: Kinematics, x: State) -> Array:
        """Return gaps [m], and zeros along tangents, shape (m,)."""
        return np.asarray(self.contact.residual(k, x)[self._numbers])

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Return the rows of the contact frames, shape (m, nv)."""
        return np.asarray(self.contact.jacobian(k, x)[self._numbers])

    def drift(self, k: Kinematics, x: State) -> Array:
        """Return J' v, shape (m,)."""
        return np.asarray(self.contact.drift(k, x)[self._numbers])

    def accelerations(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """Return `jacobian` and `drift` from one placement of the contact."""
        J, drift = self.contact.accelerations(k, x)
        return J[self._numbers], drift[self._numbers]

    def wrenches(self, k: Kinematics, x: State, lam: Array) -> tuple[Wrench, ...]:
        """Return the wrenches of the contact."""
        every_lam = k.zeros(len(self.contact.rows))
        every_lam[self._numbers] = lam
        wrenches: tuple[Wrench, ...] = self.contact.wrenches(k, x, every_lam)
        return wrenches


def _largest_entries(robot: Robot, contact: Any) -> Array:
    """Return the largest entry of each row over configurations, 0 for rounding, shape (m,)."""
    k, still = Kinematics(robot), np.zeros(robot.model.nv)
    largest = np.zeros(len(contact.rows))
    for q in configurations(robot):
        k.refresh(q, still, Reads.JACOBIAN)
        rows = np.abs(contact.jacobian(k, State(0.0, q, still)))
        largest = np.maximum(largest, rows.max(axis=1, initial=0.0))
    return np.where(largest > ROUNDED_ROW, largest, 0.0)


def check_normal(normal: Sequence[float]) -> None:
    """Refuse a normal of length 0."""
    if not any(normal):
        raise ModelError(f"normal {normal} must have a direction")
