"""Spring and damper in a joint."""

from typing import Annotated

from mbd_ros.core.contracts import Load
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Unit, is_value
from mbd_ros.core.state import Array, State


class JointSpring(Load):
    """Linear spring and damper in a joint: tau = stiffness (rest - q) - damping v.

    It has no limits and no backlash.

    Args:
        joint: Joint that the spring acts on.
        stiffness: Stiffness of the spring.
        rest: Joint position at which the spring exerts no force.
        damping: Damping coefficient.
    """

    example = {"joint": "ankle", "stiffness": 30.0, "rest": 0.1, "damping": 0.5}

    def __init__(
        self,
        robot: Robot,
        *,
        joint: str,
        stiffness: Annotated[NotNegative, Unit("N·m/rad or N/m")],
        rest: Annotated[float, Unit("rad or m")] = 0.0,
        damping: Annotated[NotNegative, Unit("N·m·s/rad or N·s/m")] = 0.0,
    ) -> None:
        self.joint = robot.joint(joint)
        self._stiffness = stiffness
        self._neutral = rest
        self._damping = damping
        self._nv = int(robot.model.nv)
        self.brings = () if is_value(damping, 0.0) else ("damping",)

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the generalized force of spring and damper, shape (nv,)."""
        tau = k.zeros(self._nv)
        stretch, rate = k.item(x.q, self.joint.q) - self._neutral, k.item(x.v, self.joint.v)
        tau[self.joint.v] = -self._stiffness * stretch - self._damping * rate
        return tau

    def potential(self, k: Kinematics, x: State) -> float:
        """Return the energy of the spring [J]."""
        stretch = k.item(x.q, self.joint.q) - self._neutral
        return 0.5 * self._stiffness * stretch * stretch
