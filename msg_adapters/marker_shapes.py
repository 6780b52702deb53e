"""visualization_msgs/MarkerArray -> points and lines to draw, whatever they stand for.

Lists of points and lines are placed by the pose of their marker; of a text, mesh or solid its
place remains. Frames are not looked at: all count as axes of the world.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

_ADD, _ARROW, _LINE_STRIP, _LINE_LIST, _POINTS = 0, 0, 4, 5, (6, 7, 8)  # of the class Marker
_MOST = 10_000  # points, and lines


class Shapes(NamedTuple):
    """What a message shows.

    Attributes:
        points: [m], shape (n, 3).
        lines: Begin and end of lines and arrows [m], shape (m, 2, 3).
    """

    points: NDArray[np.float64]
    lines: NDArray[np.float64]


def read_shapes(msg: Any) -> Shapes:
    """The first points and lines of a message, 10 000 each; what is not finite is left out."""
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
    every, drawn = np.concatenate(points)[:_MOST], np.concatenate(lines)[:_MOST]
    return Shapes(
        every[np.isfinite(every).all(axis=1)], drawn[np.isfinite(drawn).all(axis=(1, 2))]
    )


def _corners(marker: Any) -> NDArray[np.float64]:
    """The points of a marker, moved by its pose, shape (n, 3)."""
    own = np.array([(p.x, p.y, p.z) for p in marker.points[: 2 * _MOST]]).reshape(-1, 3)
    at, turn = marker.pose.position, marker.pose.orientation
    axis = np.array([turn.x, turn.y, turn.z])
    turned = 2.0 * np.cross(axis, own)
    moved: NDArray[np.float64] = own + turn.w * turned + np.cross(axis, turned)
    return moved + np.array([at.x, at.y, at.z])
