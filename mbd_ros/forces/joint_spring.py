"""Spring and damper in a joint."""

import numpy as np

from mbd_ros.core.model.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.parts import Load
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError


class JointSpring(Load):
    """Linear spring and damper: tau = stiffness (rest - q) - damping v. No limits, no backlash.

    Args:
        robot: Robot of the scene.
        joint: Joint that carries the spring.
        stiffness: [N·m/rad or N/m], >= 0.
        rest: Position without force [rad or m].
        damping: [N·m·s/rad or N·s/m], >= 0.
    """

    example = {"joint": "ankle", "stiffness": 30.0, "rest": 0.1, "damping": 0.5}

    def __init__(
        self,
        robot: Robot,
        *,
        joint: str,
        stiffness: float,
        rest: float = 0.0,
        damping: float = 0.0,
    ) -> None:
        if stiffness < 0 or damping < 0:
            raise ModelError(f"stiffness {stiffness:g} and damping {damping:g} must be >= 0")
        self.joint = robot.joint(joint)
        self._stiffness, self._rest, self._damping = stiffness, rest, damping
        self._nv = int(robot.model.nv)
        self.brings = ("damping",) if damping > 0 else ()

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force of the spring, shape (nv,)."""
        tau = np.zeros(self._nv)
        stretch, rate = x.q[self.joint.q] - self._rest, x.v[self.joint.v]
        tau[self.joint.v] = -self._stiffness * stretch - self._damping * rate
        return tau

    def potential(self, k: Kinematics, x: State) -> float:
        """Energy of the spring, zero at rest [J]."""
        stretch = float(x.q[self.joint.q]) - self._rest
        return 0.5 * self._stiffness * stretch * stretch
