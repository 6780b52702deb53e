"""Surfaces that stand in common axes, and geodesics on them."""

from typing import NamedTuple

import numpy as np

from mbd_ros.core.paths.wrapping.surface import Mask, Numbers, Surface
from mbd_ros.core.state import Array


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

    def of(self, samples: Numbers | Mask) -> "Placed":
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
    def along(surface: Surface, start: Array, direction: Array, length: Array) -> "Arc":
        """The geodesic of a surface from a point along a tangent."""
        flow = surface.flow(start, direction, length)
        return Arc(start, direction, length, flow.middle, flow.end)

    def of(self, samples: Numbers | Mask) -> "Arc":
        """The same at some of the samples."""
        return Arc(*(value[samples] for value in self))
