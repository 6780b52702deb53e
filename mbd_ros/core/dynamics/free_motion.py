"""What a system is composed of: coordinates, and accelerations while no row gives way."""

from collections.abc import Callable
from typing import Protocol

from mbd_ros.core.dynamics.chart import Chart
from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.dynamics.system import Accelerator
from mbd_ros.core.state import Array, State

Acceleration = Callable[[float, Array, Array, Array | None], Array]


class Coordinates(Protocol):
    """What is integrated, called y, and all joints.

    Attributes:
        chart: Of y.
    """

    chart: Chart

    def expand(self, y: State) -> State:
        """State of all joints."""

    def reduce(self, x: State) -> State:
        """State of y."""

    def lift(self, y: State, a: Array) -> Array:
        """Accelerations of all joints from y'', fresh, shape (nv of the robot,)."""

    def integrated(self, a: Array) -> Array:
        """Those of y among values of all joints."""

    def mass(self, q: Array) -> Array:
        """Mass matrix of y, shape (nv, nv), overwritten by the next call."""

    def applied(self, t: float, q: Array, v: Array, u: Array | None = None) -> Array:
        """Generalized force tau - h on y, shape (nv,)."""


class FreeMotion(Protocol):
    """Accelerations y'', rigid rows and couplings kept, rows that give way left out.

    Attributes:
        tier: Name of the way of solving.
        mechanism: What moves.
        coordinates: What is integrated.
    """

    tier: str
    mechanism: Mechanism

    @property
    def coordinates(self) -> Coordinates:
        """See the attributes of the class."""

    def accelerate(self, t: float, q: Array, v: Array, u: Array | None) -> Array:
        """The y'' at a state of y, shape (nv,); the next call may overwrite it."""

    def accelerator(self) -> Accelerator:
        """The function that writes what `accelerate` returns."""

    def joint_motion(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """q, v and a of all joints from y and y'' at the state of the last `accelerate`."""

    def respond(self, q: Array, forces: Array) -> Array:
        """Accelerations of all joints that forces on them add at the last `accelerate`.

        Args:
            q: Configuration of y there.
            forces: One generalized force a column, shape (nv of the robot, k).

        Returns:
            Shape (nv of the robot, k).
        """

    def solution(
        self, y: State, u: Array | None, a: Array, force: Array | None
    ) -> tuple[Array, Array]:
        """Accelerations of all joints, and multipliers of couplings and rigid rows, fresh.

        Args:
            y: State of the last `accelerate`.
            u: As there.
            a: y'' with all rows.
            force: What rows that give way exert, shape (nv of the robot,); None without any.
        """


def writing(accelerate: Acceleration) -> Accelerator:
    """A function of t, q, v, u that writes its result into a fifth argument, shape (nv,)."""

    def write(t: float, q: Array, v: Array, u: Array | None, out: Array) -> None:
        out[...] = accelerate(t, q, v, u)

    return write
