"""Curves of muscles made of quintic Bezier segments, and functions of arrays.

A segment goes from one point to another, leaves along the tangent of the first and arrives along
that of the second. Its middle control points stand in pairs on these tangents, so that curvature
is 0 at both ends, and segments one behind the other have two continuous derivatives. With the ends
b0, b5 and the paired points b12, b34 each coordinate is, over 0 <= s <= 1,

    b(s) = b0 (1-s)^5 + b12 (5 s (1-s)^4 + 10 s^2 (1-s)^3)
         + b34 (10 s^3 (1-s)^2 + 5 s^4 (1-s)) + b5 s^5

Source: M. Millard, T. Uchida, A. Seth, S. L. Delp, Flexing computational muscle: modeling and
simulation of musculotendon dynamics, J. Biomech. Eng. 135, 2013, 021005, doi:10.1115/1.4023390;
G. Farin, Curves and Surfaces for CAGD, 2002, ch. 5.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.state import Array

_HALLEY = 6  # corrections of s; each triples the digits, four suffice for most segments
_LAST = 1.0e-6  # a correction of this size leaves its cube
_GAUSS = (  # places and weights between 0 and 1, exact up to degree 11
    (0.03376524289842399, 0.08566224618958518),
    (0.16939530676686775, 0.1803807865240693),
    (0.3806904069584015, 0.23395696728634552),
    (0.6193095930415985, 0.23395696728634552),
    (0.8306046932331322, 0.1803807865240693),
    (0.966234757101576, 0.08566224618958518),
)
_LEAST, _MOST = 0.1, 0.9  # share of the way to the corner that curviness 0 and 1 stand for
Number = Any  # float, symbol or array


class BezierCurve:
    """Knots joined by segments, straight before the first and after the last.

    Args:
        knots: At least two, x increasing.
        curviness: 0 .. 1, one a segment: how far it goes into the corner of its tangents.

    Attributes:
        key: Equal where curves are.
    """

    def __init__(self, knots: Sequence[Knot], curviness: Sequence[Number]) -> None:
        self.knots = tuple(knots)
        self.key = self.knots, tuple(curviness)
        ends = zip(knots[:-1], knots[1:], curviness, strict=True)
        self._segments = [_segment(*each) for each in ends]

    def __call__(self, k: Any, x: Number) -> Number:
        """Y at x.

        Args:
            k: Functions of numbers, symbols or arrays.
        """
        breaks = [knot.x for knot in self.knots[1:-1]]
        row = k.piece(x, breaks, self._segments)
        s = Piece(*row[:4]).where(k, x)
        before, after = self._beyond(k, x)
        first, last = self.knots[0], self.knots[-1]
        return Piece(*row[4:]).at(s)[0] + first.slope * before + last.slope * after

    def area(self, k: Any, x: Number) -> Number:
        """Integral of y from the first knot to x."""
        breaks = [knot.x for knot in self.knots[1:-1]]
        sums = [0.0]
        for segment in self._segments[:-1]:
            sums.append(sums[-1] + _area(segment, 1.0))
        rows = [(*each, total) for each, total in zip(self._segments, sums, strict=True)]
        row = k.piece(x, breaks, rows)
        s = Piece(*row[:4]).where(k, x)
        integral = row[8] + _area(row[:8], s)
        before, after = self._beyond(k, x)
        for knot, d in ((self.knots[0], before), (self.knots[-1], after)):
            integral = integral + d * (knot.y + 0.5 * knot.slope * d)
        return integral

    def balanced(self, k: Any, scale: Number, factor: Number, sum_: Number) -> Number:
        """The x at which scale y(x) + factor x is a sum, where that increases with x.

        Along a segment both terms are polynomials of the same s: one equation, no iteration about
        another.

        Args:
            k: Functions of numbers, symbols or arrays.
            scale: >= 0.
            factor: >= 0; greater than 0 where `scale` or a slope is 0.
            sum_: The wanted sum.
        """
        breaks = [scale * knot.y + factor * knot.x for knot in self.knots[1:-1]]
        row = k.piece(sum_, breaks, self._segments)
        along, over = Piece(*row[:4]), Piece(*row[4:])
        s = over.beside(scale, along, factor).where(k, sum_)
        abscissa = along.at(s)[0]
        for knot, side in ((self.knots[0], k.minimum), (self.knots[-1], k.maximum)):
            lack = side(sum_ - (scale * knot.y + factor * knot.x), 0.0)
            abscissa = abscissa + lack / (scale * knot.slope + factor)
        return abscissa

    def _beyond(self, k: Any, x: Number) -> tuple[Number, Number]:
        """How far x is before the first knot, negative, and after the last one."""
        first, last = self.knots[0], self.knots[-1]
        return k.minimum(x - first.x, 0.0), k.maximum(x - last.x, 0.0)


def _segment(a: Knot, b: Knot, curviness: Number) -> tuple[Number, ...]:
    """Both coordinates of a segment, shape (8,)."""
    x = (b.y - a.y - b.x * b.slope + a.x * a.slope) / (a.slope - b.slope)
    y = (x - b.x) * b.slope + b.y
    share = _LEAST + (_MOST - _LEAST) * curviness
    along = (a.x, a.x + share * (x - a.x), b.x + share * (x - b.x), b.x)
    over = (a.y, a.y + share * (y - a.y), b.y + share * (y - b.y), b.y)
    return (*along, *over)


def _area(segment: Sequence[Number], s: Number) -> Number:
    """Integral of y dx over a segment up to s, a polynomial of degree 10."""
    along, over = Piece(*segment[:4]), Piece(*segment[4:])
    return s * sum(w * over.at(g * s)[0] * along.at(g * s)[1] for g, w in _GAUSS)


class Knot(NamedTuple):
    """Where two segments meet.

    Attributes:
        slope: dy/dx.
    """

    x: Number
    y: Number
    slope: Number


class Piece(NamedTuple):
    """One coordinate of a segment.

    Attributes:
        b0: Where it begins.
        b12: Its first pair of control points.
        b34: Its second pair.
        b5: Where it ends.
    """

    b0: Number
    b12: Number
    b34: Number
    b5: Number

    def at(self, s: Number) -> tuple[Number, Number, Number]:
        """b, db/ds and d2b/ds2."""
        r = 1.0 - s
        p, q, d = self.b12 - self.b0, self.b34 - self.b12, self.b5 - self.b34
        s2, r2 = s * s, r * r
        value = (
            self.b0
            + p * (1.0 - r2 * r2 * r)
            + q * s2 * s * (10.0 + s * (6.0 * s - 15.0))
            + d * s2 * s2 * s
        )
        slope = 5.0 * (p * r2 * r2 + 6.0 * q * s2 * r2 + d * s2 * s2)
        bend = 20.0 * (d * s2 * s - p * r2 * r + 3.0 * q * s * r * (r - s))
        return value, slope, bend

    def beside(self, scale: Number, other: Piece, factor: Number) -> Piece:
        """Scale times this one plus factor times another."""
        pairs = zip(self, other, strict=True)
        return Piece(*(scale * one + factor * more for one, more in pairs))

    def where(self, k: Any, value: Number) -> Number:
        """The s in 0 .. 1 at which an increasing b has a value, by Halley's method."""
        span = self.b5 - self.b0
        s = k.minimum(k.maximum((value - self.b0) / span, 0.0), 1.0)
        for _ in range(_HALLEY):
            b, slope, bend = self.at(s)
            lack = b - value
            step = 2.0 * lack * slope / (2.0 * slope * slope - lack * bend)
            s = k.minimum(k.maximum(s - step, 0.0), 1.0)
            if isinstance(step, float) and -_LAST < step < _LAST:
                break
        return s


class ArrayNumbers:
    """Piecewise evaluation for arrays: one entry a muscle, a sample or both."""

    exp, log, sqrt, tanh = np.exp, np.log, np.sqrt, np.tanh
    maximum, minimum, where = np.maximum, np.minimum, np.where

    @staticmethod
    def piece(x: Array, breaks: Sequence[Any], rows: Sequence[Sequence[Any]]) -> list[Any]:
        """Select pieces as `Kinematics.piece` does, entry by entry."""
        chosen = list(rows[0])
        for left, row in zip(breaks, rows[1:], strict=True):
            after = x >= left
            chosen = [
                new if new is old else np.where(after, new, old)
                for new, old in zip(row, chosen, strict=True)
            ]
        return chosen
