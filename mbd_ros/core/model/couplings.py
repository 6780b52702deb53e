"""Dependent joints: q = F(y), with G = dF/dy and the drift dG/dt y'.

Every dependent joint follows one other joint, its parent, by a coupling function f. Chains are
walked joint by joint:

    q_d = f(q_p),    v_d = f' v_p,    a_d = f' a_p + f'' v_p^2

from the independent joints outwards gives F(y), G y' and G y'' + dG/dt y'; the same walk
backwards, tau_p += f' tau_d, gives G' tau. After the backward walk tau_d is the coupling
multiplier lam_d.
"""

import itertools
import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.model.robot import Joint, Robot
from mbd_ros.core.state import Array, is_symbol
from mbd_ros.errors import ModelError

# ---- coupling functions -----------------------------------------------------------------------
# How a dependent joint follows its parent: q_d = f(z), with f' and f''.


MAX_COEFFICIENTS = 1000  # of a polynomial, which costs its length whenever it is evaluated


def _horner(coefficients: Any, z: Any) -> tuple[Any, Any, Any]:
    """Value, first and second derivative of a polynomial, highest power first."""
    value = slope = half_curvature = 0.0 * z
    for c in coefficients:
        half_curvature = half_curvature * z + slope
        slope = slope * z + value
        value = value * z + c
    return value, slope, 2.0 * half_curvature


class Polynomial:
    """q_d = c0 + c1 z + c2 z^2 + ...

    Args:
        coefficients: c0, c1, ... [rad or m, per power of the parent's rad or m], at least one.
    """

    def __init__(self, coefficients: Sequence[float]) -> None:
        if len(coefficients) == 0:
            raise ModelError("polynomial has no coefficients")
        _check_count(len(coefficients))
        self._highest_first = tuple(
            c if is_symbol(c) else float(c) for c in reversed(coefficients)
        )

    def __call__(self, z: Any) -> tuple[Any, Any, Any]:
        """f(z), f'(z) and f''(z); z is a float or an array."""
        return _horner(self._highest_first, z)


class Linear:
    """q_d = factor z + offset.

    Args:
        factor: [rad or m per rad or m].
        offset: [rad or m].
    """

    def __init__(self, factor: float, offset: float = 0.0) -> None:
        self.factor, self.offset = float(factor), float(offset)

    def __call__(self, z: Any) -> tuple[Any, Any, Any]:
        """f(z), f'(z) and f''(z); z is a float or an array."""
        return self.factor * z + self.offset, self.factor, 0.0


class Harmonic:
    """q_d = offset + amplitude sin(angular_frequency z + phase).

    Args:
        amplitude: [rad or m].
        angular_frequency: [rad per rad or m of the parent].
        phase: [rad].
        offset: [rad or m].
    """

    def __init__(
        self, amplitude: float, angular_frequency: float, phase: float = 0.0, offset: float = 0.0
    ) -> None:
        self._amplitude, self._rate = float(amplitude), float(angular_frequency)
        self._phase, self._offset = float(phase), float(offset)

    def __call__(self, z: Any) -> tuple[Any, Any, Any]:
        """f(z), f'(z) and f''(z); z is a float, an array or a symbol."""
        angle, rate = self._rate * z + self._phase, self._rate
        library = math if isinstance(z, float) else np
        height = self._amplitude * library.sin(angle)
        slope = self._amplitude * rate * library.cos(angle)
        return self._offset + height, slope, -rate * rate * height


