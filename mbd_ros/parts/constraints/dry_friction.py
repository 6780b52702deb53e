"""Coulomb friction in a joint with exact stiction."""

from typing import Annotated

import numpy as np

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import OptionalDuration, Positive, Unit
from mbd_ros.core.rows.constraint import Constraint, Level, Row, box
from mbd_ros.core.state import Array, State


class DryFriction(Constraint):
    """Coulomb friction of a joint, without creep at rest: g' = v, |multiplier| <= limit.

    The joint sticks as long as a friction torque within the limit can hold it; otherwise it slips
    against the full limit. Static and kinetic friction are equal, and independent of the load.

    Args:
        joint: Joint with friction.
        limit: Largest friction torque or force.
        smoothed: Whether friction is solved for in every evaluation instead of switching at
            events, which lowers the order of the integrator; `time_constant` implies it.
        time_constant: Time constant with which smoothed friction stops a slow joint, 0.002 s by
            default; it must be longer than the time step for the step to be stable.
    """

    level = Level.VELOCITY  # it constrains no position
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
        """Return the row with 1 at the joint, shape (1, nv)."""
        return self._jacobian

    def drift(self, k: Kinematics, x: State) -> Array:
        """Return zero, shape (1,)."""
        return self._zero
