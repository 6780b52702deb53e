"""Solutions of event-driven rows at one state: multipliers, accelerations, slips of contacts."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

from mbd_ros.core.state import Array


class RowSolution(NamedTuple):
    """Accelerations and multipliers of event-driven rows in a mode.

    Attributes:
        a: Accelerations of what is integrated, shape (nv,).
        all_lam: Multipliers of all rows of the solver, shape (m,).
        force: Force of these on all joints, shape (nv of the robot,).
        lam: Multipliers of the event-driven rows, shape (n,).
        w: Their w = g'' + kd g' + kp g, shape (n,).
        lower: Smallest multipliers at the state, shape (n,).
        upper: Largest multipliers at the state, shape (n,).
        slack: Size of w that counts as none, shape (n,); empty where nobody asked for it.
        contacts: Slips and sharing of contacts; None without contacts.
    """

    a: Array
    all_lam: Array
    force: Array
    lam: Array
    w: Array
    lower: Array
    upper: Array
    slack: Array
    contacts: ContactSolution | None


class Split(Enum):
    """Whether equations alone say how contacts share their forces."""

    ONE = "one"
    LEAST = "least"  # they do not, and the least norm keeps the laws
    LAWFUL = "lawful"  # another share of them does
    NONE = "none"  # none does: the mode is over


class ContactSolution(NamedTuple):
    """How contacts slip and share their forces at one state.

    Attributes:
        split: How they share their forces.
        slips: Slip velocities of the contacts, shape (2,) each; None where one does not slip.
        slowest: Slip velocity that counts as none.
    """

    split: Split
    slips: list[Array | None]
    slowest: float

    @property
    def is_shared(self) -> bool:
        """Whether equations alone did not split the forces."""
        return self.split is not Split.ONE
