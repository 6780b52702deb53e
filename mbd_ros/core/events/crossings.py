"""Numbers whose zeros end a phase."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.model.kinematics import Kinematics, Reads
from mbd_ros.core.state import Array, State


class Crossing(Protocol):
    """A number that has a zero.

    Attributes:
        reads: What it reads of k.
    """

    @property
    def reads(self) -> Reads:
        """See the attributes of the class."""

    def value(self, k: Kinematics, x: State, lam: Array) -> float:
        """The number at a state of all joints.

        Args:
            k: Kinematics there, refreshed as far as `reads` says.
            x: The state.
            lam: Multipliers of all rows of the phase, shape (m,).
        """


class Combination(NamedTuple):
    """A sum of joint positions times factors, less a level [rad or m].

    Attributes:
        q: Indices of the joints in a configuration, shape (n,).
        factors: One a joint, shape (n,).
        at: The level.
    """

    q: NDArray[np.intp]
    factors: Array
    at: float
    reads: Reads = Reads.NOTHING

    def value(self, k: Kinematics, x: State, lam: Array) -> float:
        """As `Crossing.value`."""
        return float(self.factors.dot(x.q[self.q])) - self.at


class Gap(NamedTuple):
    """The least distance of the bodies of a contact [m].

    Attributes:
        contact: The contact.
    """

    contact: Any
    reads: Reads = Reads.POSITION

    def value(self, k: Kinematics, x: State, lam: Array) -> float:
        """As `Crossing.value`."""
        return float(self.contact.pair.gaps(k).min())


class Force(NamedTuple):
    """A sum of multipliers, less a level [N or N·m].

    Attributes:
        slots: Of the multipliers among those of the phase.
        at: The level.
    """

    slots: Sequence[int]
    at: float = 0.0
    reads: Reads = Reads.NOTHING

    def value(self, k: Kinematics, x: State, lam: Array) -> float:
        """As `Crossing.value`."""
        return sum(float(lam[i]) for i in self.slots) - self.at


class ConeRoom(NamedTuple):
    """What friction of a contact that is held has left before it slips [N].

        mu sum n - |sum t|

    Attributes:
        mu: Coefficient of friction, the smallest of its features.
        normals: Slots of the normal forces among the multipliers of the phase.
        tangents: Slots along either tangent.
    """

    mu: float
    normals: Sequence[int]
    tangents: tuple[Sequence[int], Sequence[int]]
    reads: Reads = Reads.NOTHING

    def value(self, k: Kinematics, x: State, lam: Array) -> float:
        """As `Crossing.value`."""
        n = sum(float(lam[i]) for i in self.normals)
        t = (sum(float(lam[i]) for i in each) for each in self.tangents)
        return self.mu * n - math.hypot(*t)


class Condition(NamedTuple):
    """Where a guard acts: a sum of joint positions times factors is above or below a level.

    Attributes:
        of: The sum, less the level.
        above: Whether it has to be positive; negative otherwise.
    """

    of: Combination
    above: bool

    def holds(self, x: State) -> bool:
        """Whether a guard acts at a state of all joints."""
        value = float(self.of.factors.dot(x.q[self.of.q])) - self.of.at
        return value > 0.0 if self.above else value < 0.0
