"""Dry friction with exact stiction."""

from typing import Annotated

import numpy as np

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import OptionalDuration, Positive, Unit
from mbd_ros.core.rows.constraint import Constraint, Level, Row, box
from mbd_ros.core.state import Array, State


class DryFriction(Constraint):
    """Coulomb friction of a joint, exact at rest: g' = v, |multiplier| <= limit.

    The joint sticks while a torque within the limit can hold it, without creep. Otherwise it
    slips against the full limit. Static and kinetic friction are the same; it does not depend on
    the load of the joint.

    Args:
        joint: Joint with friction.
        limit: Largest friction.
        smoothed: Whether it is solved for in every evaluation, which costs the order of the
            method; that is so with a time constant, too.
        time_constant: Of a slow joint that comes to rest by smoothed friction, 0.002 s by default;
            a step stays stable with one that is longer than the step.
    """

    level = Level.VELOCITY  # any position will do
    example = {"joint": "ankle", "limit": 0.8}

    def __init__(
        self,
        robot: Robot,
        *,
        joint: str,
        limit: Annotated[Positive, Unit("N·m or N")],
        smoothed: bool = False,
        time_constant: OptionalDuration = None,
    ) -> None:
        self.joint = robot.joint(joint)
        self.law = box(-limit, limit)
        self.smoothed = smoothed or time_constant is not None
        T = 0.002 if time_constant is None else time_constant
        self.gains = (0.0, 1.0 / T)
        self.brings = ("friction",)
        self.rows = (Row(self.joint.effort_name, self.joint.effort_unit),)
        self._zero = np.zeros(1)
        self._jacobian = np.zeros((1, robot.model.nv))
        self._jacobian[0, self.joint.v] = 1.0

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """1 at the joint, shape (1, nv)."""
        return self._jacobian

    def drift(self, k: Kinematics, x: State) -> Array:
        """Zero, shape (1,)."""
        return self._zero
