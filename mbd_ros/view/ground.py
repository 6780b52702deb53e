"""What a robot stands in: the direction that is up, a grid, and lights that cast no shadows."""

from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array

_CELLS, _REACH = 4, 3  # of the grid: in the size of a robot, and to each side in its sizes
_LINE, _MAIN_LINE = (226, 229, 233), (196, 202, 209)
_SUNK = 0.02  # of the size: what is deeper than that has its grid below it
_FROM = np.array([0.55, -0.95, 0.3])  # where the camera stands, in diagonals, z up
_SUN, _SHADE = np.array([1.0, -2.0, 3.0]), (150, 150, 165)
_FARTHER, _LOWER = 1.5, 0.55  # of telephones: distances, and diagonals that they look below
SMALLEST = 0.05  # m, of what is looked at


def upright(robot: Robot) -> Array:
    """Axes whose last one, along an axis of the world, is the most opposite to gravity, (3, 3)."""
    gravity = np.array(robot.model.gravity.linear)
    up = np.zeros(3)
    at = int(np.argmax(np.abs(gravity))) if gravity.any() else 2
    up[at] = -1.0 if gravity[at] > 0.0 else 1.0
    turn: Array = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), up).matrix()
    return turn


def show_ground(server: Any, axes: Array, low: Array, high: Array) -> float:
    """Make lights and a grid, and say where cameras begin.

    Software draws shadows and mirrored surroundings at a frame a second, and these at thirty.

    Args:
        server: The `viser.ViserServer`.
        axes: As `upright` gives them.
        low: Least corner of the box around all that is looked at [m], shape (3,).
        high: Greatest corner.

    Returns:
        The size of what is looked at, its largest side [m], at least 0.05.
    """
    scene, size = server.scene, max(float((high - low).max()), SMALLEST)
    scene.set_up_direction(axes[:, 2])
    scene.configure_default_lights(enabled=False)
    scene.configure_environment_map(None)
    scene.add_light_hemisphere("/sky", ground_color=_SHADE, intensity=2.2, position=axes[:, 2])
    scene.add_light_directional("/sun", intensity=1.6, position=axes @ _SUN)
    lines, colours = _grid(axes, size, low, high)
    scene.add_line_segments("/ground", lines, colours, thickness=1.0, thickness_units="screen")
    centre = (low + high) / 2.0
    away = max(float(np.linalg.norm(high - low)), size)
    there = axes @ _FROM * away
    server.initial_camera.position = centre + there
    server.initial_camera.look_at = centre
    below = centre - axes[:, 2] * (_LOWER * away)
    _turn_telephones(server, below + there * _FARTHER, below)
    return size


def _turn_telephones(server: Any, position: Array, look_at: Array) -> None:
    """Show it in the upper half of windows that are taller than wide: the panel covers the lower.

    Args:
        server: The `viser.ViserServer`.
        position: Where their cameras stand [m].
        look_at: What they look at [m].
    """

    def turn(client: Any) -> None:
        if client.camera.image_width < client.camera.image_height:
            client.camera.position = position
            client.camera.look_at = look_at

    server.on_client_connect(turn)


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
