"""Turns and slides between two links."""

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array
from mbd_ros.scene.models.functions import Function

X, Y, Z = np.eye(3)


class Motion(NamedTuple):
    """A turn about an axis, or a slide along it.

    Attributes:
        name: What it is called where no coordinate gives it a name.
        axis: Of length 1, shape (3,).
        turns: Whether it is a turn.
        function: Angle [rad] or way [m] of the coordinate.
        coordinate: Name of the coordinate, empty where the function is constant.
    """

    name: str
    axis: Array
    turns: bool
    function: Function
    coordinate: str

    def at(self, value: float) -> Any:
        """`pinocchio.SE3` where the function has a value."""
        if self.turns:
            return pin.SE3(pin.AngleAxis(value, self.axis).toRotationMatrix(), np.zeros(3))
        return pin.SE3(np.eye(3), value * self.axis)

    def inverse(self) -> "Motion":
        """The motion back."""
        return self._replace(axis=-self.axis)


Step = Motion | pin.SE3
