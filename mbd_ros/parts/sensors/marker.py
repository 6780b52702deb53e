"""Marker of a motion capture system."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from mbd_ros.core.contracts import Kind, Measures, Now, Output, Sensor, Value
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Unit, Vector
from mbd_ros.core.state import Array, State


class Marker(Sensor):
    """Marker: point of a link whose position in the world a motion capture system measures.

    The marker is fixed to its link; motion of skin and soft tissue is left out.

    Args:
        frame: Link (or frame) of the marker; `world` for a fixed marker.
        xyz: Position in `frame`, shape (3,).
        weight: Weight of its squared distance in marker kinematics; 0 excludes the marker.
        label: Name in recordings and messages; by default the name of the sensor.
        fixed: Whether an OpenSim model calls its position on the link certain; it has no effect.
        noise: Standard deviation of each component.
    """

    example = {"frame": "foot", "xyz": [0.1, 0.0, 0.02]}
    level = Measures.POSITION
    reads = Reads.POSITION
    unit = "m"
    components = ("x", "y", "z")
    outputs = (Output("position", "m", Kind.VECTOR),)

    def __init__(
        self,
        robot: Robot,
        *,
        frame: str,
        xyz: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
        weight: Annotated[NotNegative, Unit("-")] = 1.0,
        label: str = "",
        fixed: bool = False,
        noise: Annotated[NotNegative, Unit("m")] = 0.001,
    ) -> None:
        self.point = robot.point(frame, xyz)
        self.origin = robot.origin
        self.frame = frame
        self.xyz = xyz
        self.weight = weight
        self.noise = noise
        self.label = label
        self.fixed = fixed

    def measure(self, k: Kinematics, x: State, now: Now | None) -> Array:
        """Return the position in the world [m], shape (3,)."""
        return k.position(self.point) + self.origin

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Return the derivative with respect to q [m/rad or 1], shape (3, nv)."""
        return k.jacobian(self.point)

    def covariance(self, k: Kinematics, x: State) -> Array:
        """Return the covariance, equal for all directions [m^2], shape (3, 3)."""
        return self.noise**2 * np.eye(3)

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> Sequence[Value]:
        """Return the position in the world [m]."""
        return (self.measure(k, x, now),)
