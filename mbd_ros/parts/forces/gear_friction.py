"""Friction, offset and rotor inertia of a drive, as identification finds them."""

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
    """tau = offset - viscous v - (coulomb + load |g| + stribeck / (1 + (v / v_s)^2)) s.

    s = tanh(v / smoothing), g the torque that holds the robot still at its position. The rotor
    adds its inertia to the joint. No stiction: a joint at rest creeps.

    A motor in a wrist may turn with several joints, as behind bevel gears: v is then its speed
    v_joint + sum ratio v_other, and the other joints feel `ratio` times its friction.

    Args:
        joint: Joint of the drive.
        also: Other joints that turn its motor, and how far it turns with them [motor angle for
            a unit of theirs over that for a unit of `joint`].
        coulomb: Dry friction.
        load: Dry friction for a unit of the torque that carries the weight.
        stribeck: Dry friction that motion takes away.
        stribeck_velocity: v_s, at which half of that is gone.
        viscous: Viscous friction.
        offset: What acts besides, such as the offset of a torque sensor with the other sign.
        rotor_inertia: At the joint, behind the gear.
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
        self._at = stribeck_velocity
        self._viscous = viscous
        self._offset = offset
        self._inertia = rotor_inertia
        self._smoothing = smoothing
        self._nv = int(robot.model.nv)
        self._also = [(robot.joint(name).v, ratio) for name, ratio in also.items()]
        self.brings = ("friction", "damping")

    @staticmethod
    def check(joint: str, also: Mapping[str, float], load: float, rotor_inertia: float) -> None:
        """Refuse a motor of several joints with what is known of one joint alone."""
        if joint in also:
            raise ModelError(f"also: {joint} is the joint of the drive")
        if also and (load or rotor_inertia):
            raise ModelError("load and rotor_inertia are those of a motor that one joint turns")

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force, shape (nv,)."""
        tau, at = k.zeros(self._nv), self.joint.v
        rate = k.item(x.v, at)
        for other, ratio in self._also:
            rate = rate + ratio * k.item(x.v, other)
        weight = k.item(k.gravity(x.q), at)
        carried = k.maximum(weight, -weight)
        ratio = rate / self._at
        dry = self._coulomb + self._load * carried + self._stribeck / (1.0 + ratio * ratio)
        tau[at] = self._offset - self._viscous * rate - dry * k.tanh(rate / self._smoothing)
        for other, ratio in self._also:
            tau[other] = ratio * tau[at]
        return tau

    def armature(self) -> Array:
        """Inertia of the rotor at the joint [kg·m^2 or kg], shape (nv,)."""
        inertia = [0.0] * self._nv  # a list, which holds symbols, too
        inertia[self.joint.v] = self._inertia
        return np.array(inertia)
