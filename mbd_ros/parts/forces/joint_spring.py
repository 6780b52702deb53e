"""Spring and damper in a joint."""

from typing import Annotated

from mbd_ros.core.contracts import Load
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Unit, is_value
from mbd_ros.core.state import Array, State


class JointSpring(Load):
    """Linear spring and damper: tau = stiffness (rest - q) - damping v. No limits, no backlash.

    Args:
        joint: Joint that carries the spring.
        stiffness: Of the spring.
        rest: Position without force.
        damping: Of the damper.
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
        self._rest = rest
        self._damping = damping
        self._nv = int(robot.model.nv)
        self.brings = () if is_value(damping, 0.0) else ("damping",)

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force of the spring, shape (nv,)."""
        tau = k.zeros(self._nv)
        stretch, rate = k.item(x.q, self.joint.q) - self._rest, k.item(x.v, self.joint.v)
        tau[self.joint.v] = -self._stiffness * stretch - self._damping * rate
        return tau

    def potential(self, k: Kinematics, x: State) -> float:
        """Energy of the spring, zero at rest [J]."""
        stretch = k.item(x.q, self.joint.q) - self._rest
        return 0.5 * self._stiffness * stretch * stretch
