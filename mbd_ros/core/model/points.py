"""Points on links, and pairs of points, that parts define when they are built.

A `Point` is a handle with a number; the kinematics k of a state answers for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError


class Places:
    """Registry of all points and pairs of a robot, in the order of their numbers.

    Args:
        model: Pinocchio model of the robot.

    Attributes:
        points: Place of every point.
        pairs: Places of a and b, and columns, of every pair.
    """

    def __init__(self, model: Any) -> None:
        self.points: list[Place] = []
        self.pairs: list[tuple[Place, Place, Array]] = []
        self._model = model
        self._numbers: dict[tuple[int, bytes], int] = {}
        self._pair_numbers: dict[tuple[int, int], int] = {}

    def point(self, frame: str, place: Place) -> Point:
        """Return the point of a link at a place; equal places share one number."""
        key = place.joint, place.at.homogeneous.tobytes()
        number = self._numbers.setdefault(key, len(self.points))
        if number == len(self.points):
            self.points.append(place)
        return Point(number, frame, place.joint != 0)

    def both(self, numbers: tuple[int, int]) -> tuple[Place, Place]:
        """Return the places of two points."""
        return self.points[numbers[0]], self.points[numbers[1]]

    def pair(self, a: Point, b: Point) -> Pair:
        """Return the pair of two points.

        Raises:
            ModelError: The points have no relative motion.
        """
        columns = self._columns(b) - self._columns(a)
        if not columns.any():
            raise ModelError(f"frames '{a.frame}' and '{b.frame}' have no relative motion")
        number = self._pair_numbers.setdefault((a.number, b.number), len(self.pairs))
        if number == len(self.pairs):
            self.pairs.append((self.points[a.number], self.points[b.number], columns))
        return Pair(number, a, b, columns)

    def _columns(self, point: Point) -> Array:
        """Return 1 for velocity coordinates that move a point and 0 for others, shape (nv,)."""
        columns = np.zeros(self._model.nv)
        for j in self._model.supports[self.points[point.number].joint]:
            joint = self._model.joints[j]
            if j:
                columns[joint.idx_v : joint.idx_v + joint.nv] = 1.0
        return columns


class Place(NamedTuple):
    """Position and axes of a point in the frame of the joint that carries it.

    Attributes:
        joint: Index of that joint, 0 for a fixed point.
        at: `pinocchio.SE3` of the axes of the point in the frame of the joint.
    """

    joint: int
    at: Any


class Point(NamedTuple):
    """A point with axes, fixed to a link.

    Attributes:
        number: Number of the point; points that always coincide share it.
        frame: Name of the link.
        moves: Whether any joint moves the point.
    """

    number: int
    frame: str
    moves: bool


class Pair(NamedTuple):
    """Two points in relative motion: b as seen from the axes of a.

    Attributes:
        number: Number of the pair.
        a: Point of the observer.
        b: Observed point.
        columns: 1 for velocity coordinates that move only b, -1 for those that move only a, 0 for
            others, shape (nv,).
    """

    number: int
    a: Point
    b: Point
    columns: Array


def rotation_matrix(rpy: Sequence[float]) -> Array:
    """Return the rotation matrix of roll, pitch and yaw as in URDF [rad], shape (3, 3)."""
    rotation: Array = pin.rpy.rpyToMatrix(*map(float, rpy))
    return rotation
