"""Motor with a lossy gear."""

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

    While the motor drives (s = 1), the joint receives the fraction `efficiency` of the power of
    the motor. While the joint drives (s = -1), the motor receives that fraction of the joint's
    power, so that the joint feels ratio u / efficiency. At rest tau = ratio u. The torque is
    continuous, and the gear never generates power. The rotor adds ratio^2 rotor_inertia to the
    joint.

    The model leaves out losses of the torque that accelerates the rotor, stiction (a loaded gear
    creeps back at rest), backlash, elasticity, the electric side and gyroscopic effects.

    Args:
        joint: Driven joint; its command is the torque of the motor [N·m].
        ratio: Motor angle per joint position; negative if the joint turns against the motor.
        rotor_inertia: Inertia of the rotor about the motor axis.
        efficiency: Fraction of the power that the gear transmits.
        viscous: Viscous friction coefficient on the motor side.
        limit: Largest torque of the motor; unlimited by default.
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
        """Return the generalized force, shape (nv,)."""
        tau, rate = k.zeros(self._nv), k.item(x.v, self.joint.v)
        motor_torque = k.minimum(k.item(u, self.u.start or 0), self._limit)
        lossless = self._ratio * k.maximum(motor_torque, -self._limit)
        direction = k.copysign(k.tanh(rate / self._smoothing), lossless * rate)
        tau[self.joint.v] = lossless * self._efficiency**direction - self._viscous * rate
        return tau

    def columns(self, k: Kinematics, x: State) -> Array | None:
        """Return the ratio, shape (nv, 1); None for a lossy gear, which is not affine in u."""
        if self._efficiency != 1.0:
            return None
        columns = np.zeros((self._nv, 1))
        columns[self.joint.v] = self._ratio
        return columns

    def command(self, torque: Array, x: State) -> Array:
        """Return the motor torque of a lossless gear [N·m], shape (1,)."""
        return torque / self._ratio

    def demanded(self, torque: Array, x: State) -> Array:
        """Return the motor torque that exerts the torque in spite of losses [N·m], shape (1,)."""
        rate = float(x.v[self.joint.v])
        frictionless = torque + self._viscous * rate
        direction = np.sign(frictionless) * math.tanh(rate / self._smoothing)
        motor_torque: Array = frictionless / (self._ratio * self._efficiency**direction)
        return motor_torque

    def limits(self) -> Array:
        """Return the largest joint torque through a lossless gear [N·m or N], shape (1,)."""
        return np.array([abs(self._ratio) * self._limit])

    def armature(self) -> Array:
        """Return the inertia of the rotor at the joint [kg·m^2 or kg], shape (nv,)."""
        inertia = [0.0] * self._nv  # a list, since it can also contain symbols
        inertia[self.joint.v] = self._inertia
        return np.array(inertia)
