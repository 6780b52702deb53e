"""A cylinder over a plane: each rim touches with its lowest point and three more around it."""

from typing import Any

import numpy as np

from mbd_ros.core.geometry.feature_gaps import Meeting, Touch
from mbd_ros.core.geometry.frames import crossed
from mbd_ros.core.geometry.shapes import Cylinder
from mbd_ros.core.geometry.spheres import PLANE_AXES
from mbd_ros.core.model.points import Pair

_UPRIGHT = 1.0e-9  # sine of a tilt below which no point of a rim is the lowest
_AROUND = ("low", "left", "high", "right")


class CylinderOnPlane(Meeting):
    """A cylinder over the half space z <= 0.

    `low_0` and `low_1` are the lowest points of both rims, at the lower and at the upper end
    along its axis; `left`, `high` and `right` stand at 90, 180 and 270 degrees from them.
    None of them is fixed to the body: they roll over the rims, so that a cylinder on its side
    touches with its two lowest points alone. There `left` and `right` are at the centres of its
    ends, since points of the rim would be on their way into the plane. Where it stands upright
    `low` is at -x of the body.

    Args:
        pair: The half space, as the observer, and the centre of the cylinder.
        cylinder: Its sizes.
    """

    why_not = "the lowest point of the rim of a cylinder jumps where it stands upright"

    def __init__(self, pair: Pair, cylinder: Cylinder) -> None:
        super().__init__(pair, tuple(f"{way}_{end}" for end in (0, 1) for way in _AROUND))
        self._radius, self._half = cylinder.radius, cylinder.length / 2.0
        self.reach = float(np.hypot(self._radius, self._half))
        self._axes = np.broadcast_to(PLANE_AXES, (len(self.features), 3, 3))

    def touch(self, pose: Any) -> Touch:
        """Points of the rims; frames are that of the plane."""
        R = pose.rotation
        along = R[:, 2]
        down = along * along[2]
        down[2] -= 1.0  # what of -z is across the axis
        sine = np.sqrt(down.dot(down))
        low = -R[:, 0] if sine.real < _UPRIGHT else down / sine
        left = crossed(along, low) * along[2] ** 2
        rim = self._radius * np.stack((low, left, -low, -left))
        end = self._half * along
        lever = np.concatenate((rim - end, rim + end))
        return Touch(lever[:, 2] + pose.translation[2], lever, self._axes)
