"""Cases that several tests share: cone contact."""

from mbd_ros.core.geometry.shapes import Between, HalfSpace, Side, Sphere
from mbd_ros.core.rows.frame_rows import plane_of
from mbd_ros.parts.contacts.rigid import Rigid

FRICTIONS = (0.0, 0.1, 0.5, 1.0, 3.0, 30.0)


def touch_down(robot, frame, normal, tip=(0, 0, 0), **laws):
    """Contact of a point of a link with a plane through the origin of the world."""
    plane = HalfSpace(plane_of(robot, robot.point("universe"), normal))
    sides = Side(frame, (Sphere(robot.point(frame, tip), 0.0),)), Side("universe", (plane,))
    return Rigid(robot, between=Between(*sides), **laws)
