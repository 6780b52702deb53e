"""Steps between configurations with free bodies, in symbols; see `core.dynamics.chart.Chart`.

Free bodies move along screws of their own frame, with velocities in its axes. Where velocities
stand in the axes of the world (`core.dynamics.world_axes`), they move along straight lines.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import casadi as ca

from mbd_ros.compiled.symbols.tree.link_rotations import (
    Matrix,
    Vector,
    cross,
    dot,
    minus,
    plus,
    through,
    times,
    transposed,
)
from mbd_ros.compiled.symbols.tree.moving_tree import rotation_of

_BASE_V = 6
_SMALL = 0.5  # square of a turn below which series serve [rad^2]
_BERNOULLI = (  # B_2k / (2k)!
    *(1 / 12, -1 / 720, 1 / 30240, -1 / 1209600, 1 / 47900160, -691 / 1307674368000),
    *(1 / 74724249600, -3617 / 10670622842880000, 43867 / 5109094217170944000),
)


class CurvedChart:
    """Configurations of which free bodies move along screws of their own frame.

    Args:
        model: Pinocchio model whose joints have these coordinates.
    """

    def __init__(self, model: Any) -> None:
        self._model = model
        self._bases = [joint for joint in model.joints if joint.nv == _BASE_V]

    def integrate(self, q: Any, dq: Any) -> Any:
        """The configuration q (+) dq, a column."""
        values, steps = ca.vertsplit(q), ca.vertsplit(dq)
        values_out = [ca.SX(0.0)] * self._model.nq
        for joint in self._model.joints:
            if joint.nv == 1:
                values_out[joint.idx_q] = values[joint.idx_q] + steps[joint.idx_v]
            elif joint.nv == _BASE_V:
                at, v = joint.idx_q, joint.idx_v
                values_out[at : at + 7] = self._moved(values[at : at + 7], steps[v : v + 6])
        return ca.vertcat(*values_out)

    def rate(self, dq: Any, v: Any) -> Any:
        """Rate of dq in q0 (+) dq while the configuration moves with v, a column."""
        steps, rates = ca.vertsplit(dq), ca.vertsplit(v)
        for joint in self._bases:
            own = slice(joint.idx_v, joint.idx_v + _BASE_V)
            rates[own] = self._rate(steps[own], rates[own])
        return ca.vertcat(*rates)

    def _moved(self, pose: list[Any], step: list[Any]) -> list[Any]:
        """A pose after a screw; its quaternion keeps its side, as Pinocchio has it."""
        R = rotation_of(pose[3:])
        along, turn = tuple(step[:3]), tuple(step[3:])
        square = dot(turn, turn)
        root = ca.sqrt(_safe(square))
        s, c = ca.sin(root), ca.cos(root)
        first = _either(square, (1.0 - c) / _safe(square), _series(square, 2))
        second = _either(square, (root - s) / (_safe(square) * root), _series(square, 3))
        across = cross(turn, along)
        displacement = plus(along, plus(times(first, across), times(second, cross(turn, across))))
        place = plus(tuple(pose[:3]), through(R, displacement))
        return [*place, *turn_quaternion(pose[3:], turn)]

    def _rate(self, step: list[Any], v: list[Any]) -> list[Any]:
        """The inverse of the right Jacobian of SE(3) times v: v + ad v / 2 + a ad^2 v + b ad^4 v.

        Higher powers follow from ad^5 + 2 s ad^3 + s^2 ad = 0, s the square of the turn. Source:
        Iserles et al., Lie-group methods, Acta Numerica 9, 2000, sec. 2.6.
        """
        along, turn = tuple(step[:3]), tuple(step[3:])
        s = dot(turn, turn)
        root = ca.sqrt(_safe(s))
        tangent = ca.tan(0.5 * root)
        G = 0.5 * root / tangent
        slope = 0.5 / tangent - 0.25 * root * (1.0 + 1.0 / (tangent * tangent))
        D = -slope / (2.0 * root)
        remainder = (1.0 - D * s - G) / _safe(s)
        small_a, small_b = ca.SX(_BERNOULLI[0]), ca.SX(0.0)
        power = ca.SX(1.0)
        for k, weight in enumerate(_BERNOULLI[1:], 2):
            small_b += weight * (k - 1) * power
            small_a += weight * (k - 2) * s * power
            power = -s * power
        a = _either(s, D + 2.0 * remainder, small_a)
        b = _either(s, remainder / _safe(s), small_b)
        first = _ad(along, turn, (tuple(v[:3]), tuple(v[3:])))
        second = _ad(along, turn, first)
        fourth = _ad(along, turn, _ad(along, turn, second))
        return [
            entry + 0.5 * first_order + a * two + b * four
            for entry, first_order, two, four in zip(
                v, *([*part[0], *part[1]] for part in (first, second, fourth)), strict=True
            )
        ]


class WorldChart(CurvedChart):
    """Configurations of which free bodies move along straight lines and turn, in world axes."""

    def _moved(self, pose: list[Any], step: list[Any]) -> list[Any]:
        place = plus(tuple(pose[:3]), tuple(step[:3]))
        return [*place, *turn_quaternion(pose[3:], tuple(step[3:]), in_world=True)]

    def _rate(self, step: list[Any], v: list[Any]) -> list[Any]:
        return [*v[:3], *turn_rate(tuple(step[3:]), tuple(v[3:]))]


class WorldAxes:
    """From axes of the bodies to those of the world, and back.

    Args:
        model: Pinocchio model whose joints have the coordinates that are integrated.
        q: Configuration of these, SX scalars.
    """

    def __init__(self, model: Any, q: Sequence[Any]) -> None:
        bases = [joint for joint in model.joints if joint.nv == 6]
        self._axes = {
            int(joint.idx_v): rotation_of(q[joint.idx_q + 3 : joint.idx_q + 7]) for joint in bases
        }

    def in_world(self, v: Sequence[Any]) -> list[Any]:
        """Velocities, or small motions, in the axes of the world, SX scalars."""
        values_out = list(v)
        for at, R in self._vectors():
            values_out[at : at + 3] = through(R, tuple(v[at : at + 3]))
        return values_out

    def in_own_axes(self, v: Sequence[Any]) -> list[Any]:
        """The reverse of `in_world`."""
        values_out = list(v)
        for at, R in self._vectors():
            values_out[at : at + 3] = through(transposed(R), tuple(v[at : at + 3]))
        return values_out

    def rate(self, a: Sequence[Any], v: Sequence[Any]) -> list[Any]:
        """Rates of velocities in the axes of the world, SX scalars.

        Args:
            a: Accelerations in the axes of the bodies.
            v: Velocities in those of the world.
        """
        values_out = self.in_world(a)
        for at in self._axes:
            along: Vector = tuple(v[at : at + 3])
            turning = cross(tuple(v[at + 3 : at + 6]), along)
            values_out[at : at + 3] = plus(tuple(values_out[at : at + 3]), turning)
        return values_out

    def slowing(self, a: Sequence[Any], v: Sequence[Any]) -> list[Any]:
        """The reverse of `rate`."""
        values_out = list(a)
        for at in self._axes:
            turning = cross(tuple(v[at + 3 : at + 6]), tuple(v[at : at + 3]))
            values_out[at : at + 3] = minus(tuple(a[at : at + 3]), turning)
        return self.in_own_axes(values_out)

    def _vectors(self) -> Iterator[tuple[int, Matrix]]:
        for at, R in self._axes.items():
            yield at, R
            yield at + 3, R


def turn_quaternion(quaternion: list[Any], turn: Vector, *, in_world: bool = False) -> list[Any]:
    """A unit quaternion after a turn about its own axes, or about those of the world."""
    x, y = tuple(quaternion[:3]), quaternion[3]
    square = dot(turn, turn)
    root = ca.sqrt(_safe(square))
    half = _either(square, ca.sin(0.5 * root) / root, 0.5 * _series(0.25 * square, 1))
    w = _either(square, ca.cos(0.5 * root), _series(0.25 * square, 0))
    e = times(half, turn)
    across = cross(e, x) if in_world else cross(x, e)
    vector = plus(plus(times(w, x), times(y, e)), across)
    quaternion_out = [*vector, y * w - dot(x, e)]
    share = 0.5 * (3.0 - sum(component * component for component in quaternion_out))
    return [share * component for component in quaternion_out]


def turn_rate(turn: Vector, spin: Vector) -> Vector:
    """Rate of a rotation vector whose body spins, both in the axes of the world.

    Source: Iserles et al., Lie-group methods, Acta Numerica 9, 2000, app. B: the inverse of the
    left Jacobian of SO(3).
    """
    square = dot(turn, turn)
    half = 0.5 * ca.sqrt(_safe(square))
    large = (1.0 - half / ca.tan(half)) / _safe(square)
    small, power = ca.SX(0.0), ca.SX(1.0)
    for weight in _BERNOULLI:  # 1 - h cot h, h = |turn| / 2
        small += abs(weight) * power
        power = square * power
    across = cross(turn, spin)
    bent = times(_either(square, large, small), cross(turn, across))
    return plus(spin, plus(times(ca.SX(-0.5), across), bent))


def _ad(along: Vector, turn: Vector, v: tuple[Vector, Vector]) -> tuple[Vector, Vector]:
    linear, angular = v
    return plus(cross(turn, linear), cross(along, angular)), cross(turn, angular)


def _series(square: Any, first: int) -> Any:
    """Sum of (-square)^k / (2 k + first)!."""
    series, term = ca.SX(0.0), 1.0
    for i in range(1, first + 1):
        term /= i
    power = ca.SX(1.0)
    for k in range(9):
        series += term * power
        power = -square * power
        term /= (2 * k + first + 1) * (2 * k + first + 2)
    return series


def _safe(square: Any) -> Any:
    return ca.if_else(square > _SMALL, square, 1.0)


def _either(square: Any, large: Any, small: Any) -> Any:
    return ca.if_else(square > _SMALL, large, small)
