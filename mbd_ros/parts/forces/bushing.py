"""Springs and dampers between two frames in all six directions."""

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
    """Bushing: six linear springs and dampers between a frame a and a frame b.

        tau = -J' (K d + D d'),   d = (x, y, z, three angles),   d' = J v

    x, y, z is the origin of b in the axes of a. The three angles rotate the axes of a into those
    of b: about x, then about the rotated y, then about the rotated z, as in OpenSim. They are
    singular where the second angle is 90 degrees. Both frames may be anywhere on their links.

    Source: OpenSim's BushingForce, A. Seth et al., PLoS Comput. Biol. 14, 2018, e1006223; angles
        and rates: J. Diebel, Representing Attitude, 2006, sec. 5.6.

    Args:
        frame_a: Link (or frame) that frame a is fixed to.
        frame_b: Link (or frame) that frame b is fixed to.
        point_a: Origin of a in `frame_a`, shape (3,).
        point_b: Origin of b in `frame_b`, shape (3,).
        rpy_a: Roll, pitch and yaw of the axes of a in `frame_a`, shape (3,).
        rpy_b: Roll, pitch and yaw of the axes of b in `frame_b`, shape (3,).
        stiffness: Stiffness along x, y and z, shape (3,).
        damping: Damping along x, y and z, shape (3,).
        angular_stiffness: Stiffness about each of the three angles, shape (3,).
        angular_damping: Damping about each of the three angles, shape (3,).

    Raises:
        ModelError: Unknown frame, or two frames without relative motion.
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
        """Refuse negative stiffness and damping."""
        if min(*stiffness, *damping, *angular_stiffness, *angular_damping) < 0.0:
            raise ModelError("stiffness and damping must be 0 or more")

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the generalized force, shape (nv,)."""
        wrench, J = self._wrench_and_jacobian(k, x)
        tau: Array = -k.dot(wrench, J)
        return tau

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
        """Return the wrenches on a and on b, about the origin of b."""
        _, a, b, _ = self._pair
        wrench, _ = self._wrench_and_jacobian(k, x)
        axes, point = k.rotation(a), k.position(b)
        force, torque = axes.dot(wrench[:3]), axes.dot(wrench[3:])
        return Wrench(a.frame, point, force, torque), Wrench(b.frame, point, -force, -torque)

    def potential(self, k: Kinematics, x: State) -> float:
        """Return the energy of the springs [J]."""
        d, _ = self._deflection(k, k.motion(self._pair).pose())
        return 0.5 * k.dot(self._stiffness, d * d)

    def _wrench_and_jacobian(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """Return the wrench that resists the motion of b relative to a, and J of that motion.

        Returns:
            Force [N] and torque [N·m] in the axes of a, shape (6,); J, shape (6, nv).
        """
        motion = k.motion(self._pair)
        d, angle_rates = self._deflection(k, motion.pose())
        J = motion.jacobian(motion.placed(), slice(0, 6))
        velocity = k.dot(J, x.v)
        rates = k.array([*velocity[:3], *k.dot(angle_rates, velocity[3:])])
        load = self._stiffness * d + self._damping * rates
        return k.array([*load[:3], *k.dot(load[3:], angle_rates)]), J

    def _deflection(self, k: Kinematics, pose: Any) -> tuple[Array, Array]:
        """Return d and the map from angular velocity to angle rates.

        Args:
            pose: Pose of b in a, a `pinocchio.SE3` or its symbolic counterpart.

        Returns:
            d, shape (6,), and the map, shape (3, 3).
        """
        r = pose.rotation
        cosine = k.sqrt(r[0, 0] * r[0, 0] + r[0, 1] * r[0, 1])  # of the second angle
        s, c, tangent = -r[1, 2] / cosine, r[2, 2] / cosine, r[0, 2] / cosine
        angles = (
            k.arctan2(-r[1, 2], r[2, 2]),
            k.arctan2(r[0, 2], cosine),
            k.arctan2(-r[0, 1], r[0, 0]),
        )
        angle_rates = k.array(
            ((1.0, tangent * s, -tangent * c), (0.0, c, s), (0.0, -s / cosine, c / cosine))
        )
        return k.array((*pose.translation, *angles)), angle_rates
