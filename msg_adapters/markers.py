"""visualization_msgs/MarkerArray of forces as arrows."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_adapters.finite import require_finite
from msg_adapters.time import write_time

_ARROW, _ADD = 0, 0  # Marker.ARROW, Marker.ADD
_SHAFT, _HEAD = 0.01, 0.02  # m, diameters


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


class ArrowWriter:
    """Refills one kept MarkerArray; ids are places in the sequence, so that arrows move.

    Args:
        msg: A fresh MarkerArray.
        new_marker: The class Marker.
        new_point: The class geometry_msgs/Point.
        frame_id: Frame of all arrows.
        color: Red, green, blue, opacity, 0 .. 1.
    """

    def __init__(
        self,
        msg: Any,
        new_marker: Any,
        new_point: Any,
        frame_id: str,
        color: Sequence[float] = (0.9, 0.2, 0.1, 1.0),
    ) -> None:
        self.msg, self._new_marker, self._new_point = msg, new_marker, new_point
        self._frame_id, self._color = frame_id, [float(part) for part in color]

    def write(self, stamp: int, arrows: Sequence[Arrow], length: float) -> Any:
        """The kept message with these arrows.

        Args:
            stamp: Header stamp [ns].
            arrows: As many at every call.
            length: Of an arrow per force [m/N].

        Raises:
            MessageError: An end of an arrow is not finite, or no message can carry the stamp.
        """
        while len(self.msg.markers) < len(arrows):
            self.msg.markers.append(self._marker(len(self.msg.markers)))
        for marker, arrow in zip(self.msg.markers, arrows, strict=True):
            write_time(marker.header.stamp, stamp)
            marker.ns = arrow.name
            tail, head = marker.points
            tip = arrow.point + length * arrow.force
            require_finite(
                **{f"arrow of {arrow.name}": tip, f"place of {arrow.name}": arrow.point}
            )
            tail.x, tail.y, tail.z = arrow.point.tolist()
            head.x, head.y, head.z = tip.tolist()
        return self.msg

    def _marker(self, number: int) -> Any:
        marker = self._new_marker()
        marker.header.frame_id = self._frame_id
        marker.id, marker.type, marker.action = number, _ARROW, _ADD
        marker.points = [self._new_point(), self._new_point()]
        marker.pose.orientation.w = 1.0
        marker.scale.x, marker.scale.y = _SHAFT, _HEAD
        marker.color.r, marker.color.g, marker.color.b, marker.color.a = self._color
        return marker
