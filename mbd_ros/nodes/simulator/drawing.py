"""What parts of a scene exert, as markers: arrows of forces and friction cones."""

from typing import Any

from geometry_msgs.msg import Point
from visualization_msgs.msg import Marker, MarkerArray

from mbd_ros.core.model.robot import Robot
from mbd_ros.core.simulation.live_simulation import LiveSimulation
from msg_adapters.markers import Arrow, Cone, MarkerWriter


class Drawing:
    """Markers of a live simulation, by the names of its arrows and cones.

    Args:
        robot: The robot of the scene.
        frame_id: Link that stands for the world.
    """

    def __init__(self, robot: Robot, frame_id: str) -> None:
        self._origin = robot.origin
        self._writer = MarkerWriter(MarkerArray(), Marker, Point, frame_id)

    def write(self, live: LiveSimulation, stamp: int, length: float) -> Any:
        """MarkerArray of the newest state.

        Args:
            live: The simulation.
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
