"""Placements as descriptions and scenes write them."""

from typing import Any

import numpy as np

from mbd_ros.core.state import Array


def xyz_rpy(at: Any) -> dict[str, list[float]]:
    """A placement as a scene writes it, without what is 0."""
    pose = {"xyz": at.translation.tolist(), "rpy": roll_pitch_yaw(at.rotation)}
    return {key: value for key, value in pose.items() if any(value)}


def roll_pitch_yaw(rotation: Array) -> list[float]:
    """Angles of URDF whose rotation is the given one to rounding, also where they are not unique.

    Roll is taken after yaw is undone, so that both fit each other where pitch is 90 degrees.
    """
    r = rotation
    yaw = float(np.arctan2(r[1, 0], r[0, 0]))
    s, c = np.sin(yaw), np.cos(yaw)
    pitch = float(np.arctan2(-r[2, 0], c * r[0, 0] + s * r[1, 0]))
    roll = float(np.arctan2(s * r[0, 2] - c * r[1, 2], c * r[1, 1] - s * r[0, 1]))
    return [roll + 0.0, pitch + 0.0, yaw + 0.0]