class PiecewisePolynomial:
    """One polynomial an interval; the outer pieces continue beyond the outer breaks.

    Args:
        breaks: Interval ends z_0 < z_1 < ... < z_n [rad or m].
        coefficients: One row an interval, highest power first, in (z - left break).

    Raises:
        ModelError: Breaks not increasing, or rows of another number or length.
    """

    def __init__(self, breaks: Sequence[float], coefficients: Sequence[Sequence[float]]) -> None:
        _check_increasing(breaks, "breaks")
        if len(coefficients) != len(breaks) - 1:
            raise ModelError(
                f"{len(coefficients)} rows of coefficients for {len(breaks) - 1} intervals"
            )
        if len({len(row) for row in coefficients}) != 1 or len(coefficients[0]) == 0:
            raise ModelError("rows of coefficients differ in length or are empty")
        _check_count(len(coefficients[0]))
        self._lefts = [float(b) for b in breaks[:-1]]
        self._inner = self._lefts[1:]
        self._rows = [tuple(float(c) for c in row) for row in coefficients]
        self._left_array, self._row_array = np.array(self._lefts), np.array(self._rows)

    def __call__(self, z: Any) -> tuple[Any, Any, Any]:
        """f(z), f'(z) and f''(z); z is a float, an array or a symbol."""
        if isinstance(z, float):
            piece = bisect_right(self._inner, z)
            return _horner(self._rows[piece], z - self._lefts[piece])
        if is_symbol(z):
            left, *row = z.piecewise(self._inner, np.column_stack((self._lefts, self._rows)))
            return _horner(row, z - left)
        pieces = np.searchsorted(self._inner, z, side="right")
        return _horner(self._row_array[pieces].T, z - self._left_array[pieces])


def natural_cubic_spline(x: Sequence[float], y: Sequence[float]) -> PiecewisePolynomial:
    """Interpolating cubic spline with zero end curvature, continued by straight lines.

    Args:
        x: Positions of the parent, increasing, at least two [rad or m].
        y: Positions of the dependent joint [rad or m].

    Raises:
        ModelError: Lengths differ or x does not increase.

    Source: C. de Boor, A Practical Guide to Splines, 1978, ch. IV.
    """
    knots, values = checked_points(x, y)
    h = np.diff(knots)
    right = 6.0 * np.diff(np.diff(values) / h)
    inner = tridiagonal(h[1:-1], 2.0 * (h[:-1] + h[1:]), right)
    return through(knots, values, np.concatenate(([0.0], inner, [0.0])))


def checked_points(x: Sequence[float], y: Sequence[float]) -> tuple[Array, Array]:
    """Points of a spline as arrays.

    Raises:
        ModelError: Lengths differ or x does not increase.
    """
    _check_increasing(x, "x")
    if len(x) != len(y):
        raise ModelError(f"spline has {len(x)} x and {len(y)} y")
    return np.array(x, dtype=np.float64), np.array(y, dtype=np.float64)


def through(knots: Array, values: Array, curvature: Array) -> PiecewisePolynomial:
    """The cubic spline through points with these second derivatives there, straight beyond.

    Args:
        knots: Shape (n,).
        values: At the knots, shape (n,).
        curvature: Second derivatives at the knots, shape (n,).
    """
    h = np.diff(knots)
    cubic, quadratic = np.diff(curvature) / (6.0 * h), curvature[:-1] / 2.0
    slope = np.diff(values) / h - h * (2.0 * curvature[:-1] + curvature[1:]) / 6.0
    inside = np.column_stack([cubic, quadratic, slope, values[:-1]])
    end_slope = slope[-1] + h[-1] * (curvature[-2] + curvature[-1]) / 2.0
    before = [0.0, 0.0, slope[0], values[0] - slope[0] * h[0]]
    after = [0.0, 0.0, end_slope, values[-1]]
    breaks = [knots[0] - h[0], *knots, knots[-1] + h[-1]]
    return PiecewisePolynomial(breaks, [before, *inside.tolist(), after])


def tridiagonal(off: Array, diagonal: Array, right: Array) -> Array:
    """Solution of a symmetric tridiagonal system in a time linear in its size, shape (n,).

    Elimination without pivots, which is stable where the diagonal dominates.

    Args:
        off: Beside the diagonal, shape (n - 1,).
        diagonal: Shape (n,).
        right: Right-hand side, shape (n,).

    Source: G. H. Golub, C. F. Van Loan, Matrix Computations, sec. 4.3.6.
    """
    beside, pivots, reduced = off.tolist(), diagonal.tolist(), right.tolist()
    for i, along in enumerate(beside):
        share = along / pivots[i]
        pivots[i + 1] -= share * along
        reduced[i + 1] -= share * reduced[i]
    solution = [0.0] * (len(pivots) + 1)
    for i in range(len(pivots) - 1, -1, -1):
        beyond = beside[i] * solution[i + 1] if i < len(beside) else 0.0
        solution[i] = (reduced[i] - beyond) / pivots[i]
    return np.array(solution[:-1])


