"""The contract of surfaces that paths wrap over, where they stand, and geodesics on them.

All functions work on n samples at once, in the axes of the surface, with points of shape (n, 3).
Normals n point outwards. A curve on the surface has a unit tangent t and the binormal b = t x n.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.points import Point
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array

Mask = NDArray[np.bool_]
Numbers = NDArray[np.intp]
Side = Literal["all", "x", "-x", "y", "-y", "z", "-z"]
NO_WRAP, MAY_WRAP, MUST_WRAP = 0, 1, 2
Curving = Callable[[Array, Array], tuple[Array, Array]]
_NODES = ((8, 0.4), (12, 1.2), (16, 2.0), (24, 4.0), (32, 6.0), (64, 12.0), (128, np.inf))
_MOST = 80  # iterations
_TOLERANCE = 1.0e-15  # of a step, in the farthest coordinate
_NEAR, _STALL = 1.0e-13, 0.3  # steps that rounding keeps from getting smaller
_FIELDS = 1.0e-13  # of a step of Jacobi fields, which steer Newton's method
_TAIL = 1.0e-11  # largest end of the series of slopes; the curve has its second integral


class Surface:
    """A convex body, or the inner side of a ring, that paths lie on without friction.

    Args:
        side: Half that the path must go over, or all.

    Attributes:
        size: A length that is typical of it [m].
        is_closed_form: Whether `touch` gives the shortest path between two points as it is.
    """

    size: float
    is_closed_form = False

    def __init__(self, side: Side) -> None:
        self.axis = "xyz".index(side[-1]) if side != "all" else 0
        self.sign = {"a": 0.0, "-": -1.0}.get(side[0], 1.0)

    def holds(self, points: Array) -> Mask:
        """Whether points are inside, shape (n,)."""
        raise NotImplementedError

    def meets(self, a: Array, b: Array) -> Numbers:
        """Return `NO_WRAP`, `MAY_WRAP` or `MUST_WRAP` for paths from a to b, shape (n,)."""
        raise NotImplementedError

    def touch(self, a: Array, b: Array, code: Numbers) -> Touch:
        """Where a path from a to b touches it, with what `meets` says."""
        raise NotImplementedError

    def plain(self, a: Array, b: Array) -> Touch:
        """Return the contact of `touch` on the nearer side."""
        return self.touch(a, b, self.meets(a, b))

    def normal(self, points: Array) -> Array:
        """Unit outward normals of points on the surface, shape (n, 3)."""
        raise NotImplementedError

    def bend(self, points: Array, along: Array) -> Array:
        """Change of the normal along tangents: dn = S v, shape (n, 3)."""
        raise NotImplementedError

    def nearest(self, points: Array) -> Array:
        """Points on the surface, as near to points beside it as squares of offsets, (n, 3)."""
        raise NotImplementedError

    def flow(self, start: Array, direction: Array, arc: Array) -> Flow:
        """Geodesics from points along tangents over given lengths [m]."""
        raise NotImplementedError

    def on_side(self, points: Array) -> Mask:
        """Whether points are on the half that the path must go over, shape (n,)."""
        return np.equal(points[:, self.axis] >= 0.0, self.sign > 0.0)


class Touch(NamedTuple):
    """How a line from a to b meets a surface.

    Attributes:
        code: `NO_WRAP`, `MAY_WRAP` (goes around it on the side that is asked for) or `MUST_WRAP`
            (the line meets it), shape (n,).
        start: First point of contact [m], shape (n, 3); any where nothing wraps.
        direction: Unit tangent there, shape (n, 3).
        arc: Length on the surface [m], shape (n,).
    """

    code: Numbers
    start: Array
    direction: Array
    arc: Array


class Flow(NamedTuple):
    """Ends of geodesics.

    Attributes:
        end: Last point [m], shape (n, 3).
        direction: Unit tangent there, shape (n, 3).
        shifted: Jacobi field that is 1 with slope 0 at the start: offset of the end [-] and its
            slope [1/m], shape (n, 2).
        turned: Jacobi field that is 0 with slope 1 at the start: [m] and [-], shape (n, 2).
        middle: Point half-way [m], shape (n, 3).
    """

    end: Array
    direction: Array
    shifted: Array
    turned: Array
    middle: Array


class Placed(NamedTuple):
    """A surface among others.

    Attributes:
        rotation: From its axes to common ones, shape (n, 3, 3).
        origin: Its origin in common axes [m], shape (n, 3).
    """

    surface: Surface
    rotation: Array
    origin: Array

    def inwards(self, points: Array) -> Array:
        """Points in the axes of the surface, shape (n, 3)."""
        return np.asarray(np.einsum("nji,nj->ni", self.rotation, points - self.origin))

    def outwards(self, points: Array) -> Array:
        """Points of the surface in common axes, shape (n, 3)."""
        return np.asarray(np.einsum("nij,nj->ni", self.rotation, points) + self.origin)

    def of(self, samples: Numbers | Mask) -> Placed:
        """The same at some of the samples."""
        return Placed(self.surface, self.rotation[samples], self.origin[samples])


class Arc(NamedTuple):
    """A geodesic in the axes of its surface.

    Attributes:
        start: First point [m], shape (n, 3).
        direction: Unit tangent there, shape (n, 3).
        length: Its length [m], shape (n,).
        middle: Point half-way [m], shape (n, 3).
        end: Last point [m], shape (n, 3).
    """

    start: Array
    direction: Array
    length: Array
    middle: Array
    end: Array

    @staticmethod
    def along(surface: Surface, start: Array, direction: Array, length: Array) -> Arc:
        """The geodesic of a surface from a point along a tangent."""
        flow = surface.flow(start, direction, length)
        return Arc(start, direction, length, flow.middle, flow.end)

    def of(self, samples: Numbers | Mask) -> Arc:
        """The same at some of the samples."""
        return Arc(*(value[samples] for value in self))


class Wrap:
    """A surface on a link that a path may wrap over.

    Args:
        name: For messages and tables.
        xyz: Its origin in the axes of the link [m], shape (3,).
        rpy: Its axes there as in URDF [rad], shape (3,).
        between: First and last of the points of the path between which it acts; None: all.
    """

    def __init__(
        self,
        robot: Robot,
        name: str,
        frame: str,
        surface: Surface,
        xyz: Sequence[float] = (0.0, 0.0, 0.0),
        rpy: Sequence[float] = (0.0, 0.0, 0.0),
        between: tuple[int, int] | None = None,
    ) -> None:
        self.name = name
        self.frame = frame
        self.surface = surface
        self.between = between
        self.point: Point = robot.point(frame, xyz, rpy)
        self.axes = [robot.shifted(self.point, axis) for axis in np.eye(3)]

    def placed(self, k: Kinematics) -> Placed:
        """Where it is, less `Robot.origin`."""
        return Placed(
            self.surface, k.rotation(self.point)[None], np.array(k.position(self.point))[None]
        )


class Reach(NamedTuple):
    """A surface, and the points between which it acts.

    Attributes:
        first: Index of the first point.
        last: Index of the last one.
    """

    surface: Surface
    first: int
    last: int


def geodesics(
    curving: Curving, start: Array, direction: Array, arc: Array, sharpest: float
) -> Flow:
    """Follow geodesics of a smooth surface, by Picard's iteration on Chebyshev nodes.

        x'' = -(t . S t) n,   y'' = -K y

    with the unit tangent t, and Jacobi's equation for the distance y of neighbours. Iterations
    converge as l^2k / (2k)!, for all samples in the same calls: arrays are (3, nodes, n), so that
    integrals are products of matrices. Sources: C. W. Clenshaw, H. J. Norton, Comput. J. 6 (1963)
    88; M. P. do Carmo, Riemannian Geometry, 1992, ch. 5.

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
