"""visualization_msgs/MarkerArray: forces and friction cones, places of markers, shapes to draw."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_adapters.errors import MessageError, listed, require_finite
from msg_adapters.time import read_time, write_time

# Kinds and actions of the class Marker.
_ARROW, _SPHERE, _LINE_STRIP, _LINE_LIST, _TRIANGLES = 0, 2, 4, 5, 11
_POINTS = (6, 7, 8)  # cubes, spheres and points, as lists
_ADD, _DELETE = 0, 2
_SHAFT, _HEAD = 0.01, 0.02  # m, diameters of an arrow
_DIAMETER = 0.02  # m, of a marker of motion capture
_SIDES = 24  # of the polygon that a cone ends in
_RED, _PALE = (0.9, 0.2, 0.1, 1.0), (0.2, 0.5, 0.9, 0.35)  # red, green, blue, opacity
_MOST_SHAPES = 10_000  # points, and lines


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


class MarkerPlaceReader:
    """Reads messages of motion capture, whose markers may be reordered, missing or additional.

    A marker goes by its `text`, else by its namespace `ns`; its place is `pose.position`. Markers
    that are not in the array, deleted ones and places that are not finite are not seen. The first
    header has the stamp, and all markers have one frame.

    Args:
        labels: The markers asked for.

    Attributes:
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
            msg: MarkerArray, or anything with the same fields.

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


class MarkerSample(NamedTuple):
    """Markers of one message in the order of the reader's labels.

    Attributes:
        stamp: Header stamp [ns]; 0 where the publisher set none.
        places: In the frame of the message [m], NaN where one was not seen, shape (n, 3).
    """

    stamp: int
    places: NDArray[np.float64]


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
        places: In the frame [m], shape (n, 3).
        new_marker: The class Marker.

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
        marker.scale.x = marker.scale.y = marker.scale.z = _DIAMETER
        marker.color.r = marker.color.a = 1.0
        msg.markers.append(marker)
    return msg


def read_shapes(msg: Any) -> Shapes:
    """The first points and lines of a message, 10 000 each, whatever they stand for.

    Lists of points and lines are placed by the pose of their marker; of a text, mesh or solid its
    place remains. Frames are not looked at: all count as axes of the world. What is not finite is
    left out.
    """
    points, lines = [np.zeros((0, 3))], [np.zeros((0, 2, 3))]
    for marker in msg.markers:
        if marker.action != _ADD:
            continue
        corners = _corners(marker)
        if marker.type == _LINE_STRIP or (marker.type == _ARROW and len(corners) == 2):
            lines.append(np.stack((corners[:-1], corners[1:]), axis=1))
        elif marker.type == _LINE_LIST:
            lines.append(corners[: len(corners) // 2 * 2].reshape(-1, 2, 3))
        elif marker.type in _POINTS:
            points.append(corners)
        else:
            at = marker.pose.position
            points.append(np.array([[at.x, at.y, at.z]]))
    every, drawn = np.concatenate(points)[:_MOST_SHAPES], np.concatenate(lines)[:_MOST_SHAPES]
    return Shapes(
        every[np.isfinite(every).all(axis=1)], drawn[np.isfinite(drawn).all(axis=(1, 2))]
    )


class Shapes(NamedTuple):
    """The shapes that a message shows.

    Attributes:
        points: [m], shape (n, 3).
        lines: Begin and end of lines and arrows [m], shape (m, 2, 3).
    """

    points: NDArray[np.float64]
    lines: NDArray[np.float64]


def _corners(marker: Any) -> NDArray[np.float64]:
    """The points of a marker, moved by its pose, shape (n, 3)."""
    corners = np.array([(p.x, p.y, p.z) for p in marker.points[: 2 * _MOST_SHAPES]]).reshape(-1, 3)
    at, turn = marker.pose.position, marker.pose.orientation
    axis = np.array([turn.x, turn.y, turn.z])
    turned = 2.0 * np.cross(axis, corners)
    moved: NDArray[np.float64] = corners + turn.w * turned + np.cross(axis, turned)
    return moved + np.array([at.x, at.y, at.z])
