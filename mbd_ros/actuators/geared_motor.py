"""Motor with a gear."""

import math

import numpy as np

from mbd_ros.core.model.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.parts import Actuator, Channel
from mbd_ros.core.ranges import Share, Smoothing
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError

_LARGEST_RATIO = 1.0e9


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
        robot: Robot of the scene.
        joint: Driven joint; its command is the torque of the motor [N·m].
        ratio: Motor angle per joint position [-, or rad/m for a prismatic joint], not 0; negative
            where the joint turns against the motor.
        rotor_inertia: About the motor axis [kg·m^2], >= 0.
        efficiency: Share of the power that passes the gear, above 0, at most 1.
        viscous: Friction on the motor side [N·m·s/rad], >= 0.
        limit: Largest torque of the motor [N·m], > 0; without it there is none.
        smoothing: Joint velocity at which s reaches 0.76 [rad/s or m/s], > 0.

    Raises:
        ModelError: Unknown joint, or a value out of its range.
    """

    takes = "torque of the motor [N·m]"
    example = {"joint": "ankle", "ratio": 50.0, "rotor_inertia": 1.0e-5, "efficiency": 0.8}

    def __init__(
        self,
        robot: Robot,
        *,
        joint: str,
        ratio: float,
        rotor_inertia: float = 0.0,
        efficiency: Share = 1.0,
        viscous: float = 0.0,
        limit: float = math.inf,
        smoothing: Smoothing = 1.0e-2,
    ) -> None:
        if not 1.0 / _LARGEST_RATIO <= abs(ratio) <= _LARGEST_RATIO:
            raise ModelError(
                f"ratio {ratio:g} must be finite and not 0, of size {1 / _LARGEST_RATIO:g} .. "
                f"{_LARGEST_RATIO:g}"
            )
        if not (0 <= rotor_inertia < math.inf and 0 <= viscous < math.inf):
            raise ModelError(
                f"rotor_inertia {rotor_inertia:g} and viscous {viscous:g} must be finite and >= 0"
            )
        if not 0 < efficiency <= 1:
            raise ModelError(f"efficiency {efficiency:g} must be above 0 and at most 1")
        if not (limit > 0 and 0 < smoothing < math.inf):
            raise ModelError(f"limit {limit:g} and smoothing {smoothing:g} must be > 0")
        self.joint, self.joints = robot.joint(joint), (joint,)
        self.inputs = (Channel("", "N·m", -limit, limit),)
        self._ratio, self._limit, self._efficiency = ratio, limit, efficiency
        self._viscous, self._smoothing = ratio**2 * viscous, smoothing
        self._armature = np.zeros(int(robot.model.nv))
        self._armature[self.joint.v] = ratio**2 * rotor_inertia

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force, shape (nv,), of the motor torque [N·m], shape (1,)."""
        tau = np.zeros(len(self._armature))
        rate = float(x.v[self.joint.v])
        lossless = self._ratio * max(min(u[self.u].item(), self._limit), -self._limit)
        direction = math.copysign(math.tanh(rate / self._smoothing), lossless * rate)
        tau[self.joint.v] = lossless * self._efficiency**direction - self._viscous * rate
        return tau

    def columns(self, k: Kinematics, x: State) -> Array | None:
        """The ratio, shape (nv, 1); None with losses, which depend on the side that drives."""
        if self._efficiency != 1.0:
            return None
        columns = np.zeros((len(self._armature), 1))
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
        inertia: Array = self._armature.copy()
        return inertia
