"""Constant wrench on a link."""

from typing import Annotated, Literal

import numpy as np

from mbd_ros.core.contracts import Load, Wrench
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Unit, Vector
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError


class AppliedWrench(Load):
    """Constant force and torque at a point of a link: tau = J' (force, torque).

    The point moves with the link. Expressed in the axes of the world, the wrench keeps its
    direction; expressed in the axes of the frame, it turns with the link, as that of a thruster.

    Args:
        frame: Link (or frame) that the wrench acts on.
        force: Force in the axes of `expressed_in`, shape (3,).
        torque: Torque in the axes of `expressed_in`, shape (3,).
        point: Point of `frame` at which the force acts, shape (3,).
        expressed_in: Axes of force and torque: `world`, or `frame` for the axes of the link.

    Raises:
        ModelError: Unknown frame, or one that cannot move.
    """

    reads = Reads.JACOBIAN
    example = {"frame": "foot", "force": [10.0, 0.0, 50.0], "point": [0.1, 0.0, 0.0]}

    def __init__(
        self,
        robot: Robot,
        *,
        frame: str,
        force: Annotated[Vector, Unit("N")] = (0.0, 0.0, 0.0),
        torque: Annotated[Vector, Unit("N·m")] = (0.0, 0.0, 0.0),
        point: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
        expressed_in: Literal["world", "frame"] = "world",
    ) -> None:
        self._point = robot.point(frame, point)
        self._follows_link = expressed_in == "frame"
        if not self._point.moves:
            raise ModelError(f"frame '{frame}' cannot move, so a wrench on it has no effect")
        self._wrench = np.array([*force, *torque])

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the generalized force, shape (nv,)."""
        jacobian = k.local_jacobian if self._follows_link else k.spatial_jacobian
        tau: Array = k.dot(self._wrench, jacobian(self._point))
        return tau

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
        """Return the wrench on the link."""
        axes = k.rotation(self._point) if self._follows_link else np.eye(3)
        force, torque = axes.dot(self._wrench[:3]), axes.dot(self._wrench[3:])
        return (Wrench(self._point.frame, k.position(self._point), force, torque),)

    def potential(self, k: Kinematics, x: State) -> float:
        """Return the potential energy of a force of constant direction, -force . point [J].

        It is zero for a wrench that turns with the link. A constant torque has no potential in
        three dimensions and is not counted.
        """
        if self._follows_link:
            return 0.0
        return -k.dot(self._wrench[:3], k.position(self._point))
