"""Spring and damper between two points."""

import math
from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.parts import Load, Wrench
from mbd_ros.core.ranges import NotNegative, Unit, Vector
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError

_AXES = pin.LOCAL_WORLD_ALIGNED


class PointSpring(Load):
    """Massless spring and damper between two points at the distance d.

        F = stiffness (d - length) + damping d',   tau = -F grad d

    It pulls the points together where F > 0 and pushes them apart where F < 0 (it does not go
    slack as a rope does). With d = 0 the line has no direction, and F is zero; only for `length` 0
    and without damping is that the limit of the forces nearby.

    Args:
        robot: Robot of the scene.
        frame_a: Link (or frame) of one end; the root link or `universe` for a point at rest.
        frame_b: Link (or frame) of the other end.
        point_a: End in `frame_a`, shape (3,).
        point_b: End in `frame_b`, shape (3,).
        stiffness: Of the spring.
        damping: Of the damper.
        length: Distance without spring force.

    Raises:
        ModelError: Unknown frame, or both ends on one body.
    """

    reads = Reads.JACOBIAN
    example = {"frame_a": "world", "frame_b": "foot", "stiffness": 200.0, "length": 0.1}

    def __init__(
        self,
        robot: Robot,
        *,
        frame_a: str,
        frame_b: str,
        point_a: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
        point_b: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
        stiffness: Annotated[NotNegative, Unit("N/m")] = 0.0,
        damping: Annotated[NotNegative, Unit("N·s/m")] = 0.0,
        length: Annotated[NotNegative, Unit("m")] = 0.0,
    ) -> None:
        ends = [_end(robot, frame_a, point_a), _end(robot, frame_b, point_b)]
        a, b = sorted(ends, key=lambda end: end[0])
        (self._joint_a, self._at_a, frame), (self._joint_b, self._at_b, other) = a, b
        self._frames = frame, other
        if self._joint_a == self._joint_b:  # sorted: only end a can be at rest
            raise ModelError(f"frames '{frame_a}' and '{frame_b}' do not move against each other")
        self._stiffness, self._damping, self._length = stiffness, damping, length
        self._model, self._nv = robot.model, int(robot.model.nv)
        self._point_a, self._point_b = self._at_a.translation, self._at_b.translation

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force, shape (nv,)."""
        _, slope, pull = self._tension(k, x)
        tau: Array = slope * -pull
        return tau

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
        """Forces at the ends of the spring."""
        direction, _, pull = self._tension(k, x)
        force, free, places = direction * pull, np.zeros(3), k.data.oMi
        return (
            Wrench(self._frames[0], places[self._joint_a].act(self._point_a), force, free),
            Wrench(self._frames[1], places[self._joint_b].act(self._point_b), -force, free),
        )

    def _tension(self, k: Kinematics, x: State) -> tuple[Array, Array, float]:
        """From end a to end b, rate of the distance with every joint, and F [N]."""
        line = self._line(k)
        distance = math.hypot(*line.tolist())
        if distance == 0.0:
            return line, np.zeros(self._nv), 0.0
        direction = line / distance
        slope: Array = direction.dot(self._jacobian(k, self._joint_b, self._at_b))
        if self._joint_a:
            slope = slope - direction.dot(self._jacobian(k, self._joint_a, self._at_a))
        stretch = distance - self._length
        return direction, slope, self._stiffness * stretch + self._damping * float(slope.dot(x.v))

    def potential(self, k: Kinematics, x: State) -> float:
        """Energy of the spring, zero at its length [J]."""
        stretch = math.hypot(*self._line(k).tolist()) - self._length
        return 0.5 * self._stiffness * stretch * stretch

    def _jacobian(self, k: Kinematics, joint: int, at: Any) -> Array:
        """From joint velocities to that of an end, in the world, shape (3, nv)."""
        whole = pin.getFrameJacobian(self._model, k.data, joint, at, _AXES)
        part: Array = whole.reshape(6, self._nv)[:3]  # with one joint it comes as a vector
        return part

    def _line(self, k: Kinematics) -> Array:
        """From end a to end b, in the world [m], shape (3,)."""
        places = k.data.oMi
        begin, end = (
            places[self._joint_a].act(self._point_a),
            places[self._joint_b].act(self._point_b),
        )
        line: Array = end - begin
        return line


def _end(robot: Robot, frame: str, point: Sequence[float]) -> tuple[int, Any, str]:
    """Joint that carries an end, the end in the frame of that joint, and the link."""
    link = robot.model.frames[robot.frame(frame)]
    at = link.placement * pin.SE3(np.eye(3), np.array(point, dtype=np.float64))
    return int(link.parentJoint), at, frame
