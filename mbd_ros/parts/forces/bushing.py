"""Spring and damper between two frames in all six directions."""

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np

from mbd_ros.core.contracts import Load, Wrench
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Unit, Vector
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError

_NONE = (0.0, 0.0, 0.0)


class Bushing(Load):
    """Springs and dampers between a frame a and a frame b.

        tau = -J' (K d + D d'),   d = (x, y, z, three angles),   d' = J v

    x, y, z is the origin of b in the axes of a. The angles turn the axes of a into those of b,
    about x, then the new y, then the new z, as OpenSim counts them; they have no meaning where
    the second is 90 degrees. Both frames may have any place on their links.

    Source: OpenSim's BushingForce, A. Seth et al., PLoS Comput. Biol. 14, 2018, e1006223; angles
        and rates: J. Diebel, Representing Attitude, 2006, sec. 5.6.

    Args:
        frame_a: Link (or frame) that carries a.
        frame_b: Link (or frame) that carries b.
        point_a: Origin of a in `frame_a`, shape (3,).
        point_b: Origin of b in `frame_b`, shape (3,).
        rpy_a: Roll, pitch and yaw of the axes of a in `frame_a`, shape (3,).
        rpy_b: Roll, pitch and yaw of the axes of b in `frame_b`, shape (3,).
        stiffness: Along x, y and z, shape (3,).
        damping: Along x, y and z, shape (3,).
        angular_stiffness: Of the three angles, shape (3,).
        angular_damping: Of the three angles, shape (3,).

    Raises:
        ModelError: Unknown frame, or frames that do not move against each other.
    """

    reads = Reads.JACOBIAN
    example = {
        "frame_a": "shank",
        "frame_b": "foot",
        "stiffness": [100.0, 200.0, 300.0],
        "angular_stiffness": [5.0, 6.0, 7.0],
        "angular_damping": [0.1, 0.2, 0.3],
    }

    def __init__(
        self,
        robot: Robot,
        *,
        frame_a: str,
        frame_b: str,
        point_a: Annotated[Vector, Unit("m")] = _NONE,
        point_b: Annotated[Vector, Unit("m")] = _NONE,
        rpy_a: Annotated[Vector, Unit("rad")] = _NONE,
        rpy_b: Annotated[Vector, Unit("rad")] = _NONE,
        stiffness: Annotated[Vector, Unit("N/m")] = _NONE,
        damping: Annotated[Vector, Unit("N·s/m")] = _NONE,
        angular_stiffness: Annotated[Vector, Unit("N·m/rad")] = _NONE,
        angular_damping: Annotated[Vector, Unit("N·m·s/rad")] = _NONE,
    ) -> None:
        a, b = robot.point(frame_a, point_a, rpy_a), robot.point(frame_b, point_b, rpy_b)
        self._pair = robot.pair(a, b)
        self._stiffness = np.array([*stiffness, *angular_stiffness])
        self._damping = np.array([*damping, *angular_damping])

    @staticmethod
    def check(
        stiffness: Sequence[float],
        damping: Sequence[float],
        angular_stiffness: Sequence[float],
        angular_damping: Sequence[float],
    ) -> None:
        """Refuse springs and dampers that push on."""
        if min(*stiffness, *damping, *angular_stiffness, *angular_damping) < 0.0:
            raise ModelError("stiffness and damping must be 0 or more")

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force, shape (nv,)."""
        wrench, J = self._pulled(k, x)
        tau: Array = -k.dot(wrench, J)
        return tau

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
        """Those at the origin of b: on a, then on b."""
        _, a, b, _ = self._pair
        wrench, _ = self._pulled(k, x)
        axes, point = k.rotation(a), k.position(b)
        force, torque = axes.dot(wrench[:3]), axes.dot(wrench[3:])
        return Wrench(a.frame, point, force, torque), Wrench(b.frame, point, -force, -torque)

    def potential(self, k: Kinematics, x: State) -> float:
        """Energy of the springs [J]."""
        d, _ = self._deflection(k, k.motion(self._pair).pose())
        return 0.5 * k.dot(self._stiffness, d * d)

    def _pulled(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """Force and torque against the motion of b past a, in the axes of a; J of that motion."""
        seen = k.motion(self._pair)
        d, turn = self._deflection(k, seen.pose())
        J = seen.jacobian(seen.placed(), slice(0, 6))
        velocity = k.dot(J, x.v)
        rates = k.array([*velocity[:3], *k.dot(turn, velocity[3:])])
        load = self._stiffness * d + self._damping * rates
        return k.array([*load[:3], *k.dot(load[3:], turn)]), J

    def _deflection(self, k: Kinematics, pose: Any) -> tuple[Array, Array]:
        """The d, shape (6,), and what turns an angular velocity into rates of angles, (3, 3)."""
        r = pose.rotation
        across = k.sqrt(r[0, 0] * r[0, 0] + r[0, 1] * r[0, 1])  # cosine of the second angle
        s, c, slope = -r[1, 2] / across, r[2, 2] / across, r[0, 2] / across
        angles = (
            k.arctan2(-r[1, 2], r[2, 2]),
            k.arctan2(r[0, 2], across),
            k.arctan2(-r[0, 1], r[0, 0]),
        )
        turn = k.array(((1.0, slope * s, -slope * c), (0.0, c, s), (0.0, -s / across, c / across)))
        return k.array((*pose.translation, *angles)), turn
