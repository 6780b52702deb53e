"""What happens at once between two phases: an impact, then joints under other names."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.events.crossings import Crossing
from mbd_ros.core.impacts.impact_map import VelocityLevel
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import ASSEMBLED
from mbd_ros.errors import SolveError

Slots = NDArray[np.intp]
_SLACK = 1.0e-9  # of the largest impulse


class Relabelling(NamedTuple):
    """Joints and internal states under other names: q+ = A q + b, v+ = A v, z+ = B z.

    Attributes:
        q: Indices of some joints in a configuration, shape (n,).
        v: Their indices in a velocity, shape (n,).
        A: Shape (n, n).
        b: [rad or m], shape (n,).
        z: Indices of some internal states, shape (m,).
        B: Shape (m, m).
    """

    q: Slots
    v: Slots
    A: Array
    b: Array
    z: Slots
    B: Array

    def after(self, x: State) -> State:
        """The state under the new names."""
        q, v, z = x.q.copy(), x.v.copy(), x.z.copy()
        q[self.q] = self.A.dot(x.q[self.q]) + self.b
        v[self.v] = self.A.dot(x.v[self.v])
        z[self.z] = self.B.dot(x.z[self.z])
        return x._replace(q=q, v=v, z=z)


class Demand(NamedTuple):
    """What impulses of a contact that is held have to keep.

    Attributes:
        contact: The contact.
        crossing: A number that may not be negative.
        failure: What it means that it is.
    """

    contact: str
    crossing: Crossing
    failure: str


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
        demands: Of the impulses of that system.

    Attributes:
        striking: As given.
        relabelling: As given.
        demands: As given.
    """

    def __init__(
        self,
        size: int,
        striking: System | None,
        slots: Slots,
        touching: tuple[int, ...],
        relabelling: Relabelling | None,
        demands: Sequence[Demand] = (),
    ) -> None:
        self._size, self._slots, self._touching = size, slots, touching
        self.demands = tuple(demands)
        self.striking, self.relabelling = striking, relabelling
        self._level = None if striking is None else VelocityLevel(striking)

    def after(self, x: State) -> Struck:
        """State of all joints after it.

        Args:
            x: State of all joints before it.

        Raises:
            SolveError: Nothing can keep a contact from closing further, or one that is held would
                pull or slip; names it.
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
            self._refuse_unheld(x, impulse[self._slots])
        if self.relabelling is not None:
            x = self.relabelling.after(x)
        return Struck(x, impulse, share)

    def _refuse_unheld(self, x: State, p: Array) -> None:
        """Refuse impulses that a contact which is held cannot exert."""
        assert self.striking is not None
        slack = _SLACK * float(np.abs(p).max(initial=0.0))
        for _, crossing, failure in self.demands:
            self.striking.k.refresh(x.q, x.v, crossing.reads)
            if crossing.value(self.striking.k, x, p) < -slack:
                raise SolveError(f"t = {x.t:.9g} s, impact: {failure}")


def refuse_open(system: System, y: State, where: str) -> None:
    """Refuse a state after a reset that is off the rows of the phase that begins.

    Args:
        system: That of the phase.
        y: State of what it integrates.
        where: Which guard leads there, for the message.

    Raises:
        SolveError: Names the row that is most open.
    """
    held = system.held
    if not held.rows:
        return
    g = held.residual(y.t, y.q)
    rate = held.jacobian(y.t, y.q).dot(y.v) + held.rate(y.t, y.q)
    fastest = 1.0 + float(np.abs(y.v).max(initial=0.0))
    for size, unit, accepted in ((g, "m or rad", 1.0), (rate, "m/s or rad/s", fastest)):
        worst = int(np.argmax(np.abs(size)))
        if not abs(size[worst]) <= ASSEMBLED * accepted:
            raise SolveError(
                f"t = {y.t:.9g} s: {where}, whose row {held.rows[worst].name} is "
                f"{abs(size[worst]):.3g} {unit} open: its reset has to close it"
            )
