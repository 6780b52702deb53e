"""The contract of surfaces that paths wrap over.

All functions work on n samples at once, in the axes of the surface, with points of shape (n, 3).
Normals n point outwards. A curve on the surface has a unit tangent t and the binormal b = t x n.
"""

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array

Mask = NDArray[np.bool_]
Numbers = NDArray[np.intp]
Side = Literal["all", "x", "-x", "y", "-y", "z", "-z"]
NO_WRAP, MAY_WRAP, MUST_WRAP = 0, 1, 2


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


def dot3(a: Array, b: Array) -> Array:
    """Products of vectors whose components stand in the first axis."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def dot(a: Array, b: Array) -> Array:
    """Products row by row, shape (n,)."""
    return np.asarray(np.einsum("...i,...i->...", a, b))


def unit(vectors: Array) -> Array:
    """Rows of length 1; zero where they have none."""
    length = np.sqrt(dot(vectors, vectors))[..., None]
    return np.asarray(vectors / np.where(length > 0.0, length, 1.0))


def cross(a: Array, b: Array) -> Array:
    """Vector products row by row, shape (n, 3); faster than numpy's."""
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    product = np.empty(np.broadcast_shapes(a.shape, b.shape))
    product[..., 0] = a1 * b2 - a2 * b1
    product[..., 1] = a2 * b0 - a0 * b2
    product[..., 2] = a0 * b1 - a1 * b0
    return product


def across(axis_of: Array) -> Array:
    """A unit vector square to every row, along no axis in particular, shape (n, 3)."""
    least = np.eye(3)[np.argmin(np.abs(axis_of), axis=-1)]
    return unit(cross(axis_of, least))
