"""Pulling a link with the mouse: a spring from where it was taken to the pointer."""

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array
from mbd_ros.view.live_robot import LiveRobot

# A spring that swings what the joint carries 0.7 times a second: slow enough for a browser, whose
# pointer is known some 0.1 s late, and for what is lighter than that by a factor of ten.
_STIFFNESS = (2.0 * np.pi * 0.7) ** 2  # 1/s^2
_LONGEST = 2.0  # of the size of the robot, what counts of a pull at most
COLOUR = (40, 90, 200)


class Pulled(NamedTuple):
    """A force on a link.

    Attributes:
        robot: Which of the robots.
        joint: Index in the model of the joint that carries the link.
        link: Name of the link.
        place: Where the force acts, less `Robot.origin` [m], shape (3,).
        force: In world axes [N], shape (3,).
    """

    robot: int
    joint: int
    link: str
    place: Array
    force: Array


class _Grip(NamedTuple):
    """What the mouse holds: a place in the axes of a joint [m], and the pointer on the page."""

    robot: int
    joint: int
    link: str
    held: Array
    pointer: Array


class Pull:
    """Forces of the mouse on links: of the browser that began last.

    Args:
        robots: The robots of the page, as shown.
        server: The `viser.ViserServer`.

    Attributes:
        strength: Factor of the force.
    """

    def __init__(self, robots: list[LiveRobot], server: Any) -> None:
        self._robots, self._scene = robots, server.scene
        self.strength = 1.0
        self._grip: _Grip | None = None
        self._line: Any = None
        self._takers = [
            (node, self._taker(number, solid))
            for number, robot in enumerate(robots)
            for solid, node in robot.stage.solids
            if solid.joint
        ]
        self._needs_shift = True
        for node, take in self._takers:
            node.on_drag("left", modifier="shift")(take)

    def need_shift(self, is_needed: bool) -> None:
        """Let a drag with shift pull, or any drag on a link, as fingers need it."""
        if is_needed == self._needs_shift:
            return
        self._needs_shift = is_needed
        for node, take in self._takers:
            if is_needed:
                node.remove_drag_callback(take)
                node.on_drag("left", modifier="shift")(take)
            else:
                node.on_drag("left")(take)

    def now(self) -> Pulled | None:
        """The force at the poses that were drawn last; None while nobody pulls."""
        grip = self._grip
        if grip is None:
            self._show(None)
            return None
        robot = self._robots[grip.robot]
        at = _pose(robot, grip.joint)
        place = at.act(grip.held)
        away = grip.pointer - robot.offset - place
        length = float(np.linalg.norm(away))
        away *= min(1.0, _LONGEST * robot.size / max(length, 1.0e-12))
        force = self.strength * _STIFFNESS * max(float(robot.masses[grip.joint]), 1.0e-6) * away
        self._show(np.array([[place + robot.offset, grip.pointer]]))
        return Pulled(grip.robot, grip.joint, grip.link, place, force)

    def _taker(self, number: int, solid: Any) -> Any:
        async def take(event: Any) -> None:  # as a coroutine, so that phases keep their order
            self._take(number, solid, event)

        return take

    def _take(self, number: int, solid: Any, event: Any) -> None:
        if event.phase == "end":
            self._grip = None
            return
        robot, pointer = self._robots[number], np.array(event.end_position, dtype=np.float64)
        grip = self._grip
        if grip is None or event.phase == "start":
            start = np.array(event.start_position, dtype=np.float64) - robot.offset
            held = _pose(robot, solid.joint).actInv(start)
            grip = _Grip(number, solid.joint, solid.link, held, pointer)
        if np.isfinite(grip.held).all() and np.isfinite(pointer).all():
            self._grip = grip._replace(pointer=pointer)

    def _show(self, line: Array | None) -> None:
        if self._line is not None:
            self._line.visible = line is not None
            if line is not None:
                self._line.points = line.astype(np.float32)
        elif line is not None:
            thick = 0.008 * max(robot.size for robot in self._robots)
            both = np.tile(np.array(COLOUR, np.uint8), (1, 2, 1))
            self._line = self._scene.add_line_segments("/pull", line, both, thickness=thick)


def _pose(robot: LiveRobot, joint: int) -> Any:
    """`pinocchio.SE3` of a joint as it was drawn last."""
    pose = robot.drawn.poses[joint]
    turn = pin.Quaternion(*pose[3:].tolist())
    return pin.SE3(turn.matrix(), pose[:3].copy())