def _check_count(coefficients: int) -> None:
    if coefficients > MAX_COEFFICIENTS:
        raise ModelError(f"{coefficients} coefficients, accepted are {MAX_COEFFICIENTS}")


def _check_increasing(values: Sequence[float], name: str) -> None:
    if len(values) < 2 or any(b <= a for a, b in itertools.pairwise(values)):
        raise ModelError(f"{name} must be at least two increasing numbers, got {list(values)}")


CouplingFunction = Linear | Polynomial | Harmonic | PiecewisePolynomial


# ---- couplings --------------------------------------------------------------------------------
# Dependent joints: q = F(y), with G = dF/dy and the drift dG/dt y'.


Slopes = list[Any]  # floats, or one array a joint for a batch


class Coupling(NamedTuple):
    """Parent and function of a dependent joint, in topic names."""

    parent: str
    function: CouplingFunction


class CoupledPair(NamedTuple):
    """A coupling in indices of q and v."""

    child_q: int
    child_v: int
    parent_q: int
    parent_v: int
    function: CouplingFunction


class Couplings:
    """All dependent joints of a robot.

    Args:
        robot: The robot; its `<mimic>` joints join in.
        couplings: Dependent joint -> what it follows; replaces a `<mimic>` of the same joint.

    Attributes:
        independent: Names of the independent joints, in the order of y.
        dependent: Names of the dependent joints, in the order of the multipliers.
        parents: Dependent joint -> its direct parent.
        q_index: Where y stands in q, poses of free bases included, shape (ny,).
        v_index: Where y' stands in v, shape (nv_y,).
        pairs: The couplings in indices, parents before children.

    Raises:
        ModelError: Unknown, fixed or locked joint, or a cycle, with the path.
    """

    def __init__(self, robot: Robot, couplings: Mapping[str, Coupling] | None = None) -> None:
        functions = {m.joint: Coupling(m.parent, Linear(m.factor, m.offset)) for m in robot.mimics}
        functions.update(couplings or {})
        for name, coupling in functions.items():
            _check_ends(robot, name, coupling.parent)
        order = _outwards(functions)
        child = {name: robot.joint(name) for name in order}
        self.independent = tuple(j.name for j in robot.joints if j.name not in functions)
        self.dependent = tuple(order)
        self.parents = {name: functions[name].parent for name in order}
        self.pairs = [_pair(robot, child[name], functions[name]) for name in order]
        dependent_q = [joint.q for joint in child.values()]
        self._dependent_v = np.array([joint.v for joint in child.values()], dtype=np.intp)
        self.q_index = np.setdiff1d(np.arange(robot.model.nq), dependent_q)
        self.v_index = np.setdiff1d(np.arange(robot.model.nv), self._dependent_v)
        self._nv = int(robot.model.nv)

    def expand(self, q: Array, v: Array, a: Array, slopes: Slopes | None = None) -> Slopes:
        """Fill the dependent rows of q, v and a from the independent ones, in place.

        Args:
            q: Configuration, shape (nq,), or a batch (nq, n).
            v: Velocity, shape (nv,) or (nv, n).
            a: Acceleration, shape (nv,) or (nv, n).
            slopes: Result of an earlier call, to be overwritten; a new list without it.

        Returns:
            The slope f' of every dependent joint at this configuration.
        """
        slopes = [0.0] * len(self.pairs) if slopes is None else slopes
        q_of, v_of, a_of = (x.item if x.ndim == 1 else x.__getitem__ for x in (q, v, a))
        for i, (child_q, child_v, parent_q, parent_v, function) in enumerate(self.pairs):
            q[child_q], slope, curvature = function(q_of(parent_q))
            rate = v_of(parent_v)
            v[child_v] = slope * rate
            a[child_v] = slope * a_of(parent_v) + curvature * rate * rate
            slopes[i] = slope
        return slopes

    def reduce(self, tau: Array, slopes: Slopes) -> tuple[Array, Array]:
        """G' tau and the multipliers.

        Args:
            tau: Generalized forces of all joints, shape (nv,) or (nv, n); overwritten.
            slopes: What `expand` returned.

        Returns:
            Forces of the independent coordinates, shape (nv_y,) or (nv_y, n), and the multiplier
            of every dependent joint, shape (len(dependent),) or (len(dependent), n).
        """
        for slope, pair in zip(reversed(slopes), reversed(self.pairs), strict=True):
            tau[pair.parent_v] += slope * tau[pair.child_v]
        return tau[self.v_index], tau[self._dependent_v]

    def positions(self, y: Array) -> Array:
        """F(y): all positions of a fixed-base robot, shape (nq,).

        Args:
            y: Independent positions [rad or m], shape (ny,).
        """
        q, v, a = np.empty(self._nv), np.zeros(self._nv), np.zeros(self._nv)
        q[self.q_index] = y
        self.expand(q, v, a)
        return q

    def jacobian(self, q: Array) -> Array:
        """G = dF/dy at a configuration, shape (nv, nv_y)."""
        G = np.zeros((self._nv, len(self.v_index)))
        G[self.v_index, np.arange(len(self.v_index))] = 1.0
        for pair in self.pairs:
            _, slope, _ = pair.function(q.item(pair.parent_q))
            G[pair.child_v] = slope * G[pair.parent_v]
        return G


