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
    """A point on a link whose position in the world a motion capture system sees.

    The marker does not slide on its link: skin and soft tissue are left out.

    Args:
        frame: Link (or frame) that carries it; `world` for one at rest.
        xyz: Place in `frame`, shape (3,).
        weight: Of its squared distance in marker kinematics; 0 leaves it out.
        label: What recordings and messages call it; empty for its name.
        fixed: Whether its place on the link is certain, as models of OpenSim say it; a note only.
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
        """Position in the world [m], shape (3,)."""
        return k.position(self.point) + self.origin

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Derivative by q [m/rad or 1], shape (3, nv)."""
        return k.jacobian(self.point)

    def covariance(self, k: Kinematics, x: State) -> Array:
        """The same noise in all directions [m^2], shape (3, 3)."""
        return self.noise**2 * np.eye(3)

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> Sequence[Value]:
        """Position in the world [m]."""
        return (self.measure(k, x, now),)
