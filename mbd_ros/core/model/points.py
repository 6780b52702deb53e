"""Points on links and pairs of them: what parts bind while they are built and ask k about.

A handle is a number that `Robot` gives; every `Kinematics` binds its calls to it once.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError


class Places:
    """All points and pairs of a robot, in the order of their numbers.

    Args:
        model: Pinocchio model of the robot.

    Attributes:
        points: Where every point stands.
        pairs: Where a and b of every pair stand, and its columns.
    """

    def __init__(self, model: Any) -> None:
        self.points: list[Place] = []
        self.pairs: list[tuple[Place, Place, Array]] = []
        self._model = model
        self._numbers: dict[tuple[int, bytes], int] = {}
        self._pair_numbers: dict[tuple[int, int], int] = {}

    def point(self, frame: str, place: Place) -> Point:
        """The point of a link at a place."""
        key = place.joint, place.at.homogeneous.tobytes()
        number = self._numbers.setdefault(key, len(self.points))
        if number == len(self.points):
            self.points.append(place)
        return Point(number, frame, place.joint != 0)

    def both(self, numbers: tuple[int, int]) -> tuple[Place, Place]:
        """Where two points stand."""
        return self.points[numbers[0]], self.points[numbers[1]]

    def pair(self, a: Point, b: Point) -> Pair:
        """The pair of two points.

        Raises:
            ModelError: They do not move against each other.
        """
        columns = self._columns(b) - self._columns(a)
        if not columns.any():
            raise ModelError(f"frames '{a.frame}' and '{b.frame}' do not move against each other")
        number = self._pair_numbers.setdefault((a.number, b.number), len(self.pairs))
        if number == len(self.pairs):
            self.pairs.append((self.points[a.number], self.points[b.number], columns))
        return Pair(number, a, b, columns)

    def _columns(self, point: Point) -> Array:
        """1 for the velocity coordinates that move a point, else 0, shape (nv,)."""
        columns = np.zeros(self._model.nv)
        for j in self._model.supports[self.points[point.number].joint]:
            joint = self._model.joints[j]
            if j:
                columns[joint.idx_v : joint.idx_v + joint.nv] = 1.0
        return columns


class Place(NamedTuple):
    """Where a point stands in the model.

    Attributes:
        joint: Index of the joint that carries it, 0 at rest.
        at: `pinocchio.SE3` of its axes in the frame of that joint.
    """

    joint: int
    at: Any


class Point(NamedTuple):
    """A point of a link, with axes that turn with the link.

    Attributes:
        number: Of the point, the same for points that coincide for ever.
        frame: Name of the link.
        moves: Whether any joint moves it.
    """

    number: int
    frame: str
    moves: bool


class Pair(NamedTuple):
    """Two points that joints move against each other: b as an observer on a sees it.

    Attributes:
        number: Of the pair.
        b: What is observed.
        columns: 1 for the velocity coordinates that move b alone, -1 for those that move a alone,
            else 0, shape (nv,).
    """

    number: int
    a: Point
    b: Point
    columns: Array


def rotation_matrix(rpy: Sequence[float]) -> Array:
    """Rotation by roll, pitch and yaw as in URDF [rad], shape (3, 3)."""
    rotation: Array = pin.rpy.rpyToMatrix(*map(float, rpy))
    return rotation
