"""What parts show: quantities with name and unit, asked for at samples only."""

from enum import Enum
from typing import NamedTuple

from mbd_ros.core.model.points import Point
from mbd_ros.core.state import Array

Value = float | Array


class Kind(Enum):
    """What a quantity is made of: the words for its numbers, empty where it is one."""

    SCALAR = ("",)
    VECTOR = ("x", "y", "z")
    WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")  # force, then torque about `at`
    POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")


class Output(NamedTuple):
    """A quantity that a part shows.

    Attributes:
        name: Unique in the part, without a dot; columns and messages put the name of the part
            before it.
        unit: Empty for pure numbers; of a wrench those of force and torque.
        kind: A number, or how many.
        frame: In whose axes it stands, empty for scalars and for axes of the world; of a wrench
            the link on which it acts, itself in axes of the world.
        at: Where a wrench acts.
    """

    name: str
    unit: str
    kind: Kind = Kind.SCALAR
    frame: str = ""
    at: Point | None = None


class Now(NamedTuple):
    """What a part may show of an evaluation.

    Attributes:
        a: Accelerations of all joints [rad/s^2 or m/s^2], shape (nv,).
        lam: Multipliers of the own rows of the part, shape (m,).
    """

    a: Array
    lam: Array


def exerted_on(link: Point, at: Point) -> Output:
    """A wrench on a link.

    Args:
        link: Any point of it.
        at: Where the wrench acts.
    """
    name = f"on_{link.frame.replace('.', '_')}"
    return Output(name, "N, N·m", Kind.WRENCH, link.frame, at)
