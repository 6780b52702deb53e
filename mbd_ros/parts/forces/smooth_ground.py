"""Ground contact with smooth derivatives of any order, for optimal control."""

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
    """Contact of a point of a link with a plane whose force starts smoothly above the plane.

        N = stiffness s ln(1 + exp(d / s)) max(0, 1 + dissipation d')
        friction force = -friction N slip / sqrt(|slip|² + creep²)

    d is the depth below the plane and s is `smoothing`. Well below the plane N is stiffness d, a
    few s above it N vanishes, and on the plane N is 0.69 stiffness s. So s must be small compared
    with the depth under load; but the smaller it is, the shorter the time steps and mesh intervals
    must be where the point touches down and lifts off. Friction creeps: to carry the fraction w of
    the largest friction, the point slips at about w creep. The part `compliant` exerts forces only
    below the plane, and models contact of whole bodies.

    Source: the factor of dissipation is that of K. H. Hunt, F. R. E. Crossley, J. Appl. Mech. 42,
        1975, 440-445.

    Args:
        frame: Link (or frame) that the point belongs to.
        point: Contact point in `frame`, shape (3,).
        stiffness: Stiffness of the ground.
        dissipation: Relative increase of the force per speed of approach.
        smoothing: Depth s over which the force sets in.
        friction: Friction coefficient.
        creep: Slip velocity at which friction is 71 % of its largest value.
        normal: Normal that points out of the ground, in the axes of the world, of any length.
        height: Height of the plane above the origin of the world, along the normal.

    Raises:
        ModelError: Unknown frame, a frame that cannot move, or a normal of zero length.
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
            raise ModelError(f"frame '{frame}' cannot move, so ground under it has no effect")
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
        """Return the generalized force, shape (nv,)."""
        tau: Array = k.dot(self._contact_force(k, x)[0], k.jacobian(self._point))
        return tau

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
        """Return the force on the point."""
        force, _ = self._contact_force(k, x)
        return (Wrench(self._point.frame, k.position(self._point), force, np.zeros(3)),)

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> tuple[float, ...]:
        """Return the normal force [N]."""
        return (self._contact_force(k, x)[1],)

    def _contact_force(self, k: Kinematics, x: State) -> tuple[Array, float]:
        """Return the force in the axes of the world, shape (3,), and the normal force N."""
        velocity = k.dot(k.jacobian(self._point), x.v)
        rise = k.dot(self._normal, velocity)
        depth = self._height - k.dot(self._normal, k.position(self._point))
        s = self._smoothing
        rounding = s * k.log(1.0 + k.exp(-k.maximum(depth, -depth) / s))
        smooth_depth = k.maximum(depth, 0.0) + rounding  # s ln(1 + exp(d / s)), never overflows
        N = self._stiffness * smooth_depth * k.maximum(1.0 - self._dissipation * rise, 0.0)
        slip = velocity - self._normal * rise
        speed = k.sqrt(k.dot(slip, slip) + self._creep * self._creep)
        force: Array = self._normal * N - slip * (self._friction * N / speed)
        return force, N