def _check_ends(robot: Robot, name: str, parent: str) -> None:
    for role, joint in (("coupled joint", name), ("parent", parent)):
        try:
            robot.joint(joint)
        except ModelError as error:
            raise ModelError(f"coupling {name} <- {parent}: {role}: {error}") from error


def _outwards(functions: Mapping[str, Coupling]) -> list[str]:
    """Dependent joints, parents before children."""
    order: list[str] = []
    for name in functions:
        path = [name]
        while (parent := functions[path[-1]].parent) in functions and parent not in order:
            if parent in path:
                raise ModelError(f"couplings form a cycle: {' <- '.join([*path, parent])}")
            path.append(parent)
        order.extend(joint for joint in reversed(path) if joint not in order)
    return order


def _pair(robot: Robot, child: Joint, coupling: Coupling) -> CoupledPair:
    parent = robot.joint(coupling.parent)
    return CoupledPair(child.q, child.v, parent.q, parent.v, coupling.function)


# ---- simm spline ------------------------------------------------------------------------------
# The cubic spline of SIMM and OpenSim, in which published models give knees and moving points.


def simm_spline(x: Sequence[float], y: Sequence[float]) -> PiecewisePolynomial:
    """Interpolating cubic spline whose end pieces have the third derivatives of four points.

    The third derivative of the first piece is that of the cubic through the first four points, and
    likewise at the other end; with three points it is 0 in both pieces. Beyond the points the
    curve goes on straight. Two points give a line.

    Args:
        x: Positions of the parent, increasing, at least two [rad or m].
        y: Positions of the dependent joint [rad or m].

    Raises:
        ModelError: Lengths differ or x does not increase.

    Source: G. E. Forsythe, M. A. Malcolm, C. B. Moler, Computer Methods for Mathematical
        Computations, 1977, ch. 4.4.
    """
    knots, values = checked_points(x, y)
    h = np.diff(knots)
    if len(h) == 1:
        return through(knots, values, np.zeros(2))
    slopes = np.diff(values) / h
    third = np.zeros(2)
    if len(knots) > 3:
        second = np.diff(slopes) / (knots[2:] - knots[:-2])
        third = (np.diff(second) / (knots[3:] - knots[:-3]))[[0, -1]]
    right = np.concatenate(([h[0] ** 2 * third[0]], np.diff(slopes), [-(h[-1] ** 2) * third[1]]))
    diagonal = np.concatenate(([-h[0]], 2.0 * (h[:-1] + h[1:]), [-h[-1]]))
    return through(knots, values, 6.0 * tridiagonal(h, diagonal, right))
