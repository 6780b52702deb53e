"""Markers of what the parts of a scene exert: arrows of forces, and friction cones."""

from typing import Any

from geometry_msgs.msg import Point
from pinocchio import FrameType
from visualization_msgs.msg import Marker, MarkerArray

from mbd_ros.core.model.robot import Robot
from mbd_ros.methods.simulation.live_simulation import LiveSimulation
from msg_adapters.markers import Arrow, Cone, MarkerWriter


class Drawing:
    """Markers of a live simulation, by the names of its arrows and cones.

    Args:
        robot: The robot of the scene.
    """

    def __init__(self, robot: Robot) -> None:
        self._origin = robot.origin
        self._writer = MarkerWriter(MarkerArray(), Marker, Point, root_link(robot))

    def write(self, live: LiveSimulation, stamp: int, length: float) -> Any:
        """MarkerArray of the newest state.

        Args:
            stamp: Header stamp [ns].
            length: Of an arrow, and height of a cone, per force [m/N].

        Raises:
            MessageError: Something is not finite, or no message can carry the stamp.
        """
        showing, origin = live.showing, self._origin
        arrows = [
            Arrow(one.name, wrench.point + origin, wrench.force)
            for one, wrench in zip(showing.arrows, live.wrenches(), strict=True)
        ]
        cones = [
            Cone(name, cone.point + origin, cone.normal, cone.mu)
            for name, cone in zip(showing.cones, live.cones(), strict=True)
        ]
        return self._writer.write(stamp, arrows, length, cones)


def root_link(robot: Robot) -> str:
    """Link that stands for the world."""
    frames = robot.model.frames
    links = [f.name for f in frames if f.type == FrameType.BODY and f.parentJoint == 0]
    return str(links[0]) if links else "world"
