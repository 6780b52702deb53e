"""Series elastic actuator with the motion of its motor as internal states."""

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
    """Motor and gear that drive a joint through a spring.

        tau = stiffness (theta / ratio - q) + damping (omega / ratio - v)
        theta' = omega,   rotor_inertia omega' = u - viscous omega - tau / ratio

    theta and omega are angle and speed of the motor. The motor torque u saturates at `limit`, and
    the speed at `speed`. The stored energy is that of rotor and spring. The model leaves out
    gyroscopic effects of the rotor (Spong's assumption of a light and fast rotor), losses of the
    gear, backlash and the electric side.

    Source: M. W. Spong, J. Dyn. Sys. Meas. Control 109, 1987, 310-319, doi:10.1115/1.3143860; G.
    A. Pratt, M. M. Williamson, IROS 1995, doi:10.1109/IROS.1995.525827.

    Args:
        joint: Driven joint; its command is the torque of the motor [N·m].
        stiffness: Stiffness of the spring between gear and joint.
        rotor_inertia: Inertia of the rotor about the motor axis.
        ratio: Motor angle per joint position; negative if the joint turns against the motor.
        damping: Damping of the spring.
        viscous: Viscous friction coefficient of the motor.
        limit: Largest torque of the motor; unlimited by default.
        speed: Largest speed of the motor; unlimited by default.
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
        self.internal = (
            Internal("angle", "rad"),
            Internal("speed", "rad/s", -speed, speed, 0.0),
        )
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
        """Return the generalized force of the spring, shape (nv,)."""
        tau = k.zeros(self._nv)
        stretch, rate, _ = self._deflection(k, x)
        tau[self.joint.v] = self._stiffness * stretch + self._damping * rate
        return tau

    def rates(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return speed and acceleration of the motor [rad/s, rad/s^2], shape (2,)."""
        stretch, rate, speed = self._deflection(k, x)
        spring = self._stiffness * stretch + self._damping * rate
        torque = self._motor_torque(k, u) - self._viscous * speed - spring / self._ratio
        return k.array([speed, torque / self._inertia])

    def columns(self, k: Kinematics, x: State) -> Array | None:
        """Return zeros, shape (nv, 1): the motor torque reaches the joint only by the spring."""
        return np.zeros((self._nv, 1))

    def potential(self, k: Kinematics, x: State) -> float:
        """Return the energy of the spring and of the rotor [J]."""
        stretch, _, speed = self._deflection(k, x)
        return 0.5 * (self._stiffness * stretch * stretch + self._inertia * speed * speed)

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> tuple[float, ...]:
        """Return joint torque, motor power, and power lost in both dampers.

        At its largest speed, the motor exerts no more torque than keeps the speed constant.
        """
        stretch, rate, speed = self._deflection(k, x)
        torque = self._stiffness * stretch + self._damping * rate
        loss = self._damping * rate * rate + self._viscous * speed * speed
        power = self._motor_torque(k, u) * speed
        if abs(speed) >= self._speed:
            power = min(power, (self._viscous * speed + torque / self._ratio) * speed)
        return torque, power, loss

    def command(self, torque: Array, x: State) -> Array:
        """Return the motor torque that balances the joint torque at rest [N·m], shape (1,)."""
        return torque / self._ratio

    def limits(self) -> Array:
        """Return the joint torque at the torque limit of the motor [N·m or N], shape (1,)."""
        return np.array([abs(self._ratio) * self._limit])

    def _deflection(self, k: Kinematics, x: State) -> tuple[float, float, float]:
        """Return stretch of the spring and its rate, in joint coordinates, and the motor speed."""
        first = self.z.start or 0
        angle, speed = k.item(x.z, first), k.item(x.z, first + 1)
        stretch = angle / self._ratio - k.item(x.q, self.joint.q)
        return stretch, speed / self._ratio - k.item(x.v, self.joint.v), speed

    def _motor_torque(self, k: Kinematics, u: Array) -> float:
        """Return the torque of the motor, saturated at its limit [N·m]."""
        command = k.item(u, self.u.start or 0)
        return -k.maximum(-k.maximum(command, -self._limit), -self._limit)
