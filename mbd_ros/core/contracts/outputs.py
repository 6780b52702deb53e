"""What parts show: quantities with name and unit, asked for at samples only."""

from enum import Enum
from typing import NamedTuple

from mbd_ros.core.model.points import Point
from mbd_ros.core.state import Array

Value = float | Array


class Kind(Enum):
    """What a quantity is made of: the words for its numbers, empty where it is one.

    Wrenches and cones are drawn: what they are made of are numbers of the part already.
    """

    SCALAR = ("",)
    VECTOR = ("x", "y", "z")
    WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")  # force, then torque about `at`
    POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
    PLACED_WRENCH = ("x", "y", "z", *WRENCH)  # where it acts, less `Robot.origin`; torque there
    FRICTION_CONE = ("x", "y", "z", "fx", "fy", "fz", "mu")  # tip, the normal force, coefficient


class Output(NamedTuple):
    """A quantity that a part shows.

    Attributes:
        name: Unique in the part, without a dot; columns and messages put the name of the part
            before it.
        unit: Empty for pure numbers; of a wrench those of force and torque.
        kind: A number, or how many.
        frame: In whose axes it stands, empty for scalars and for axes of the world; of a wrench
            the link on which it acts, itself in axes of the world.
        at: Where a wrench of `Kind.WRENCH` acts.
    """

    name: str
    unit: str
    kind: Kind = Kind.SCALAR
    frame: str = ""
    at: Point | None = None

    @property
    def is_drawn(self) -> bool:
        """Whether it has no columns, but an arrow or a cone."""
        return self.kind in _DRAWN


_DRAWN = (Kind.WRENCH, Kind.PLACED_WRENCH, Kind.FRICTION_CONE)


class Now(NamedTuple):
    """What a part may show of an evaluation.

    Attributes:
        a: Accelerations of all joints [rad/s^2 or m/s^2], shape (nv,).
        lam: Multipliers of the own rows of the part, shape (m,).
        reactions: Wrench of the parent of every joint on its child [N, N·m], about the origin and
            in the axes of the joint on the child, in the order of `Robot.joints`, shape (n, 6);
            None where nobody asked for them.
    """

    a: Array
    lam: Array
    reactions: Array | None = None


class FrictionCone(NamedTuple):
    """The forces that a contact can exert, as far as its normal force.

    Attributes:
        point: Its tip, in the world less `Robot.origin` [m], shape (3,).
        normal: The normal force: axis and height, in world axes [N], shape (3,).
        mu: Coefficient of friction: its radius is mu times its height.
    """

    point: Array
    normal: Array
    mu: float


def exerted_on(link: Point, at: Point | None) -> Output:
    """A wrench on a link.

    Args:
        link: Any point of it.
        at: Where the wrench acts; None where the part says that with every value.
    """
    name = f"on_{link.frame.replace('.', '_')}"
    kind = Kind.PLACED_WRENCH if at is None else Kind.WRENCH
    return Output(name, "N, N·m", kind, link.frame, at)
