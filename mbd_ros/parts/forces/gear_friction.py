"""Friction, torque offset and rotor inertia of a drive, as identification estimates them."""

from collections.abc import Mapping
from typing import Annotated

import numpy as np

from mbd_ros.core.contracts import Load
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Positive, Smoothing, Unit
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError


class GearFriction(Load):
    """Friction of a drive with Stribeck effect and load dependence, and its rotor inertia.

        tau = offset - viscous v - (coulomb + load |g| + stribeck / (1 + (v / v_s)^2)) s

    s = tanh(v / smoothing), and g is the torque that holds the robot still in its configuration.
    The rotor adds its inertia to the joint. Stiction is left out: a loaded joint at rest creeps.

    In a wrist with bevel gears, several joints may turn one motor. Then v is the speed of that
    motor, v_joint + sum ratio v_other, and the other joints feel `ratio` times its friction.

    Args:
        joint: Joint of the drive.
        also: Other joints that turn the motor: joint -> ratio of the motor angle for a unit of
            that joint to the motor angle for a unit of `joint`.
        coulomb: Coulomb friction.
        load: Coulomb friction per unit of the torque that carries the weight.
        stribeck: Additional dry friction at rest, which decreases with the speed.
        stribeck_velocity: Velocity v_s at which `stribeck` has decreased by half.
        viscous: Viscous friction coefficient.
        offset: Constant torque, such as the negative offset of a torque sensor.
        rotor_inertia: Inertia of the rotor, referred to the joint side of the gear.
        smoothing: Velocity at which 76 % of the dry friction is reached.

    Source: D. P. Hess, A. Soom, J. Tribology 112, 1990, 147 (the curve of Stribeck).
    """

    example = {"joint": "ankle", "coulomb": 0.4, "load": 0.02, "viscous": 0.05, "offset": 0.1}

    def __init__(
        self,
        robot: Robot,
        *,
        joint: str,
        coulomb: Annotated[NotNegative, Unit("N·m or N")] = 0.0,
        load: Annotated[NotNegative, Unit("-")] = 0.0,
        stribeck: Annotated[NotNegative, Unit("N·m or N")] = 0.0,
        stribeck_velocity: Annotated[Positive, Unit("rad/s or m/s")] = 0.1,
        viscous: Annotated[NotNegative, Unit("N·m·s/rad or N·s/m")] = 0.0,
        offset: Annotated[float, Unit("N·m or N")] = 0.0,
        rotor_inertia: Annotated[NotNegative, Unit("kg·m^2 or kg")] = 0.0,
        smoothing: Smoothing = 1.0e-2,
        also: Annotated[Mapping[str, float], Unit("rad/rad")] = {},
    ) -> None:
        self.joint = robot.joint(joint)
        self._coulomb = coulomb
        self._load = load
        self._stribeck = stribeck
        self._stribeck_velocity = stribeck_velocity
        self._viscous = viscous
        self._offset = offset
        self._inertia = rotor_inertia
        self._smoothing = smoothing
        self._nv = int(robot.model.nv)
        self._other_joints = [(robot.joint(name).v, ratio) for name, ratio in also.items()]
        self.brings = ("friction", "damping")

    @staticmethod
    def check(joint: str, also: Mapping[str, float], load: float, rotor_inertia: float) -> None:
        """Refuse load friction and rotor inertia for a motor that several joints turn."""
        if joint in also:
            raise ModelError(f"also names '{joint}', which is the joint of the drive already")
        if also and (load or rotor_inertia):
            raise ModelError("load and rotor_inertia are not accepted together with also")

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the generalized force, shape (nv,)."""
        tau, i = k.zeros(self._nv), self.joint.v
        speed = k.item(x.v, i)
        for other, ratio in self._other_joints:
            speed = speed + ratio * k.item(x.v, other)
        weight = k.item(k.gravity(x.q), i)
        load = k.maximum(weight, -weight)
        ratio = speed / self._stribeck_velocity
        dry = self._coulomb + self._load * load + self._stribeck / (1.0 + ratio * ratio)
        tau[i] = self._offset - self._viscous * speed - dry * k.tanh(speed / self._smoothing)
        for other, ratio in self._other_joints:
            tau[other] = ratio * tau[i]
        return tau

    def armature(self) -> Array:
        """Return the inertia of the rotor at its joint [kg·m^2 or kg], shape (nv,)."""
        inertia = [0.0] * self._nv  # a list, since it can also contain symbols
        inertia[self.joint.v] = self._inertia
        return np.array(inertia)
