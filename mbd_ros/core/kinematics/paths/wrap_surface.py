"""The contract of surfaces that paths wrap over, where they stand, and geodesics on them.

All functions work on n samples at once, in the axes of the surface, with points of shape (n, 3).
Normals n point outwards. A curve on the surface has a unit tangent t and the binormal b = t x n.
"""

from __future__ import annotations

from collections.abc import Sequence
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
        """What a path from a to b does: `NO_WRAP`, `MAY_WRAP` or `MUST_WRAP`, shape (n,)."""
        raise NotImplementedError

    def touch(self, a: Array, b: Array, code: Numbers) -> Touch:
        """Where a path from a to b touches it, with what `meets` says."""
        raise NotImplementedError

    def plain(self, a: Array, b: Array) -> Touch:
        """As `touch`, on whichever side is nearer."""
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
        surface: The surface.
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
        surface: The surface.
        first: Index of the first point.
        last: Index of the last one.
    """

    surface: Surface
    first: int
    last: int
