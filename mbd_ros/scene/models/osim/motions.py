"""What a joint of a model is: frames on two bodies, and what turns and slides between them."""

from typing import NamedTuple

from mbd_ros.scene.models.motions import Step
from mbd_ros.scene.models.osim.frames import Attached
from mbd_ros.scene.models.osim.item import Item


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
