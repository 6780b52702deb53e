"""visualization_msgs/MarkerArray of forces as arrows, and of friction cones."""

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_adapters.finite import require_finite
from msg_adapters.time import write_time

_ARROW, _TRIANGLES = 0, 11  # Marker.ARROW, Marker.TRIANGLE_LIST
_ADD, _DELETE = 0, 2  # Marker.ADD, Marker.DELETE
_SHAFT, _HEAD = 0.01, 0.02  # m, diameters
_SIDES = 24  # of the polygon that a cone ends in
_RED, _PALE = (0.9, 0.2, 0.1, 1.0), (0.2, 0.5, 0.9, 0.35)  # red, green, blue, opacity


class Arrow(NamedTuple):
    """One force.

    Attributes:
        name: Namespace of the marker.
        point: Where it acts, in the frame of the array [m], shape (3,).
        force: In the axes of that frame [N], shape (3,).
    """

    name: str
    point: NDArray[np.float64]
    force: NDArray[np.float64]


class Cone(NamedTuple):
    """The forces that a contact can exert, as far as its normal force.

    Attributes:
        name: Namespace of the marker.
        point: Its tip, in the frame of the array [m], shape (3,).
        normal: The normal force, its axis and height, in the axes of that frame [N], shape (3,).
        mu: Its radius is mu times its height.
    """

    name: str
    point: NDArray[np.float64]
    normal: NDArray[np.float64]
    mu: float


class MarkerWriter:
    """Refills one kept MarkerArray; ids are places in the sequence, so that markers move.

    A cone without height or width is deleted: scales of 0 are none.

    Args:
        msg: A fresh MarkerArray.
        new_marker: The class Marker.
        new_point: The class geometry_msgs/Point.
        frame_id: Frame of all markers.
    """

    def __init__(self, msg: Any, new_marker: Any, new_point: Any, frame_id: str) -> None:
        self.msg, self._new_marker, self._new_point = msg, new_marker, new_point
        self._frame_id = frame_id

    def write(
        self, stamp: int, arrows: Sequence[Arrow], length: float, cones: Sequence[Cone] = ()
    ) -> Any:
        """The kept message with these arrows and cones.

        Args:
            stamp: Header stamp [ns].
            arrows: As many at every call.
            length: Of an arrow, and height of a cone, per force [m/N].
            cones: As many at every call.

        Raises:
            MessageError: An end of an arrow or cone is not finite, or no message can carry the
                stamp.
        """
        if not self.msg.markers:
            made = [self._arrow() for _ in arrows] + [self._cone() for _ in cones]
            for number, marker in enumerate(made):
                marker.id = number
            self.msg.markers = made
        for marker in self.msg.markers:
            write_time(marker.header.stamp, stamp)
        count = len(arrows)
        for arrow, marker in zip(arrows, self.msg.markers[:count], strict=True):
            _place_arrow(marker, arrow, length)
        for cone, marker in zip(cones, self.msg.markers[count:], strict=True):
            _place_cone(marker, cone, length)
        return self.msg

    def _arrow(self) -> Any:
        marker = self._marker(_ARROW, _RED)
        marker.points = [self._new_point(), self._new_point()]
        marker.pose.orientation.w = 1.0
        marker.scale.x, marker.scale.y = _SHAFT, _HEAD
        return marker

    def _cone(self) -> Any:
        """A cone of unit height and radius, its tip in the origin, along z: poses scale it."""
        marker = self._marker(_TRIANGLES, _PALE)
        turn = 2.0 * math.pi / _SIDES
        rim = [(math.cos(i * turn), math.sin(i * turn), 1.0) for i in range(_SIDES + 1)]
        for first, second in itertools.pairwise(rim):
            marker.points.extend(map(self._point, ((0.0, 0.0, 0.0), first, second)))
        return marker

    def _point(self, at: Sequence[float]) -> Any:
        point = self._new_point()
        point.x, point.y, point.z = at
        return point

    def _marker(self, kind: int, color: Sequence[float]) -> Any:
        marker = self._new_marker()
        marker.header.frame_id = self._frame_id
        marker.type, marker.action = kind, _ADD
        marker.color.r, marker.color.g, marker.color.b, marker.color.a = color
        return marker


def _place_arrow(marker: Any, arrow: Arrow, length: float) -> None:
    marker.ns = arrow.name
    tail, head = marker.points
    tip = arrow.point + length * arrow.force
    require_finite(**{f"arrow of {arrow.name}": tip, f"place of {arrow.name}": arrow.point})
    tail.x, tail.y, tail.z = arrow.point.tolist()
    head.x, head.y, head.z = tip.tolist()


def _place_cone(marker: Any, cone: Cone, length: float) -> None:
    marker.ns = cone.name
    require_finite(
        **{f"height of {cone.name}": length * cone.normal, f"tip of {cone.name}": cone.point}
    )
    size = math.hypot(*cone.normal.tolist())
    height, radius = length * size, length * size * cone.mu
    marker.action = _ADD if height > 0.0 and 0.0 < radius < math.inf else _DELETE
    if marker.action == _DELETE:
        return
    place, turn, scale = marker.pose.position, marker.pose.orientation, marker.scale
    place.x, place.y, place.z = cone.point.tolist()
    turn.x, turn.y, turn.z, turn.w = _from_z_to(*(cone.normal / size).tolist())
    scale.x, scale.y, scale.z = radius, radius, height


def _from_z_to(x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """The smallest rotation from the z axis to a unit vector, as quaternion (x, y, z, w)."""
    if z < 0.0:  # by half a turn about x first: exact near -z, too
        a, b, c, d = _from_z_to(x, -y, -z)
        return d, -c, b, -a
    w = math.sqrt(0.5 * (1.0 + z))
    return -0.5 * y / w, 0.5 * x / w, 0.0, w
