"""Lines of arrows and of friction cones, and how long they are."""

import numpy as np

from mbd_ros.core.state import Array

_NO_LINES = np.zeros((0, 2, 3))


def arrow_ends(arrows: Array, scale: float, shortest: float = 1.0e-6) -> Array:
    """Begin and end of arrows of forces, without those that are too short to be seen.

    Args:
        arrows: Where forces act [m], and the forces [N], shape (n, 2, 3).
        scale: Length per force [m/N].
        shortest: Length from which an arrow is drawn [m].
    """
    lengths = np.linalg.norm(arrows[:, 1], axis=1) * scale
    seen = arrows[lengths > shortest]
    return np.stack((seen[:, 0], seen[:, 0] + scale * seen[:, 1]), axis=1)


def cone_lines(cones: Array, scale: float, around: int = 12) -> Array:
    """Lines from the tips of friction cones to their rims, and along these.

    Args:
        cones: Tip [m], normal force [N] and coefficient, shape (n, 7).
        scale: Height per force [m/N].
        around: Lines of a cone.

    Returns:
        Shape (2 n around, 2, 3).
    """
    pieces = [_NO_LINES]
    turn = np.arange(around) * (2.0 * np.pi / around)
    for cone in cones:
        axis = cone[3:6] * scale
        height = float(np.linalg.norm(axis))
        if height <= 0.0:
            continue
        across = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
        across /= np.linalg.norm(across)
        beside = np.cross(axis / height, across)
        out = np.outer(np.cos(turn), across) + np.outer(np.sin(turn), beside)
        rim = cone[:3] + axis + cone[6] * height * out
        tips = np.broadcast_to(cone[:3], rim.shape)
        pieces.append(np.stack((tips, rim), axis=1))
        pieces.append(np.stack((rim, np.roll(rim, -1, axis=0)), axis=1))
    return np.concatenate(pieces)


def length_per(largest: float, size: float) -> float:
    """Length per force [m/N] or moment [m/(N·m)] at which the largest is a third of a size [m]."""
    return size / (3.0 * largest) if largest > 0.0 else 0.001


def largest(arrows: Array) -> float:
    """Of forces or moments with where they act, shape (n, 2, 3); 0 without any."""
    return float(np.linalg.norm(arrows[:, 1], axis=1).max(initial=0.0))
