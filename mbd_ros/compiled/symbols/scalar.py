"""Numbers and arrays that parts calculate with while they are traced.

They stand in numpy arrays of objects, so that parts index, stack and multiply them as they do
numbers. What is known stays a float, so zeros and ones cost nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols.tree.link_rotations import Matrix
from mbd_ros.compiled.symbols.untraceable import Untraceable

Number = Any  # float or Scalar
MOST_PIECES = 1000  # numbers of a table that is traced: each costs four operations


class Scalar:
    """A symbolic number.

    Args:
        sx: Its expression, a `casadi.SX` of one entry.
    """

    __array_ufunc__ = None  # an array of objects asks entry by entry
    __slots__ = ("sx",)

    def __init__(self, sx: Any) -> None:
        self.sx = sx

    def __add__(self, other: Any) -> Any:
        if isinstance(other, np.ndarray):
            return _each(other, lambda entry: self + entry)
        if _is(other, 0.0):
            return self
        return other if _is_infinite(other) else number(self.sx + plain(other))

    def __radd__(self, other: Any) -> Any:
        return self + other

    def __sub__(self, other: Any) -> Any:
        if isinstance(other, np.ndarray):
            return _each(other, lambda entry: self - entry)
        if _is(other, 0.0):
            return self
        return -other if _is_infinite(other) else number(self.sx - plain(other))

    def __rsub__(self, other: Any) -> Any:
        if isinstance(other, np.ndarray):
            return _each(other, lambda entry: entry - self)
        if _is(other, 0.0):
            return -self
        return other if _is_infinite(other) else number(plain(other) - self.sx)

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, np.ndarray):
            return _each(other, lambda entry: self * entry)
        if _is(other, 0.0):
            return 0.0
        return self if _is(other, 1.0) else number(self.sx * plain(other))

    def __rmul__(self, other: Any) -> Any:
        return self * other

    def __truediv__(self, other: Any) -> Any:
        if isinstance(other, np.ndarray):
            return _each(other, lambda entry: self / entry)
        return self if _is(other, 1.0) else number(self.sx / plain(other))

    def __rtruediv__(self, other: Any) -> Any:
        if isinstance(other, np.ndarray):
            return _each(other, lambda entry: entry / self)
        return 0.0 if _is(other, 0.0) else number(plain(other) / self.sx)

    def __pow__(self, other: Any) -> Any:
        return number(self.sx ** plain(other))

    def __rpow__(self, other: Any) -> Any:
        return number(plain(other) ** self.sx)

    def __neg__(self) -> Any:
        return number(-self.sx)

    def __pos__(self) -> Scalar:
        return self

    def __abs__(self) -> Any:
        return number(ca.fabs(self.sx))

    def __lt__(self, other: Any) -> Any:
        return other > 0.0 if _is_infinite(other) else number(self.sx < plain(other))

    def __le__(self, other: Any) -> Any:
        return other > 0.0 if _is_infinite(other) else number(self.sx <= plain(other))

    def __gt__(self, other: Any) -> Any:
        return other < 0.0 if _is_infinite(other) else number(self.sx > plain(other))

    def __ge__(self, other: Any) -> Any:
        return other < 0.0 if _is_infinite(other) else number(self.sx >= plain(other))

    def __eq__(self, other: object) -> Any:
        return number(self.sx == plain(other))

    def __ne__(self, other: object) -> Any:
        return number(self.sx != plain(other))

    __hash__ = None  # type: ignore[assignment]

    def __bool__(self) -> bool:
        raise Untraceable("it branches on a number that depends on the state")

    def __float__(self) -> float:
        raise Untraceable("it needs the value of a number that depends on the state")

    def __index__(self) -> int:
        raise Untraceable("it needs the value of a number that depends on the state")

    def sqrt(self) -> Any:
        """Its square root."""
        return number(ca.sqrt(self.sx))

    def sin(self) -> Any:
        """Its sine, as `numpy.sin` asks for it."""
        return number(ca.sin(self.sx))

    def cos(self) -> Any:
        """Its cosine, as `numpy.cos` asks for it."""
        return number(ca.cos(self.sx))

    def item(self) -> Scalar:
        """Itself, as for a numpy number."""
        return self

    def piecewise(self, breaks: Iterable[float], rows: Any) -> list[Number]:
        """The row of the interval that it is in, entry by entry.

        Args:
            breaks: Inner ends of the intervals, increasing, n - 1.
            rows: One an interval, shape (n, k).
        """
        inner, chosen = list(breaks), list(rows[0])
        if len(inner) * len(chosen) > MOST_PIECES:
            raise Untraceable(
                f"its table has {len(inner)} intervals; {MOST_PIECES // len(chosen)} are traced"
            )
        for left, row in zip(inner, list(rows)[1:], strict=True):
            chosen = [where(self >= left, new, old) for new, old in zip(row, chosen, strict=True)]
        return chosen


def _each(array: Any, rule: Callable[[Any], Any]) -> Any:
    return _filled(array.shape, (rule(entry) for entry in array.ravel().tolist()))


def _filled(shape: tuple[int, ...], values: Iterable[Any]) -> Any:
    result = np.empty(shape, dtype=object)
    flat = result.reshape(-1)
    for i, value in enumerate(values):
        flat[i] = value
    return result


def _is(value: Any, known: float) -> bool:
    return isinstance(value, float | int | np.floating) and value == known


def _is_infinite(value: Any) -> bool:
    """Whether a finite number changes nothing in it."""
    return isinstance(value, float | np.floating) and math.isinf(value)


def number(sx: Any) -> Number:
    """A float where the value is known, else a `Scalar`."""
    return float(sx) if sx.is_constant() else Scalar(sx)


def plain(value: Any) -> Any:
    """Return the form with which CasADi calculates."""
    if isinstance(value, Scalar):
        return value.sx
    return value.item() if isinstance(value, np.generic | np.ndarray) else value


def where(condition: Any, first: Any, second: Any) -> Any:
    """The first value where a condition holds, else the second; arrays entry by entry."""
    if not isinstance(condition, Scalar):
        return first if condition else second
    if isinstance(first, np.ndarray) or isinstance(second, np.ndarray):
        entry, other = np.broadcast_arrays(first, second)
        pairs = zip(entry.ravel(), other.ravel(), strict=True)
        return _filled(entry.shape, (where(condition, a, b) for a, b in pairs))
    a, b = plain(first), plain(second)
    if not isinstance(first, Scalar) and not isinstance(second, Scalar) and a == b:
        return first
    return number(ca.if_else(condition.sx, a, b))


def numbers(column: Any) -> Any:
    """A CasADi column as a numpy vector of objects."""
    result = np.empty(column.shape[0], dtype=object)
    for i, entry in enumerate(scalars(column)):
        result[i] = number(entry)
    return result


def scalars(column: Any) -> list[Any]:
    """A CasADi column as SX scalars."""
    return list(ca.vertsplit(column)) if column.shape[0] else []


def column(values: Iterable[Number]) -> Any:
    """Numbers as a CasADi column."""
    return ca.vertcat(*(ca.SX(plain(value)) for value in values), ca.SX(0, 1))


def function(casadi: Callable[..., Any], known: Callable[..., float]) -> Callable[..., Any]:
    """A function of numbers that may be symbols."""

    def evaluate(*values: Any) -> Any:
        if any(isinstance(value, Scalar) for value in values):
            return number(casadi(*(ca.SX(plain(value)) for value in values)))
        return known(*values)

    return evaluate


def matrix(rows: Matrix) -> Any:
    """Nine expressions as an array of numbers, shape (3, 3)."""
    return np.array([objects(row) for row in rows], dtype=object)


def objects(values: Sequence[Any]) -> Any:
    """Expressions as a vector of numbers."""
    result = np.empty(len(values), dtype=object)
    for i, value in enumerate(values):
        result[i] = number(value)
    return result
