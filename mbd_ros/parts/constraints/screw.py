"""Screw joint: a translation coupled to a rotation."""

import math
from typing import Annotated

import numpy as np

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotZero, Unit
from mbd_ros.core.rows.constraint import Constraint, Row
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError


class Screw(Constraint):
    """Lossless screw between a prismatic and a revolute joint.

        g = q_joint - pitch / (2 pi) q_parent - offset

    The multiplier is the axial force of the screw. A positive force pushes the prismatic joint in
    its positive direction, and exerts -pitch / (2 pi) times the force on the revolute joint.

    Args:
        joint: Prismatic joint that the screw moves.
        parent: Revolute or continuous joint that turns the screw.
        pitch: Travel per turn, negative for a left-handed screw.
        offset: Position of `joint` where that of `parent` is 0.

    Raises:
        ModelError: `joint` is not prismatic, or `parent` is.
    """

    example = {"joint": "knee_slide_y", "parent": "knee", "pitch": 0.005}

    def __init__(
        self,
        robot: Robot,
        *,
        joint: str,
        parent: str,
        pitch: Annotated[NotZero, Unit("m")],
        offset: Annotated[float, Unit("m")] = 0.0,
    ) -> None:
        slider, turner = robot.joint(joint), robot.joint(parent)
        if slider.kind != "prismatic":
            raise ModelError(f"joint '{joint}' is {slider.kind}, accepted: prismatic")
        if turner.kind == "prismatic":
            raise ModelError(f"parent '{parent}' is prismatic, accepted: revolute, continuous")
        self._slider = slider.q
        self._turner = turner.q
        self._lead = pitch / (2.0 * math.pi)
        self._offset = offset
        slopes = [0.0] * int(robot.model.nv)  # a list, since it can also contain symbols
        slopes[slider.v], slopes[turner.v] = 1.0, -self._lead
        self._jacobian = np.array([slopes])
        self._drift = np.zeros(1)
        self.rows = (Row("force", "N"),)

    def residual(self, k: Kinematics, x: State) -> Array:
        """Return g [m], shape (1,)."""
        position, angle = k.item(x.q, self._slider), k.item(x.q, self._turner)
        return k.array((position - self._lead * angle - self._offset,))

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Return the constant Jacobian, shape (1, nv)."""
        return self._jacobian

    def drift(self, k: Kinematics, x: State) -> Array:
        """Return zero, shape (1,)."""
        return self._drift
