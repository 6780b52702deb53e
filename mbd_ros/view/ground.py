"""What a robot stands in: the direction that is up, a grid, and lights that cast no shadows."""

from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array

_CELLS, _REACH = 4, 3  # of the grid: in the size of a robot, and to each side in its sizes
_LINE, _MAIN_LINE = (226, 229, 233), (196, 202, 209)
_SUNK = 0.02  # of the size: what is deeper than that has its grid below it
_FROM = np.array([0.48, -0.82, 0.25])  # where the camera stands, in diagonals, z up
_SUN, _SHADE = np.array([1.0, -2.0, 3.0]), (150, 150, 165)
_FARTHER, _LOWER = 1.7, 0.55  # of telephones: distances, and diagonals that they look below
SMALLEST = 0.05  # m, of what is looked at


def upright(robot: Robot) -> Array:
    """Axes whose last one, along an axis of the world, is the most opposite to gravity, (3, 3)."""
    gravity = np.array(robot.model.gravity.linear)
    up = np.zeros(3)
    at = int(np.argmax(np.abs(gravity))) if gravity.any() else 2
    up[at] = -1.0 if gravity[at] > 0.0 else 1.0
    turn: Array = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), up).matrix()
    return turn


class Ground:
    """Lights, a grid, and where cameras begin.

    Software draws shadows and mirrored surroundings at a frame a second, and these at thirty.

    Args:
        server: The `viser.ViserServer`.
        axes: As `upright` gives them.
    """

    def __init__(self, server: Any, axes: Array) -> None:
        self._server, self._axes = server, axes
        scene = server.scene
        scene.set_up_direction(axes[:, 2])
        scene.configure_default_lights(enabled=False)
        scene.configure_environment_map(None)
        sky = {"ground_color": _SHADE, "intensity": 2.2, "position": axes[:, 2]}
        scene.add_light_hemisphere("/sky", **sky)
        scene.add_light_directional("/sun", intensity=1.6, position=axes @ _SUN)
        self._telephone: tuple[Array, Array] | None = None
        server.on_client_connect(self._turn)

    def surround(self, low: Array, high: Array) -> None:
        """Lay the grid, and tell cameras where to begin.

        Args:
            low: Least corner of the box around all that is looked at [m], shape (3,).
            high: Greatest corner.
        """
        lines, colours = _grid(self._axes, size_of(low, high), low, high)
        thickness = {"thickness": 1.0, "thickness_units": "screen"}
        self._server.scene.add_line_segments("/ground", lines, colours, **thickness)
        centre, away = (low + high) / 2.0, max(float(np.linalg.norm(high - low)), SMALLEST)
        there = self._axes @ _FROM * away
        self._server.initial_camera.position = centre + there
        self._server.initial_camera.look_at = centre
        below = centre - self._axes[:, 2] * (_LOWER * away)
        self._telephone = below + there * _FARTHER, below

    def _turn(self, client: Any) -> None:
        """Use the upper half of a window that is taller than wide: the panel covers the lower."""
        if self._telephone and client.camera.image_width < client.camera.image_height:
            client.camera.position, client.camera.look_at = self._telephone


def size_of(low: Array, high: Array) -> float:
    """Largest side of a box [m], at least 0.05."""
    return max(float((high - low).max()), SMALLEST)


def _grid(axes: Array, size: float, low: Array, high: Array) -> tuple[Array, Array]:
    """Lines, shape (n, 2, 3), and their colours."""
    corners = np.array([low, high]) @ axes
    sunk = float(corners[:, 2].min())
    height = sunk if sunk < -_SUNK * size else 0.0
    middle = np.round(corners.mean(axis=0)[:2] / size) * size
    offset = np.array([*middle, height])
    along = np.arange(-_REACH * _CELLS, _REACH * _CELLS + 1)
    lines, colours = [], []
    for i in along:
        at, end = size * i / _CELLS, size * _REACH
        for across in (0, 1):
            ends = np.array([[at, -end, 0.0], [at, end, 0.0]])
            ends = ends if across == 0 else ends[:, [1, 0, 2]]
            lines.append((ends + offset) @ axes.T)
            colours.append(_LINE if i % _CELLS else _MAIN_LINE)
    both = np.repeat(np.array(colours, np.uint8)[:, None], 2, axis=1)
    return np.array(lines), both
