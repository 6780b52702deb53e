"""A point without velocity along one direction: a blade, a skate, a wheel that does not slip."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from mbd_ros.core.contracts import Now, Value, Wrench, exerted_on
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Unit, Vector
from mbd_ros.core.rows.constraint import Constraint, Level, Row
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError

_LINEAR = slice(0, 3)


class KnifeEdge(Constraint):
    """Nonholonomic constraint n . v = 0 on the velocity of a point of a link over the ground.

    The direction n is fixed in the link of the point. The constraint has no position level, since
    the point reaches any position by turning; so only velocities are corrected. It does not keep
    the point on the ground; a `point_on_plane` does. A positive multiplier pushes the point along
    n and the ground in the opposite direction.

    Source: J. Neimark, N. Fufaev, Dynamics of Nonholonomic Systems, 1972, ch. 2.

    Args:
        frame: Link (or frame) of the edge.
        direction: Direction n across the edge in `frame`, of any length, shape (3,).
        point: Point of the edge in `frame`, shape (3,).
        ground_frame: Link (or frame) that the edge moves on; the world by default.

    Raises:
        ModelError: Unknown frame, or two frames without relative motion.
    """

    reads = Reads.DRIFT
    level = Level.VELOCITY
    example = {"frame": "foot", "direction": [1.0, 0.0, 0.0]}

    def __init__(
        self,
        robot: Robot,
        *,
        frame: str,
        direction: Annotated[Vector, Unit("-")],
        point: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
        ground_frame: str = "universe",
    ) -> None:
        n = np.array(direction, dtype=np.float64)
        n = n / np.abs(n).max()  # so that its square neither vanishes nor overflows
        self._n = n / np.linalg.norm(n)
        self._pair = robot.pair(robot.point(ground_frame), robot.point(frame, point))
        self.rows = (Row("force", "N", frame),)
        a, b = self._pair.a, self._pair.b
        self.outputs = (exerted_on(a, b), exerted_on(b, b))

    @staticmethod
    def check(direction: Sequence[float]) -> None:
        """Refuse a direction of zero length."""
        if not any(direction):
            raise ModelError(f"direction {direction} must not be zero")

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Return the map from joint velocities to n . v, shape (1, nv)."""
        motion = k.motion(self._pair)
        return self._normal(k).dot(motion.jacobian(motion.placed(), _LINEAR)).reshape(1, -1)

    def drift(self, k: Kinematics, x: State) -> Array:
        """Return n . v' + (omega x n) . v at zero joint acceleration, shape (1,)."""
        return self.accelerations(k, x)[1]

    def accelerations(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """Return `jacobian` and `drift`, which share the relative motion."""
        motion, n = k.motion(self._pair), self._normal(k)
        linear, omega, _ = motion.motion(motion.place())
        J = motion.jacobian(motion.placed(), _LINEAR)
        drift = n.dot(linear) + np.cross(omega, n).dot(J.dot(x.v))
        return n.dot(J).reshape(1, -1), k.array((drift,))

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> Sequence[Value]:
        """Return the forces on the ground and on the edge."""
        return [wrench.numbers for wrench in self.wrenches(k, x, now.lam)]

    def wrenches(self, k: Kinematics, x: State, lam: Array) -> tuple[Wrench, ...]:
        """Return the forces at the point: on the ground, then on the edge."""
        _, a, b, _ = self._pair
        force, at, free = k.rotation(b).dot(self._n) * lam[0], k.position(b), np.zeros(3)
        return Wrench(a.frame, at, -force, free), Wrench(b.frame, at, force, free)

    def _normal(self, k: Kinematics) -> Array:
        """Return n in the axes of the ground, shape (3,)."""
        normal: Array = k.motion(self._pair).rotation().dot(self._n)
        return normal
