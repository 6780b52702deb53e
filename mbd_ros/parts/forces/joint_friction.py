"""Regularised Coulomb friction and viscous friction in a joint."""

from typing import Annotated

from mbd_ros.core.contracts import Load
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Smoothing, Unit, is_value
from mbd_ros.core.state import Array, State


class JointFriction(Load):
    """Friction of a joint: tau = -coulomb tanh(v / smoothing) - viscous v.

    Stiction is left out: a loaded joint at rest creeps. `dry_friction` holds it exactly.

    Args:
        joint: Joint with friction.
        coulomb: Coulomb friction.
        viscous: Viscous friction coefficient.
        smoothing: Velocity at which 76 % of the dry friction is reached.
    """

    example = {"joint": "ankle", "coulomb": 0.4, "viscous": 0.05}

    def __init__(
        self,
        robot: Robot,
        *,
        joint: str,
        coulomb: Annotated[NotNegative, Unit("N·m or N")] = 0.0,
        viscous: Annotated[NotNegative, Unit("N·m·s/rad or N·s/m")] = 0.0,
        smoothing: Smoothing = 1.0e-2,
    ) -> None:
        self.joint = robot.joint(joint)
        self._coulomb = coulomb
        self._viscous = viscous
        self._smoothing = smoothing
        self._nv = int(robot.model.nv)
        coefficients = {"friction": coulomb, "damping": viscous}
        self.brings = tuple(k for k, value in coefficients.items() if not is_value(value, 0.0))

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the generalized force of the friction, shape (nv,)."""
        tau = k.zeros(self._nv)
        rate = k.item(x.v, self.joint.v)
        dry = self._coulomb * k.tanh(rate / self._smoothing)
        tau[self.joint.v] = -dry - self._viscous * rate
        return tau
