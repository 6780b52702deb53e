"""Motor with a gear."""

import math
from typing import Annotated

import numpy as np

from mbd_ros.core.contracts import Actuator, Channel
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Positive, Share, Smoothing, Unit, Within
from mbd_ros.core.state import Array, State

_RATIO = Within(1.0e-9, 1.0e9, of_size=True)


class GearedMotor(Actuator):
    """Motor torque u through a gear: tau = ratio u efficiency^s - ratio^2 viscous v.

        s = sign(ratio u) tanh(v / smoothing)

    Driving (s = 1) the joint gets the share `efficiency` of the motor power; driven back (s = -1)
    the motor gets that share of the joint power, so that the joint feels ratio u / efficiency.
    At rest tau = ratio u. Continuous, and never a source of power. The rotor adds
    ratio^2 rotor_inertia to the joint.

    Left out: loss of the torque that accelerates the rotor, stiction (a loaded gear creeps back
    at rest), backlash, elasticity, the electric side, gyroscopic effects of the rotor.

    Args:
        joint: Driven joint; its command is the torque of the motor [N·m].
        ratio: Motor angle per joint position; negative where the joint turns against the motor.
        rotor_inertia: About the motor axis.
        efficiency: Share of the power that passes the gear.
        viscous: Friction on the motor side.
        limit: Largest torque of the motor; without it there is none.
        smoothing: Joint velocity at which s reaches 0.76.
    """

    takes = "torque of the motor [N·m]"
    example = {"joint": "ankle", "ratio": 50.0, "rotor_inertia": 1.0e-5, "efficiency": 0.8}

    def __init__(
        self,
        robot: Robot,
        *,
        joint: str,
        ratio: Annotated[float, _RATIO, Unit("rad/rad or rad/m")],
        rotor_inertia: Annotated[NotNegative, Unit("kg·m^2")] = 0.0,
        efficiency: Annotated[Share, Unit("-")] = 1.0,
        viscous: Annotated[NotNegative, Unit("N·m·s/rad")] = 0.0,
        limit: Annotated[Positive, Unit("N·m")] = math.inf,
        smoothing: Smoothing = 1.0e-2,
    ) -> None:
        self.joint = robot.joint(joint)
        self.joints = (joint,)
        self.inputs = (Channel("", "N·m", -limit, limit),)
        self._ratio = ratio
        self._limit = limit
        self._efficiency = efficiency
        self._viscous = ratio**2 * viscous
        self._smoothing = smoothing
        self._inertia = ratio**2 * rotor_inertia
        self._nv = int(robot.model.nv)

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force, shape (nv,), of the motor torque [N·m], shape (1,)."""
        tau, rate = k.zeros(self._nv), k.item(x.v, self.joint.v)
        wanted = k.minimum(k.item(u, self.u.start or 0), self._limit)
        lossless = self._ratio * k.maximum(wanted, -self._limit)
        direction = k.copysign(k.tanh(rate / self._smoothing), lossless * rate)
        tau[self.joint.v] = lossless * self._efficiency**direction - self._viscous * rate
        return tau

    def columns(self, k: Kinematics, x: State) -> Array | None:
        """The ratio, shape (nv, 1); None with losses, which depend on the side that drives."""
        if self._efficiency != 1.0:
            return None
        columns = np.zeros((self._nv, 1))
        columns[self.joint.v] = self._ratio
        return columns

    def command(self, torque: Array, x: State) -> Array:
        """Motor torque of the lossless gear [N·m], shape (1,)."""
        return torque / self._ratio

    def demanded(self, torque: Array, x: State) -> Array:
        """Motor torque behind which the gear and its friction leave the torque [N·m]."""
        rate = float(x.v[self.joint.v])
        behind = torque + self._viscous * rate
        driving = np.sign(behind) * math.tanh(rate / self._smoothing)
        demanded: Array = behind / (self._ratio * self._efficiency**driving)
        return demanded

    def limits(self) -> Array:
        """Torque of the joint that the motor drives through a lossless gear [N·m], shape (1,)."""
        return np.array([abs(self._ratio) * self._limit])

    def armature(self) -> Array:
        """Inertia of the rotor at the joint [kg·m^2 or kg], shape (nv,)."""
        inertia = [0.0] * self._nv  # a list, which holds symbols, too
        inertia[self.joint.v] = self._inertia
        return np.array(inertia)
