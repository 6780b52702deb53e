"""Coupling functions q_d = f(z) of one joint position z, with f' and f''.

A function takes a float, an array or a symbol and returns f, f' and f''. Splines are piecewise
polynomials that continue as straight lines beyond their points; `simm_spline` is the spline of
SIMM and OpenSim, which published models use for knees and moving points of paths.
"""

import itertools
import math
from bisect import bisect_right
from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_ros.core.state import Array, is_symbol
from mbd_ros.errors import ModelError

MAX_COEFFICIENTS = 1000  # of a polynomial; every evaluation loops over them


class Linear:
    """Linear function q_d = factor z + offset.

    Args:
        factor: Slope [rad or m per rad or m].
        offset: Value at z = 0 [rad or m].
    """

    def __init__(self, factor: float, offset: float = 0.0) -> None:
        self.factor = float(factor)
        self.offset = float(offset)

    def __call__(self, z: Any) -> tuple[Any, Any, Any]:
        """Return f(z), f'(z) and f''(z); z is a float or an array."""
        return self.factor * z + self.offset, self.factor, 0.0


class Polynomial:
    """Polynomial q_d = c0 + c1 z + c2 z^2 + ...

    Args:
        coefficients: c0, c1, ... [rad or m, per power of the parent's rad or m], at least one.
    """

    def __init__(self, coefficients: Sequence[float]) -> None:
        if len(coefficients) == 0:
            raise ModelError("a polynomial needs at least one coefficient")
        _check_count(len(coefficients))
        self._highest_first = tuple(
            c if is_symbol(c) else float(c) for c in reversed(coefficients)
        )

    def __call__(self, z: Any) -> tuple[Any, Any, Any]:
        """Return f(z), f'(z) and f''(z); z is a float or an array."""
        return _horner(self._highest_first, z)


class Harmonic:
    """Harmonic function q_d = offset + amplitude sin(angular_frequency z + phase).

    Args:
        amplitude: Amplitude [rad or m].
        angular_frequency: Angular frequency [rad per rad or m of the parent].
        phase: Phase at z = 0 [rad].
        offset: Mean value [rad or m].
    """

    def __init__(
        self, amplitude: float, angular_frequency: float, phase: float = 0.0, offset: float = 0.0
    ) -> None:
        self._amplitude = float(amplitude)
        self._rate = float(angular_frequency)
        self._phase = float(phase)
        self._offset = float(offset)

    def __call__(self, z: Any) -> tuple[Any, Any, Any]:
        """Return f(z), f'(z) and f''(z); z is a float, an array or a symbol."""
        angle, rate = self._rate * z + self._phase, self._rate
        library = math if isinstance(z, float) else np
        height = self._amplitude * library.sin(angle)
        slope = self._amplitude * rate * library.cos(angle)
        return self._offset + height, slope, -rate * rate * height


class PiecewisePolynomial:
    """Piecewise polynomial; the outer pieces continue beyond the outer breaks.

    Args:
        breaks: Ends of the intervals z_0 < z_1 < ... < z_n [rad or m].
        coefficients: One row per interval: coefficients of the powers of (z - left break), highest
            power first.

    Raises:
        ModelError: Breaks do not increase, or the number or length of rows does not match.
    """

    def __init__(self, breaks: Sequence[float], coefficients: Sequence[Sequence[float]]) -> None:
        _check_increasing(breaks, "breaks")
        if len(coefficients) != len(breaks) - 1:
            raise ModelError(
                f"coefficients have {len(coefficients)} rows, but there are {len(breaks) - 1} "
                "intervals"
            )
        if len({len(row) for row in coefficients}) != 1 or len(coefficients[0]) == 0:
            raise ModelError("rows of coefficients must have the same length, and not be empty")
        _check_count(len(coefficients[0]))
        self._lefts = [float(b) for b in breaks[:-1]]
        self._inner = self._lefts[1:]
        self._rows = [tuple(float(c) for c in row) for row in coefficients]
        self._left_array = np.array(self._lefts)
        self._row_array = np.array(self._rows)

    def __call__(self, z: Any) -> tuple[Any, Any, Any]:
        """Return f(z), f'(z) and f''(z); z is a float, an array or a symbol."""
        if isinstance(z, float):
            piece = bisect_right(self._inner, z)
            return _horner(self._rows[piece], z - self._lefts[piece])
        if is_symbol(z):
            left, *row = z.piecewise(self._inner, np.column_stack((self._lefts, self._rows)))
            return _horner(row, z - left)
        pieces = np.searchsorted(self._inner, z, side="right")
        return _horner(self._row_array[pieces].T, z - self._left_array[pieces])


