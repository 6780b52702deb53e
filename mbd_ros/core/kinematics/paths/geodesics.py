"""Geodesics of smooth surfaces by Picard's iteration on Chebyshev nodes.

x'' = -(t . S t) n with the unit tangent t, and Jacobi's equation y'' = -K y beside it. Iterations
converge as l^2k / (2k)!, for all samples in the same calls: arrays are (3, nodes, n), so that
integrals are products of matrices.

Source: C. W. Clenshaw, H. J. Norton, The solution of nonlinear ordinary differential equations in
Chebyshev series, Comput. J. 6, 1963, 88; M. P. do Carmo, Riemannian Geometry, 1992, ch. 5.
"""

from collections.abc import Callable
from functools import cache

import numpy as np

from mbd_ros.core.kinematics.paths.wrap_surface import Flow
from mbd_ros.core.state import Array

Curving = Callable[[Array, Array], tuple[Array, Array]]
_NODES = ((8, 0.4), (12, 1.2), (16, 2.0), (24, 4.0), (32, 6.0), (64, 12.0), (128, np.inf))
_MOST = 80  # iterations
_TOLERANCE = 1.0e-15  # of a step, in the farthest coordinate
_NEAR, _STALL = 1.0e-13, 0.3  # steps that rounding keeps from getting smaller
_FIELDS = 1.0e-13  # of a step of Jacobi fields, which steer Newton's method
_TAIL = 1.0e-11  # largest end of the series of slopes; the curve has its second integral


def geodesics(
    curving: Curving, start: Array, direction: Array, arc: Array, sharpest: float
) -> Flow:
    """Follow geodesics.

    Args:
        curving: (points, unit tangents), both (3, ..) -> curvature vectors x'' and K.
        start: On the surface [m], shape (n, 3).
        direction: Unit tangents there, shape (n, 3).
        arc: Lengths [m], shape (n,).
        sharpest: About the largest curvature of the surface [1/m].
    """
    turn = sharpest * np.abs(arc).max(initial=0.0)
    for count, enough in _NODES:
        if not turn > enough:
            points, tangents, tail = _curves(curving, (start.T, direction.T), arc, count)
            if tail < _TAIL or count == _NODES[-1][0]:
                break
    _, gauss = curving(points, tangents)
    shifted, turned = _offsets(gauss, arc, count)
    middle = points[:, count // 2].T
    return Flow(points[:, -1].T, tangents[:, -1].T, shifted, turned, middle)


def _curves(
    curving: Curving, begin: tuple[Array, Array], arc: Array, count: int
) -> tuple[Array, Array, float]:
    """Points and tangents at the nodes, and the end of the series of curvature vectors."""
    at, integral, last = _nodes(count)
    start, direction = (value[:, None, :] for value in begin)
    size = max(np.abs(start).max(initial=0.0), np.abs(arc).max(initial=0.0))
    before = np.inf
    pulls, _ = curving(start, direction)
    way = at[:, None] * arc
    points = start + way * direction + 0.5 * way * way * pulls
    tangents = np.broadcast_to(direction, points.shape)
    for _ in range(_MOST):
        pulls, _ = curving(points, tangents)
        tangents = direction + arc * (integral @ pulls)
        tangents = tangents / np.sqrt(dot3(tangents, tangents))
        following = start + arc * (integral @ tangents)
        change = np.abs(following - points).max(initial=0.0)
        points = following
        if not change > _TOLERANCE * size or _STALL * before < change < _NEAR * size:
            break
        before = change
    tail = np.abs(last @ (arc * pulls)).max(initial=0.0)
    return points, tangents, float(tail)


@cache
def _nodes(count: int) -> tuple[Array, Array, Array]:
    """Nodes on [0, 1], the integral from 0 to each of them, and the end of the series."""
    chebyshev = np.polynomial.chebyshev
    x = -np.cos(np.pi * np.arange(count + 1) / count)
    to_series = np.array(np.linalg.inv(chebyshev.chebvander(x, count)), dtype=np.float64)
    series = chebyshev.chebint(to_series, lbnd=-1.0, axis=0)
    integral = np.array(0.5 * chebyshev.chebval(x, series).T, dtype=np.float64)
    return (x + 1.0) / 2.0, integral, to_series[-3:]


def dot3(a: Array, b: Array) -> Array:
    """Scalar products of vectors whose components stand in the first axis."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def _offsets(gauss: Array, arc: Array, count: int) -> tuple[Array, Array]:
    """The two Jacobi fields at the end, each with its slope, shape (n, 2)."""
    at, integral, _ = _nodes(count)
    weight = -(arc**2) * gauss
    free = np.stack((np.ones(count + 1), at))[:, :, None]  # in y, and in y / l
    fields = free
    for _ in range(_MOST):
        slopes = integral @ (weight * fields)
        following = free + integral @ slopes
        change = np.abs(following - fields).max(initial=0.0)
        fields = following
        if not change > _FIELDS:
            break
    over = np.where(arc != 0.0, arc, 1.0)
    shifted = np.stack((fields[0, -1], slopes[0, -1] / over), axis=-1)
    return shifted, np.stack((fields[1, -1] * arc, slopes[1, -1] + 1.0), axis=-1)
