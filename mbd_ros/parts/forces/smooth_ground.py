"""Ground that begins softly, with derivatives of every order: for prediction."""

from typing import Annotated

import numpy as np

from mbd_ros.core.contracts import Load, Now, Output, Wrench
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Positive, Unit, Vector
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError

_SHORTEST = 1.0e-9


class SmoothGround(Load):
    """A plane that pushes a point of a link, a little before they touch.

        N = stiffness s ln(1 + exp(d / s)) max(0, 1 + dissipation d')
        friction force = -friction N slip / sqrt(|slip|² + creep²)

    d is the depth below the plane, s the `smoothing`. Well below the plane N is stiffness d, a
    few s above it nothing. At a gap of 0 it is 0.69 stiffness s, so s must be small beside the
    depth under load; the smaller it is, the shorter are steps and intervals where the point comes
    and goes. Friction creeps: at a share w of the largest one with about w creep. `compliant`
    pushes within the depth alone, and has features of bodies.

    Source: the factor of dissipation is that of K. H. Hunt, F. R. E. Crossley, J. Appl. Mech. 42,
        1975, 440-445.

    Args:
        frame: Link (or frame) that touches.
        point: Of it, shape (3,).
        stiffness: Of the ground.
        dissipation: Share of the force that a speed of approach adds.
        smoothing: Depth over which the ground begins.
        friction: Coefficient of friction.
        creep: Slip at which friction is 0.71 of its largest.
        normal: Out of the ground, in axes of the world, of any length.
        height: Of the plane above the origin of the world, along the normal.

    Raises:
        ModelError: Unknown frame, one that does not move, or a normal of no length.
    """

    reads = Reads.JACOBIAN
    gives_work = True
    outputs = (Output("normal", "N"),)
    example = {
        "frame": "foot",
        "point": [0.1, 0.0, 0.0],
        "stiffness": 100.0,
        "dissipation": 0.1,
        "smoothing": 1.0e-3,
        "friction": 0.8,
        "creep": 0.05,
        "height": 2.0,
    }

    def __init__(
        self,
        robot: Robot,
        *,
        frame: str,
        stiffness: Annotated[Positive, Unit("N/m")],
        point: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
        dissipation: Annotated[NotNegative, Unit("s/m")] = 0.5,
        smoothing: Annotated[Positive, Unit("m")] = 1.0e-3,
        friction: Annotated[NotNegative, Unit("-")] = 0.0,
        creep: Annotated[Positive, Unit("m/s")] = 0.05,
        normal: Annotated[Vector, Unit("-")] = (0.0, 0.0, 1.0),
        height: Annotated[float, Unit("m")] = 0.0,
    ) -> None:
        self._point = robot.point(frame, point)
        if not self._point.moves:
            raise ModelError(f"frame '{frame}' does not move, ground under it changes nothing")
        length = float(np.linalg.norm(normal))
        if length < _SHORTEST:
            raise ModelError(f"normal {list(normal)} has no length")
        self._normal = np.array(normal) / length
        self._height = height
        self._stiffness = stiffness
        self._dissipation = dissipation
        self._smoothing = smoothing
        self._friction = friction
        self._creep = creep

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force, shape (nv,)."""
        tau: Array = k.dot(self._pushed(k, x)[0], k.jacobian(self._point))
        return tau

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
        """The force on the point."""
        force, _ = self._pushed(k, x)
        return (Wrench(self._point.frame, k.position(self._point), force, np.zeros(3)),)

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> tuple[float, ...]:
        """The force along the normal."""
        return (self._pushed(k, x)[1],)

    def _pushed(self, k: Kinematics, x: State) -> tuple[Array, float]:
        """Force in axes of the world, shape (3,), and its part along the normal."""
        velocity = k.dot(k.jacobian(self._point), x.v)
        rise = k.dot(self._normal, velocity)
        depth = self._height - k.dot(self._normal, k.position(self._point))
        s = self._smoothing
        beyond = s * k.log(1.0 + k.exp(-k.maximum(depth, -depth) / s))
        soft = k.maximum(depth, 0.0) + beyond
        size = self._stiffness * soft * k.maximum(1.0 - self._dissipation * rise, 0.0)
        slip = velocity - self._normal * rise
        speed = k.sqrt(k.dot(slip, slip) + self._creep * self._creep)
        force: Array = self._normal * size - slip * (self._friction * size / speed)
        return force, size
