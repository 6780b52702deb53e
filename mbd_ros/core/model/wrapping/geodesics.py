"""Geodesics of smooth surfaces by Picard's iteration on Chebyshev nodes.

x'' = -(t . S t) n with the unit tangent t, and Jacobi's equation y'' = -K y beside it. Iterations
converge as l^2k / (2k)!, for all samples in the same calls.

Source: C. W. Clenshaw, H. J. Norton, The solution of nonlinear ordinary differential equations in
Chebyshev series, Comput. J. 6, 1963, 88; M. P. do Carmo, Riemannian Geometry, 1992, ch. 5.
"""

from collections.abc import Callable
from functools import cache

import numpy as np

from mbd_ros.core.model.wrapping.surface import Flow
from mbd_ros.core.state import Array

Curving = Callable[[Array, Array], tuple[Array, Array]]
_NODES = (16, 32, 64, 128)  # intervals, more until the series ends
_MOST = 80  # iterations
_TOLERANCE = 1.0e-15  # of a step, in the farthest coordinate
_TAIL = 1.0e-13  # largest end of the series


@cache
def _nodes(count: int) -> tuple[Array, Array, Array]:
    """Nodes on [0, 1], the integral from 0 to each of them, and the end of the series."""
    chebyshev = np.polynomial.chebyshev
    x = -np.cos(np.pi * np.arange(count + 1) / count)
    to_series = np.array(np.linalg.inv(chebyshev.chebvander(x, count)), dtype=np.float64)
    series = chebyshev.chebint(to_series, lbnd=-1.0, axis=0)
    integral: Array = np.array(0.5 * chebyshev.chebval(x, series).T, dtype=np.float64)
    return (x + 1.0) / 2.0, integral, to_series[-3:]


def geodesics(curving: Curving, start: Array, direction: Array, arc: Array, size: float) -> Flow:
    """Follow geodesics.

    Args:
        curving: (points, unit tangents), both (.., 3) -> curvature vectors x'' and K.
        start: On the surface [m], shape (n, 3).
        direction: Unit tangents there, shape (n, 3).
        arc: Lengths [m], shape (n,).
        size: Of the surface [m].
    """
    for count in _NODES:
        points, tangents, tail = _curves(curving, (start, direction), arc, size, count)
        if tail < _TAIL or count == _NODES[-1]:
            break
    _, gauss = curving(points, tangents)
    shifted, turned = _offsets(gauss, arc, count)
    return Flow(points[:, -1], tangents[:, -1], shifted, turned)


def _curves(
    curving: Curving, begin: tuple[Array, Array], arc: Array, size: float, count: int
) -> tuple[Array, Array, float]:
    """Points and tangents at the nodes, and the end of the series of curvature vectors."""
    at, integral, last = _nodes(count)
    (start, direction), whole = begin, arc[:, None, None]
    first, bent = start[:, None, :], whole * direction[:, None, :]
    tangents = np.broadcast_to(direction[:, None, :], (len(arc), count + 1, 3))
    pulls, _ = curving(first, direction[:, None, :])
    enough = _TOLERANCE * max(size, np.abs(start).max(initial=0.0))
    points = first + at[:, None] * (bent + 0.5 * whole * whole * at[:, None] * pulls)
    for _ in range(_MOST):
        pulls, _ = curving(points, tangents)
        tangents = direction[:, None, :] + whole * (integral @ pulls)
        following = first + whole * (integral @ tangents)
        change = np.abs(following - points).max(initial=0.0)
        points = following
        if not change > enough:
            break
    tail = np.abs(last @ (whole * whole * pulls)).max(initial=0.0) / size
    return points, tangents, float(tail)


def _offsets(gauss: Array, arc: Array, count: int) -> tuple[Array, Array]:
    """The two Jacobi fields at the end, each with its slope, shape (n, 2)."""
    at, integral, _ = _nodes(count)
    weight = (-(arc[:, None] ** 2) * gauss)[:, None, :]
    free = np.stack((np.ones(count + 1), at))  # in y, and in y / l
    fields = np.broadcast_to(free, (len(arc), 2, count + 1))
    for _ in range(_MOST):
        slopes = (weight * fields) @ integral.T
        following = free + slopes @ integral.T
        change = np.abs(following - fields).max(initial=0.0)
        fields = following
        if not change > _TOLERANCE:
            break
    end, slope = fields[:, :, -1], slopes[:, :, -1] + (0.0, 1.0)
    over = np.where(arc != 0.0, arc, 1.0)
    shifted = np.stack((end[:, 0], slope[:, 0] / over), axis=-1)
    return shifted, np.stack((end[:, 1] * arc, slope[:, 1]), axis=-1)
