"""What happens at once between two phases: an impact, then joints under other names."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.dynamics.velocity_level import VelocityLevel
from mbd_ros.core.state import Array, State

Slots = NDArray[np.intp]


class Relabelling(NamedTuple):
    """Joints under other names: q+ = A q + b, v+ = A v.

    Attributes:
        q: Indices of all joints in a configuration, shape (n,).
        v: Their indices in a velocity, shape (n,).
        A: Shape (n, n).
        b: [rad or m], shape (n,).
    """

    q: Slots
    v: Slots
    A: Array
    b: Array

    def after(self, x: State) -> State:
        """The state under the new names."""
        q, v = x.q.copy(), x.v.copy()
        q[self.q] = self.A.dot(x.q[self.q]) + self.b
        v[self.v] = self.A.dot(x.v[self.v])
        return x._replace(q=q, v=v)


class Struck(NamedTuple):
    """What an impact leaves.

    Attributes:
        x: State of all joints after it.
        impulse: One a multiplier of the scene [N·s or N·m·s], shape (m,).
        share: Of the restitution that was given back.
    """

    x: State
    impulse: Array
    share: float = 1.0


class PhaseReset:
    """A jump of a state; a function of the state alone.

    The impact comes first, all of its rows in one solve, and what the old phase held lets go
    without an impulse. Joints are relabelled then.

    Args:
        size: Number of multipliers of the scene.
        striking: The system of the impact: rows that hold, bilateral, and contacts that bounce;
            None without an impact.
        slots: Where the multipliers of that system stand among those of the scene.
        touching: Slots in that system of contacts that bounce.
        relabelling: Joints under other names; None where they keep theirs.

    Attributes:
        striking: As given.
        relabelling: As given.
    """

    def __init__(
        self,
        size: int,
        striking: System | None,
        slots: Slots,
        touching: tuple[int, ...],
        relabelling: Relabelling | None,
    ) -> None:
        self._size, self._slots, self._touching = size, slots, touching
        self.striking, self.relabelling = striking, relabelling
        self._level = None if striking is None else VelocityLevel(striking)

    def after(self, x: State) -> Struck:
        """State of all joints after it.

        Args:
            x: State of all joints before it.

        Raises:
            SolveError: Nothing can keep a contact from closing further; names it.
        """
        impulse, share = np.zeros(self._size), 1.0
        if self._level is not None:
            found = self._level.impact(x, self._touching)
            impulse[self._slots], share = found.p, found.share
            x = x._replace(v=found.v)
            if not self._touching:  # what rounding leaves where masses are very unequal
                found = self._level.impact(x, ())
                impulse[self._slots] += found.p
                x = x._replace(v=found.v)
        if self.relabelling is not None:
            x = self.relabelling.after(x)
        return Struck(x, impulse, share)
