"""Bound of the speed of gaps, by which contacts of distant bodies are screened out.

A gap changes by no more than the point nearest to the other body moves past it. With the velocity
v_i of each coordinate between two bodies,

    |g'| <= sum_i w_i |v_i|,   w_i = s_i + r_i d_i

s_i and r_i are the lengths of the linear and the angular part of its column of the motion
subspace, d_i the distance of that point from the origin of its joint. It is not longer than the
links between them, unless a joint between them slides.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.core.geometry.contact_pair import ContactPair
from mbd_ros.core.model.points import Pair
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.rows.constraint import Constraint
from mbd_ros.core.state import Array

_SHARE = 0.5  # of the largest distance, by which it may grow until it is measured again


class GapSpeed:
    """The weights w_i of several pairs of bodies.

    Args:
        robot: The robot.
        bodies: Pairs of bodies, and the largest distance of a point of b that may touch from the
            origin of b [m]; None where it is unknown.

    Attributes:
        weights: Bounds of the w_i while each gap changes by less than `room`, shape (n, nv).
        room: Change of each gap for which its weights are bounds [m], shape (n,); 0 until they are
            measured, and where nothing is known.
        turns: Angular lengths of the columns of the motion subspaces, shape (nv,).
    """

    def __init__(self, robot: Robot, bodies: Sequence[tuple[Pair, float] | None]) -> None:
        n, nv = len(bodies), int(robot.model.nv)
        self._carriers = [0] * n
        self._radii = np.full((n, 1), np.inf)
        between = np.zeros((n, nv))
        for i, each in enumerate(bodies):
            if each is not None:
                place = robot.places.points[each[0].b.number]
                self._carriers[i] = int(place.joint)
                self._radii[i] = each[1] + np.linalg.norm(place.at.translation)
                between[i] = np.abs(each[0].columns)
        linear, angular, self._joints = _subspaces(robot.model)
        self.turns = angular
        self._linear = between * linear
        self._angular = between * angular
        of = np.array([_links(robot.model, c, linear, self._joints) for c in self._carriers])
        self._most = of.reshape(n, nv) + self._radii
        self._is_known = np.isfinite(self._radii[:, 0])
        self._radii[~self._is_known] = 0.0
        self.weights = np.zeros((n, nv))
        self.room = np.zeros(n)
        self._length = np.zeros(n)

    @property
    def is_measured(self) -> bool:
        """Whether all weights are bounds."""
        return bool((self.room[self._is_known] > 0.0).all())

    def shortest(self, room: Array) -> float:
        """Return the length of a displacement of all joints that uses up no room [m, rad].

        Args:
            room: Room of the gaps [m], shape (n,).
        """
        least = np.minimum(room, self.room)
        return float((least / np.where(self._length > 0.0, self._length, 1.0)).min())

    def measure(self, data: Any) -> None:
        """Evaluate weights and room at a configuration.

        Args:
            data: Pinocchio data with placed joints.
        """
        origins = np.array([place.translation for place in data.oMi])
        offsets = origins[self._carriers][:, None] - origins[self._joints]
        distance = np.linalg.norm(offsets, axis=2) + self._radii
        turns = (self._angular > 0.0) & np.isinf(self._most)
        grows = _SHARE * np.where(turns, distance, 0.0).max(axis=1)
        lever = np.minimum(distance + grows[:, None], self._most)
        self.weights = self._linear + self._angular * lever
        self._length = np.linalg.norm(self.weights, axis=1)
        room = np.where(grows > 0.0, grows, np.inf)
        self.room = np.where(self._is_known, room, 0.0)


def bodies_of(part: Constraint) -> tuple[Pair, float] | None:
    """Return the bodies of a contact as `GapSpeed` takes them; None where they are unknown."""
    pair = part.pair
    if isinstance(pair, ContactPair) and pair.bodies[1] < math.inf:
        return pair.bodies
    return None


def _links(model: Any, carrier: int, linear: Array, joints: Sequence[int]) -> list[float]:
    """Return the lengths of the links between a joint and others, inf where one slides [m]."""
    slides = {joint for joint, size in zip(joints, linear.tolist(), strict=True) if size > 0.0}
    lengths = dict[int, float]()
    for joint in set(joints):
        between = set(model.supports[carrier]) ^ set(model.supports[joint])
        length = sum(float(np.linalg.norm(model.jointPlacements[i].translation)) for i in between)
        lengths[joint] = math.inf if between & slides else length
    return [lengths[joint] for joint in joints]


def _subspaces(model: Any) -> tuple[Array, Array, list[int]]:
    """Return the lengths of both parts of every column of the motion subspaces, and its joint.

    Returns:
        Linear and angular lengths, shape (nv,) each, and the index of the joint of each column.
    """
    data, q, n = pin.Data(model), pin.neutral(model), int(model.nv)
    linear, angular, joints = np.zeros(n), np.zeros(n), [0] * n
    for i, joint in enumerate(model.joints):
        mine = slice(joint.idx_v, joint.idx_v + joint.nv)
        if i and joint.nv:
            columns = pin.computeJointJacobian(model, data, q, i).reshape(6, n)[:, mine]
            linear[mine] = np.linalg.norm(columns[:3], axis=0)
            angular[mine] = np.linalg.norm(columns[3:], axis=0)
            joints[mine] = [i] * joint.nv
    return linear, angular, joints