CouplingFunction = Linear | Polynomial | Harmonic | PiecewisePolynomial


def natural_cubic_spline(x: Sequence[float], y: Sequence[float]) -> PiecewisePolynomial:
    """Return the natural cubic spline through points, continued by straight lines.

    Args:
        x: Positions of the parent, increasing, at least two [rad or m].
        y: Positions of the dependent joint [rad or m].

    Raises:
        ModelError: The lengths differ, or x does not increase.

    Source: C. de Boor, A Practical Guide to Splines, 1978, ch. IV.
    """
    knots, values = checked_points(x, y)
    h = np.diff(knots)
    right = 6.0 * np.diff(np.diff(values) / h)
    inner = tridiagonal(h[1:-1], 2.0 * (h[:-1] + h[1:]), right)
    return cubic_spline_through(knots, values, np.concatenate(([0.0], inner, [0.0])))


def simm_spline(x: Sequence[float], y: Sequence[float]) -> PiecewisePolynomial:
    """Return the cubic spline of SIMM and OpenSim through points.

    Its first piece has the third derivative of the cubic through the first four points, and
    likewise its last piece; with three points, both third derivatives are 0. Beyond the points the
    curve continues as a straight line. Two points yield a straight line.

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
        return cubic_spline_through(knots, values, np.zeros(2))
    slopes = np.diff(values) / h
    third = np.zeros(2)
    if len(knots) > 3:
        second = np.diff(slopes) / (knots[2:] - knots[:-2])
        third = (np.diff(second) / (knots[3:] - knots[:-3]))[[0, -1]]
    right = np.concatenate(([h[0] ** 2 * third[0]], np.diff(slopes), [-(h[-1] ** 2) * third[1]]))
    diagonal = np.concatenate(([-h[0]], 2.0 * (h[:-1] + h[1:]), [-h[-1]]))
    return cubic_spline_through(knots, values, 6.0 * tridiagonal(h, diagonal, right))


def checked_points(x: Sequence[float], y: Sequence[float]) -> tuple[Array, Array]:
    """Check the points of a spline and return them as arrays.

    Raises:
        ModelError: The lengths differ, or x does not increase.
    """
    _check_increasing(x, "x")
    if len(x) != len(y):
        raise ModelError(f"spline has {len(x)} values of x and {len(y)} of y; both must be equal")
    return np.array(x, dtype=np.float64), np.array(y, dtype=np.float64)


def cubic_spline_through(knots: Array, values: Array, curvature: Array) -> PiecewisePolynomial:
    """Return the cubic spline with given values and second derivatives at its knots.

    Beyond the knots it continues as a straight line.

    Args:
        knots: Knots, shape (n,).
        values: Values at the knots, shape (n,).
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
    """Solve a symmetric tridiagonal system in linear time; the solution has shape (n,).

    It is elimination without pivoting, which is stable for diagonally dominant matrices.

    Args:
        off: Off-diagonal, shape (n - 1,).
        diagonal: Diagonal, shape (n,).
        right: Right-hand side, shape (n,).

    Source: G. H. Golub, C. F. Van Loan, Matrix Computations, sec. 4.3.6.
    """
    off_diagonal, pivots, reduced = off.tolist(), diagonal.tolist(), right.tolist()
    for i, entry in enumerate(off_diagonal):
        factor = entry / pivots[i]
        pivots[i + 1] -= factor * entry
        reduced[i + 1] -= factor * reduced[i]
    solution = [0.0] * (len(pivots) + 1)
    for i in range(len(pivots) - 1, -1, -1):
        known = off_diagonal[i] * solution[i + 1] if i < len(off_diagonal) else 0.0
        solution[i] = (reduced[i] - known) / pivots[i]
    return np.array(solution[:-1])


def _horner(coefficients: Any, z: Any) -> tuple[Any, Any, Any]:
    """Return value, first and second derivative of a polynomial, highest power first."""
    value = slope = half_curvature = 0.0 * z
    for c in coefficients:
        half_curvature = half_curvature * z + slope
        slope = slope * z + value
        value = value * z + c
    return value, slope, 2.0 * half_curvature


def _check_count(coefficients: int) -> None:
    if coefficients > MAX_COEFFICIENTS:
        raise ModelError(
            f"a polynomial has {coefficients} coefficients, accepted are {MAX_COEFFICIENTS}"
        )


def _check_increasing(values: Sequence[float], name: str) -> None:
    if len(values) < 2 or any(b <= a for a, b in itertools.pairwise(values)):
        raise ModelError(f"{name} must be at least two increasing numbers, got {list(values)}")
