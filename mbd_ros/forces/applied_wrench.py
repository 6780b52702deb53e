"""Constant wrench on a link."""

from typing import Annotated, Literal

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.parts import Load, Wrench
from mbd_ros.core.ranges import Unit, Vector
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError

AXES = {"world": pin.LOCAL_WORLD_ALIGNED, "frame": pin.LOCAL}


class AppliedWrench(Load):
    """Constant force and torque at a point of a link: tau = J' (force, torque).

    The point travels with the link. In world axes the load keeps its direction, in those of the
    frame it turns with the link (a thruster).

    Args:
        robot: Robot of the scene.
        frame: Link (or frame) that carries the load.
        force: In the axes of `expressed_in`, shape (3,).
        torque: In the same axes, shape (3,).
        point: Where the force acts, in `frame`, shape (3,).
        expressed_in: Axes of force and torque: `world`, or `frame` for those of the link.

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
        link = robot.model.frames[robot.frame(frame)]
        if link.parentJoint == 0:
            raise ModelError(f"frame '{frame}' does not move, a load on it changes nothing")
        self._model, self._joint, self._frame = robot.model, int(link.parentJoint), frame
        self._placement = link.placement * pin.SE3(np.eye(3), np.array(point, dtype=np.float64))
        self._axes, self._turns = AXES[expressed_in], expressed_in == "frame"
        self._wrench = np.array([*force, *torque])

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force, shape (nv,)."""
        jacobian = pin.getFrameJacobian(
            self._model, k.data, self._joint, self._placement, self._axes
        )
        tau: Array = self._wrench.dot(jacobian.reshape(6, -1))  # with one joint it is a vector
        return tau

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
        """The load on the link."""
        at = k.data.oMi[self._joint] * self._placement
        axes = at.rotation if self._turns else np.eye(3)
        force, torque = axes.dot(self._wrench[:3]), axes.dot(self._wrench[3:])
        return (Wrench(self._frame, at.translation, force, torque),)

    def potential(self, k: Kinematics, x: State) -> float:
        """Energy whose slope a force of constant direction is, -force . point [J].

        Zero for a load that turns with the link; the torque has none in three dimensions.
        """
        if self._turns:
            return 0.0
        place = k.data.oMi[self._joint].act(self._placement.translation)
        return -float(self._wrench[:3].dot(place))
