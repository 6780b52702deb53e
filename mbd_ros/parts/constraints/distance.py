"""Two points at a fixed distance."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from mbd_ros.core.contracts import Now, Value, Wrench, exerted_on
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Positive, Unit, Vector
from mbd_ros.core.rows.constraint import Constraint, Row
from mbd_ros.core.state import Array, State

_COINCIDENT = 1.0e-9  # share of the distance below which the line has no direction
_ANY_DIRECTION = np.array((1.0, 0.0, 0.0))


class Distance(Constraint):
    """Massless bar with ball joints at its ends: g = |p_b - p_a| - distance.

    A positive multiplier pushes the points apart, a negative one is the tension of the bar. If
    the points coincide, which no valid configuration does, the direction of the bar is taken as x
    of the world, so that all values stay finite.

    Args:
        frame_a: Link (or frame) of one end; the root link or `universe` for a fixed point.
        frame_b: Link (or frame) of the other end.
        distance: Length of the bar.
        point_a: End a in `frame_a`, shape (3,).
        point_b: End b in `frame_b`, shape (3,).

    Raises:
        ModelError: Unknown frame, or both ends on one body.
    """

    reads = Reads.DRIFT
    example = {"frame_a": "world", "frame_b": "foot", "distance": 0.9}

    def __init__(
        self,
        robot: Robot,
        *,
        frame_a: str,
        frame_b: str,
        distance: Annotated[Positive, Unit("m")],
        point_a: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
        point_b: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
    ) -> None:
        self._a = robot.point(frame_a, point_a)
        self._b = robot.point(frame_b, point_b)
        self._dependence = np.abs(robot.pair(self._a, self._b).columns)
        self._distance = distance
        self._shortest = _COINCIDENT * distance
        self.rows = (Row("force", "N"),)
        self.outputs = (exerted_on(self._a, self._a), exerted_on(self._b, self._b))

    def residual(self, k: Kinematics, x: State) -> Array:
        """Return g, the excess of the distance over the length of the bar [m], shape (1,)."""
        line = k.position(self._b) - k.position(self._a)
        return k.array((k.hypot(line) - self._distance,))

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Return the derivative of the distance with respect to q, shape (1, nv)."""
        return self._jacobian(k, self._direction(k)[0])

    def drift(self, k: Kinematics, x: State) -> Array:
        """Return the second time derivative of the distance at zero joint acceleration, (1,).

        n . (p_b'' - p_a'') + (|v|^2 - (n . v)^2) / |p_b - p_a| with v = p_b' - p_a'.
        """
        return self._drift(k, *self._direction(k))

    def accelerations(self, k: Kinematics, x: State) -> tuple[Array, Array]:
        """Return `jacobian` and `drift` with a shared direction."""
        n, length = self._direction(k)
        return self._jacobian(k, n), self._drift(k, n, length)

    def _jacobian(self, k: Kinematics, n: Array) -> Array:
        jacobian: Array = k.dot(n, k.jacobian(self._b))
        if self._a.moves:
            # Joints that move both ends get exact zeros instead of small differences.
            jacobian = (jacobian - k.dot(n, k.jacobian(self._a))) * self._dependence
        return k.row(jacobian)

    def _drift(self, k: Kinematics, n: Array, length: float) -> Array:
        along = k.dot(n, k.acceleration(self._b) - k.acceleration(self._a))
        v = k.velocity(self._b) - k.velocity(self._a)
        across = v - n * k.dot(n, v)
        centripetal = k.dot(across, across) / k.maximum(length, self._shortest)
        return k.array((along + k.where(length > self._shortest, centripetal, 0.0),))

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> Sequence[Value]:
        """Return the forces at the ends of the bar."""
        return [wrench.numbers for wrench in self.wrenches(k, x, now.lam)]

    def wrenches(self, k: Kinematics, x: State, lam: Array) -> tuple[Wrench, ...]:
        """Return the forces at the ends of the bar."""
        force, free = self._direction(k)[0] * lam[0], np.zeros(3)
        return (
            Wrench(self._a.frame, k.position(self._a), -force, free),
            Wrench(self._b.frame, k.position(self._b), force, free),
        )

    def _direction(self, k: Kinematics) -> tuple[Array, float]:
        """Return the unit vector from end a to end b, and their distance [m]."""
        line = k.position(self._b) - k.position(self._a)
        length = k.hypot(line)
        along = line / k.maximum(length, self._shortest)
        return k.where(length > self._shortest, along, _ANY_DIRECTION), length
