"""Modes of event-driven contacts with friction, and where they end.

The mode of a normal is 0 while a contact touches and 1 while it is open. Those of its tangents are
0 while it sticks, 1 while it is open, and else two odd numbers along the slip (`slip_directions`).
"""

import math
from collections.abc import Collection

import numpy as np

from mbd_ros.core.contact_modes.mode_equations import EventContacts
from mbd_ros.core.contact_modes.row_solution import ContactSolution, RowSolution, Split
from mbd_ros.core.contact_modes.slip_directions import (
    has_turned,
    initial_name,
    is_fine,
    slip_margins,
    slip_name,
    slowest,
)
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.core.thresholds import TINY

OPEN: Mode = (1, 1, 1)
STICKS: Mode = (0, 0, 0)
_EASED = 1.0e-6  # of friction: so little less shows how contacts begin to move
_SHARED = 1.0e-9  # of the largest multiplier: what a share at the end of a law may leave
PASSED = 2.0e-12  # the same: by which rounding may pass a law, where it is met for long
CHANGE = 0.5  # of a slip, in a step: so steps get short with it, and keep their order
_TOGETHER = 2.0e4  # times the slip that counts as none: slips as slow as that end together


class ContactModes:
    """Decides the modes of the contacts of a scene from solutions of their forces.

    Attributes:
        eased_friction: Share of the coefficients of friction that shows how contacts begin to
            move which share a force.
    """

    eased_friction = 1.0 - _EASED

    def __init__(self, contacts: EventContacts) -> None:
        self._contacts = contacts

    def decided(self, solution: RowSolution) -> list[Mode]:
        """Return the modes that a solution with undecided rows says, one a contact."""
        contacts = of_contacts(solution)
        modes = []
        for i, slip, mu in zip(
            self._contacts.normals, contacts.slips, self._contacts.mu, strict=True
        ):
            w, slack = solution.w[i : i + 3], solution.slack[i : i + 3]
            modes.append(_mode(w, slack, slip, contacts.slowest, float(mu)))
        return modes

    def margins(
        self, slips: Array, x: State, solution: RowSolution, mode: Mode
    ) -> dict[tuple[int, int], float]:
        """Return what is left of a push, of a slip, and of friction to its largest, in a mode.

        Contacts that can share their force otherwise are not at the end of their mode yet.

        Args:
            slips: Velocities of the contacts along their planes, shape (c, 2).
            x: State of all joints.
            solution: The multipliers in the mode.
            mode: One entry each of the event-driven rows.
        """
        margins: dict[tuple[int, int], float] = {}
        lam, split = solution.lam, of_contacts(solution).split
        most = float(np.abs(lam).max())
        for c, i in enumerate(self._contacts.normals):
            if mode[i]:
                continue
            normal, name = float(lam[i]), mode[i + 1 : i + 3]
            margins[i, 1] = _margin(normal, most, split)
            if not any(name):
                friction = math.hypot(*lam[i + 1 : i + 3])
                room = float(self._contacts.mu[c]) * normal - friction
                margins[i + 1, 1] = _margin(room, most, split)
            elif self._contacts.mu[c] > 0.0:
                ends = slip_margins(slips[c], name, x)
                margins.update(zip(((i + 1, 0), (i + 2, 0)), ends, strict=False))
        return margins

    def after_sharing(self, eased: RowSolution, mode: Mode) -> dict[int, int]:
        """Return the modes after no share of a force keeps the laws of the contacts that share it.

        Args:
            eased: The solution with a friction that is a little smaller, touching rows undecided.
            mode: The one that ends.
        """
        modes: dict[int, int] = {}
        lam = eased.lam
        most = max(float(lam[i]) for i in self._contacts.normals)
        for i, after in zip(self._contacts.normals, self.decided(eased), strict=True):
            if mode[i]:
                continue
            is_idle = not any(mode[i : i + 3]) and lam[i] <= _EASED * most
            modes.update(zip(range(i, i + 3), OPEN if is_idle else after, strict=True))
        return modes

    def after(self, lam: Array, switch: int) -> dict[int, int]:
        """Return the modes after a contact opens or begins to slip.

        Args:
            lam: Multipliers there, of the event-driven rows, shape (n,).
            switch: Row of its normal where it opens, else of its first tangent.
        """
        i = next(i for i in self._contacts.normals if i <= switch < i + 3)
        after = OPEN if switch == i else (0, *initial_name(-lam[i + 1 : i + 3]))
        return dict(zip(range(i, i + 3), after, strict=True))

    def turned(self, slips: Array, x: State, mode: Mode) -> list[int]:
        """Return contacts whose slips should have other names, at the start of a step.

        Args:
            slips: Velocities of the contacts along their planes, shape (c, 2).
            x: State of all joints.
            mode: One entry each of the event-driven rows.
        """
        slow = slowest(x)
        return [
            c for c, i in self.slipping(mode) if has_turned(slips[c], mode[i + 1 : i + 3], slow)
        ]

    def slow(self, slips: Array, x: State, mode: Mode, switch: int) -> list[int]:
        """Return contacts whose slips should have other names where one is slow or strays.

        Args:
            slips: Velocities of the contacts along their planes, shape (c, 2).
            x: State of all joints.
            mode: One entry each of the event-driven rows.
            switch: A tangent of that slip; the list is empty where it has ended.
        """
        sizes, slow = np.linalg.norm(slips, axis=1), slowest(x)
        slipping = self.slipping(mode)
        if any(sizes[c] <= slow for c, i in slipping if i < switch < i + 3):
            return []
        return [
            c for c, i in slipping if i < switch < i + 3 or slow < sizes[c] <= _TOGETHER * slow
        ]

    def touching(self, mode: Mode) -> set[int]:
        """Return the rows of contacts that touch in a mode."""
        normals = (i for i in self._contacts.normals if not mode[i])
        return {at for i in normals for at in range(i, i + 3)}

    def moving_normals(self, slips: Array, x: State) -> list[int]:
        """Return normals of contacts whose points move along one another, closed or not.

        Args:
            slips: Velocities of the contacts along their planes, shape (c, 2).
            x: State of all joints.
        """
        is_moving = np.linalg.norm(slips, axis=1) > slowest(x)
        return [
            i for i, moves in zip(self._contacts.normals, is_moving.tolist(), strict=True) if moves
        ]

    def may_turn(self, mode: Mode) -> bool:
        """Whether a slip may turn."""
        return any(not is_fine(mode[i + 1 : i + 3]) for _, i in self.slipping(mode))

    def longest_step(self, solution: RowSolution, mode: Mode) -> float:
        """Return the length of a step in which no slip that may turn changes by much [s].

        Args:
            solution: That of the rows in the mode.
            mode: One entry each of the event-driven rows.
        """
        length, slips = math.inf, of_contacts(solution).slips
        for c, i in self.slipping(mode):
            slip = slips[c]
            if slip is not None and not is_fine(mode[i + 1 : i + 3]):
                rate = math.hypot(*solution.w[i + 1 : i + 3])
                length = min(length, CHANGE * math.hypot(*slip) / max(rate, TINY))
        return length

    def renamed(self, solution: RowSolution, chosen: Collection[int]) -> dict[int, int]:
        """Return the modes of some slips with the names that a solution gives them.

        Args:
            solution: That of the rows in their mode, with its slack.
            chosen: Numbers of the contacts.
        """
        modes: dict[int, int] = {}
        contacts = of_contacts(solution)
        for c, (i, slip) in enumerate(zip(self._contacts.normals, contacts.slips, strict=True)):
            if c in chosen and slip is not None:
                rate = solution.w[i + 1 : i + 3]
                slack = float(solution.slack[i + 1 : i + 3].max())
                name = slip_name(slip, rate, slack, contacts.slowest)
                modes.update(zip((i + 1, i + 2), name, strict=True))
        return modes

    def slipping(self, mode: Mode) -> list[tuple[int, int]]:
        """Return the numbers of contacts that slip, and those of their normals."""
        numbered = enumerate(self._contacts.normals)
        return [(c, i) for c, i in numbered if not mode[i] and any(mode[i + 1 : i + 3])]


def of_contacts(solution: RowSolution) -> ContactSolution:
    """Return the part of a solution that is about contacts."""
    assert solution.contacts is not None
    return solution.contacts


def _mode(w: Array, slack: Array, slip: Array | None, slowest_slip: float, mu: float) -> Mode:
    if w[0] > slack[0]:
        return OPEN
    if slip is not None:
        return 0, *slip_name(slip, w[1:], float(slack[1:].max()), slowest_slip)
    if mu > 0.0 and math.hypot(*w[1:]) <= slack[1:].max():
        return STICKS
    return 0, *initial_name(w[1:])


def _margin(room: float, most: float, split: Split) -> float:
    if split is Split.LAWFUL and room < _SHARED * most:
        return most
    return room + PASSED * most
