"""Motor, gear and spring, with the motion of the motor as internal states."""

import math
from typing import Annotated

import numpy as np

from mbd_ros.core.contracts import Actuator, Channel, Internal, Now, Output
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Positive, Unit, Within
from mbd_ros.core.state import Array, State

_RATIO = Within(1.0e-9, 1.0e9, of_size=True)


class SeriesElasticDrive(Actuator):
    """Motor behind a gear and a spring that the joint pulls at.

        tau = stiffness (theta / ratio - q) + damping (omega / ratio - v)
        theta' = omega,   rotor_inertia omega' = u - viscous omega - tau / ratio

    Motor torque u is cut at `limit`; the motor does not turn faster than `speed`. `energy` counts
    the rotor and the spring. Left out: gyroscopic effects of the rotor, which turns fast and is
    light (Spong's assumption), losses of the gear, backlash, the electric side.

    Source: M. W. Spong, J. Dyn. Sys. Meas. Control 109, 1987, 310-319, doi:10.1115/1.3143860; G.
    A. Pratt, M. M. Williamson, IROS 1995, doi:10.1109/IROS.1995.525827.

    Args:
        joint: Driven joint; its command is the torque of the motor [N·m].
        stiffness: Of the spring, between gear and joint.
        rotor_inertia: About the motor axis.
        ratio: Motor angle per joint position; negative where the joint turns against the motor.
        damping: Of the spring.
        viscous: Friction of the motor.
        limit: Largest torque of the motor; without it there is none.
        speed: Largest speed of the motor; without it there is none.
    """

    takes = "torque of the motor [N·m]"
    example = {"joint": "ankle", "stiffness": 300.0, "rotor_inertia": 1.0e-4, "ratio": 50.0}
    outputs = (Output("torque", "N·m"), Output("power", "W"), Output("loss", "W"))

    def __init__(
        self,
        robot: Robot,
        *,
        joint: str,
        stiffness: Annotated[Positive, Unit("N·m/rad or N/m")],
        rotor_inertia: Annotated[Positive, Unit("kg·m^2")],
        ratio: Annotated[float, _RATIO, Unit("rad/rad or rad/m")] = 1.0,
        damping: Annotated[NotNegative, Unit("N·m·s/rad or N·s/m")] = 0.0,
        viscous: Annotated[NotNegative, Unit("N·m·s/rad")] = 0.0,
        limit: Annotated[Positive, Unit("N·m")] = math.inf,
        speed: Annotated[Positive, Unit("rad/s")] = math.inf,
    ) -> None:
        self.joint = robot.joint(joint)
        self.joints = (joint,)
        self.inputs = (Channel("", "N·m", -limit, limit),)
        turning = Internal("speed", "rad/s", -speed, speed, 0.0)
        self.internal = (Internal("angle", "rad"), turning)
        unit = "N" if self.joint.kind == "prismatic" else "N·m"
        self.outputs = (self.outputs[0]._replace(unit=unit), *self.outputs[1:])
        self._stiffness = stiffness
        self._damping = damping
        self._ratio = ratio
        self._inertia = rotor_inertia
        self._viscous = viscous
        self._limit = limit
        self._speed = speed
        self._nv = int(robot.model.nv)

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force of the spring, shape (nv,)."""
        tau = k.zeros(self._nv)
        stretch, rate, _ = self._stretched(k, x)
        tau[self.joint.v] = self._stiffness * stretch + self._damping * rate
        return tau

    def rates(self, k: Kinematics, x: State, u: Array) -> Array:
        """Speed and acceleration of the motor [rad/s, rad/s^2], shape (2,)."""
        stretch, rate, speed = self._stretched(k, x)
        spring = self._stiffness * stretch + self._damping * rate
        driving = self._driving(k, u) - self._viscous * speed - spring / self._ratio
        return k.array([speed, driving / self._inertia])

    def columns(self, k: Kinematics, x: State) -> Array | None:
        """Zeros, shape (nv, 1): a motor torque reaches the joint through the spring alone."""
        return np.zeros((self._nv, 1))

    def potential(self, k: Kinematics, x: State) -> float:
        """Energy of the spring and of the rotor [J]."""
        stretch, _, speed = self._stretched(k, x)
        return 0.5 * (self._stiffness * stretch * stretch + self._inertia * speed * speed)

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> tuple[float, ...]:
        """Torque of the joint, power of the motor, and what both dampers take.

        At its largest speed the motor gives no more than what keeps it there.
        """
        stretch, rate, speed = self._stretched(k, x)
        torque = self._stiffness * stretch + self._damping * rate
        loss = self._damping * rate * rate + self._viscous * speed * speed
        power = self._driving(k, u) * speed
        if abs(speed) >= self._speed:
            power = min(power, (self._viscous * speed + torque / self._ratio) * speed)
        return torque, power, loss

    def command(self, torque: Array, x: State) -> Array:
        """Motor torque that a torque of the joint takes in the long run [N·m], shape (1,)."""
        return torque / self._ratio

    def limits(self) -> Array:
        """Torque of the joint that the motor holds [N·m or N], shape (1,)."""
        return np.array([abs(self._ratio) * self._limit])

    def _stretched(self, k: Kinematics, x: State) -> tuple[float, float, float]:
        """Stretch of the spring and its rate, on the side of the joint, and the motor speed."""
        first = self.z.start or 0
        angle, speed = k.item(x.z, first), k.item(x.z, first + 1)
        stretch = angle / self._ratio - k.item(x.q, self.joint.q)
        return stretch, speed / self._ratio - k.item(x.v, self.joint.v), speed

    def _driving(self, k: Kinematics, u: Array) -> float:
        """Torque of the motor within its limit [N·m]."""
        wanted = k.item(u, self.u.start or 0)
        return -k.maximum(-k.maximum(wanted, -self._limit), -self._limit)
