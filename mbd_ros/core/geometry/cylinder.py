"""A cylinder over a plane: it rolls on two lowest points and stands on points of its rim."""

from typing import Any

import numpy as np

from mbd_ros.core.geometry.balls import PLANE_AXES
from mbd_ros.core.geometry.meeting import Meeting, Touch
from mbd_ros.core.geometry.shapes import Cylinder
from mbd_ros.core.model.points import Pair

_UPRIGHT = 1.0e-9  # sine of a tilt below which no point of a rim is the lowest
_AROUND = 4  # points of a rim that are fixed to it


class CylinderOnPlane(Meeting):
    """A cylinder over the half space z <= 0.

    Points 0 to 3 of the rim stand at x, y, -x and -y of the lower end along its axis, 4 to 7 at
    the upper one; `low_0` and `low_1` are the lowest points of both rims, wherever they are.

    Args:
        pair: The half space, as the observer, and the centre of the cylinder.
        cylinder: Its sizes.
    """

    why_not = "the lowest point of the rim of a cylinder jumps where it stands upright"

    def __init__(self, pair: Pair, cylinder: Cylinder) -> None:
        names = [f"rim_{i}" for i in range(2 * _AROUND)]
        super().__init__(pair, (*names, "low_0", "low_1"))
        self._radius, self._half = cylinder.radius, cylinder.length / 2.0
        self.reach = float(np.hypot(self._radius, self._half))
        rim = np.array(((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))) * cylinder.radius
        ends = np.repeat((-self._half, self._half), _AROUND)
        self._rims = np.column_stack((np.tile(rim, (2, 1)), ends))
        self._axes = np.broadcast_to(PLANE_AXES, (len(self.features), 3, 3))

    def touch(self, pose: Any) -> Touch:
        """Points of the rims, and the lowest of each; frames are that of the plane."""
        R = pose.rotation
        along = R[:, 2]
        down = along * along[2]
        down[2] -= 1.0  # what of -z is across the axis
        sine = np.sqrt(down.dot(down))
        low = -R[:, 0] if sine.real < _UPRIGHT else down / sine
        lowest = self._radius * low + np.multiply.outer((-self._half, self._half), along)
        lever = np.concatenate((self._rims.dot(R.T), lowest))
        return Touch(lever[:, 2] + pose.translation[2], lever, self._axes)
