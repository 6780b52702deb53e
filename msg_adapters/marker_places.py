"""visualization_msgs/MarkerArray of motion capture <-> places of labelled markers.

A marker goes by its `text`, else by its namespace `ns`; its place is `pose.position`. Markers that
are not in the array, deleted ones and places that are not finite are not seen. The first header
has the stamp, and all markers have one frame.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_adapters.errors import MessageError, listed
from msg_adapters.time import read_time, write_time

_SPHERE, _ADD = 2, 0  # Marker.SPHERE, Marker.ADD
_SIZE = 0.02  # m, diameter


class MarkerSample(NamedTuple):
    """Markers of one message in the order of the reader's labels.

    Attributes:
        stamp: Header stamp [ns]; 0 where the publisher set none.
        places: In the frame of the message [m], NaN where one was not seen, shape (n, 3).
    """

    stamp: int
    places: NDArray[np.float64]


class MarkerPlaceReader:
    """Reads messages whose markers may be reordered, missing or additional.

    Args:
        labels: The markers asked for.

    Attributes:
        labels: As given.
        extra: Labels of the newest message that were not asked for.
        missing: Markers that it did not show.
        frame: Frame of the newest message.
    """

    def __init__(self, labels: Sequence[str]) -> None:
        self.labels = tuple(labels)
        self._rows = {label: row for row, label in enumerate(self.labels)}
        self.extra: tuple[str, ...] = ()
        self.missing: tuple[str, ...] = ()
        self.frame = ""

    def read(self, msg: Any) -> MarkerSample:
        """Places of one message.

        Args:
            msg: MarkerArray of rclpy, rosbags, or anything with the same fields.

        Raises:
            MessageError: No marker, a label that repeats, several frames, or a bad stamp.
        """
        shown = [marker for marker in msg.markers if marker.action == _ADD]
        if not shown:
            raise MessageError("markers is empty")
        places = np.full((len(self.labels), 3), np.nan)
        taken: set[str] = set()
        extra, self.frame = [], shown[0].header.frame_id
        for marker in shown:
            label = marker.text or marker.ns
            if label in taken:
                raise MessageError(f"two markers are called {listed([label])}")
            if marker.header.frame_id != self.frame:
                frames = listed([self.frame, marker.header.frame_id])
                raise MessageError(f"markers of several frames: {frames}")
            taken.add(label)
            row = self._rows.get(label)
            if row is None:
                extra.append(label)
                continue
            at = marker.pose.position
            places[row] = at.x, at.y, at.z
        places[~np.isfinite(places).all(axis=1)] = np.nan
        self.extra = tuple(extra)
        self.missing = tuple(
            label
            for label, place in zip(self.labels, places[:, 0].tolist(), strict=True)
            if place != place
        )
        return MarkerSample(read_time(shown[0].header.stamp), places)


def write_marker_places(
    msg: Any,
    stamp: int,
    labels: Sequence[str],
    places: NDArray[np.float64],
    new_marker: Any,
    frame_id: str = "world",
) -> Any:
    """Fill a fresh MarkerArray with small spheres; markers that are not seen are left out.

    Args:
        msg: A fresh MarkerArray.
        stamp: Header stamp [ns].
        labels: Of the markers.
        places: In the frame [m], shape (n, 3).
        new_marker: The class Marker.
        frame_id: The frame.

    Raises:
        MessageError: No message can carry the stamp.
    """
    msg.markers = []
    for i, (label, place) in enumerate(zip(labels, places, strict=True)):
        if not np.isfinite(place).all():
            continue
        marker = new_marker()
        marker.header.frame_id, marker.ns, marker.id = frame_id, label, i
        write_time(marker.header.stamp, stamp)
        marker.type, marker.action = _SPHERE, _ADD
        at = marker.pose.position
        at.x, at.y, at.z = place.tolist()
        marker.pose.orientation.w = 1.0
        marker.scale.x = marker.scale.y = marker.scale.z = _SIZE
        marker.color.r = marker.color.a = 1.0
        msg.markers.append(marker)
    return msg
