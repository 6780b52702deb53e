"""The cubic spline of SIMM and OpenSim, in which published models give knees and moving points."""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.model.coupling_functions import (
    PiecewisePolynomial,
    checked_points,
    through,
    tridiagonal,
)


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
