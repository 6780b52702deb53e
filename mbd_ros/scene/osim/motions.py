"""What a joint of a model is: frames on two bodies, and what turns and slides between them."""

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array
from mbd_ros.scene.osim.frames import Attached
from mbd_ros.scene.osim.functions import Function
from mbd_ros.scene.osim.item import Item

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


class Coordinate(NamedTuple):
    """A coordinate of a joint.

    Attributes:
        item: The element.
        name: Its name.
        default: Position at the start [rad or m].
        speed: Velocity at the start [rad/s or m/s].
        limits: Smallest and largest position [rad or m] where it is clamped, else None.
        locked: Whether it never leaves `default`.
    """

    item: Item
    name: str
    default: float
    speed: float
    limits: tuple[float, float] | None
    locked: bool


class Joint(NamedTuple):
    """A joint from a parent to a child.

    Attributes:
        item: The element.
        name: Its name.
        parent: Its frame on the parent.
        child: Its frame on the child.
        coordinates: Its coordinates.
        steps: What is between both frames, from the parent to the child.
        missing: What of it is not expressed, empty for most.
    """

    item: Item
    name: str
    parent: Attached
    child: Attached
    coordinates: tuple[Coordinate, ...]
    steps: tuple[Step, ...]
    missing: str = ""

    @property
    def whole(self) -> list[Step]:
        """From the parent to the child."""
        return [self.parent.at, *self.steps, self.child.at.inverse()]
