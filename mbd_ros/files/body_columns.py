"""Columns of free bodies: `base.position.x`, `base.angular_velocity.z`, `base.residual.force_x`.

A body stands in a table by its pose in the world, and by its velocity and the derivative of that
in axes of the body.
"""

import numpy as np

from mbd_ros.core.state import Array, BodyMotion
from mbd_ros.files.bag_paths import WORLD
from mbd_ros.files.table import Column

Words = tuple[tuple[str, str, str], ...]  # quantity, components, unit
POSE: Words = (("position", "xyz", "m"), ("orientation", "xyzw", ""))
TWIST: Words = (("linear_velocity", "xyz", "m/s"), ("angular_velocity", "xyz", "rad/s"))
ACCELERATION: Words = (
    ("linear_acceleration", "xyz", "m/s^2"),
    ("angular_acceleration", "xyz", "rad/s^2"),
)


def names_of(body: str, words: Words) -> list[str]:
    """Names of the columns of a body, in the order of its numbers."""
    return [f"{body}.{word}.{part}" for word, parts, _ in words for part in parts]


def motion_columns(motion: BodyMotion, frame: str) -> list[Column]:
    """Columns of all that is known of the motion of a body.

    Args:
        frame: Link in whose axes twist and acceleration stand.
    """
    columns = _columns(motion.name, POSE, motion.pose, WORLD)
    for words, values in ((TWIST, motion.twist), (ACCELERATION, motion.acceleration)):
        if values is not None:
            columns += _columns(motion.name, words, values, frame)
    return columns


def residual_columns(body: str, frame: str, wrench: Array) -> list[Column]:
    """Return the columns of the residual force and moment on a body, in its axes.

    Args:
        frame: Link in whose axes it stands.
        wrench: Force [N], then moment [N·m] about the origin of the link, shape (n, 6).
    """
    parts = [
        (f"{word}_{axis}", unit)
        for word, unit in (("force", "N"), ("torque", "N·m"))
        for axis in "xyz"
    ]
    return [
        Column(f"{body}.residual.{part}", column, unit, frame)
        for (part, unit), column in zip(parts, np.asarray(wrench).T, strict=True)
    ]


def _columns(body: str, words: Words, values: Array, frame: str) -> list[Column]:
    units = [unit for _, parts, unit in words for _ in parts]
    named = zip(names_of(body, words), values.T, units, strict=True)
    return [Column(name, column, unit, frame) for name, column, unit in named]
