"""Modes of contacts with friction that give way at events, and where they end.

The mode of a normal is 0 while a contact touches and 1 while it is open. Those of its tangents are
0 while it sticks, 1 while it is open, and else two odd numbers along the slip (`slip_directions`).
"""

import math
from collections.abc import Collection

import numpy as np

from mbd_ros.core.contact_modes.contact_forces import Split
from mbd_ros.core.contact_modes.mode_equations import EASED, ExactContacts
from mbd_ros.core.contact_modes.slip_directions import (
    begun,
    ends,
    has_turned,
    is_fine,
    named,
    slowest,
)
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.core.thresholds import TINY

OPEN: Mode = (1, 1, 1)
STICKS: Mode = (0, 0, 0)
_SHARED = 1.0e-9  # of the largest multiplier: what a share at the end of a law may leave
PASSED = 2.0e-12  # the same: by which rounding may pass a law, where it is met for long
CHANGE = 0.5  # of a slip, in a step: so steps get short with it, and keep their order
_TOGETHER = 2.0e4  # times the slip that counts as none: slips as slow as that end together


class ContactModes:
    """The modes of the contacts of a scene, by their last solve."""

    def __init__(self, contacts: ExactContacts) -> None:
        self._contacts = contacts

    def found(self, left: Array, slack: Array) -> list[Mode]:
        """Modes that the last solve found, one a contact.

        Args:
            left: The w of the rows that go from event to event.
            slack: What counts as none of it.
        """
        return [
            self._found(left[i : i + 3], slack[i : i + 3], slip, float(mu))
            for i, slip, mu in zip(
                self._contacts.normals, self._contacts.moving, self._contacts.mu, strict=True
            )
        ]

    def _found(self, left: Array, slack: Array, slip: Array | None, mu: float) -> Mode:
        if left[0] > slack[0]:
            return OPEN
        if slip is not None:
            return 0, *named(slip, left[1:], float(slack[1:].max()), self._contacts.slowest)
        if mu > 0.0 and math.hypot(*left[1:]) <= slack[1:].max():
            return STICKS
        return 0, *begun(left[1:])

    def margins(
        self, slips: Array, x: State, lam: Array, mode: Mode
    ) -> dict[tuple[int, int], float]:
        """What is left of a push, of a slip, and of friction to its largest, in a mode.

        Contacts that can share their force otherwise are not at the end of their mode yet.

        Args:
            slips: Velocities of the contacts along their planes, shape (c, 2).
            lam: Multipliers of the last solve, of the rows that go from event to event.
            mode: One entry each of these.
        """
        found: dict[tuple[int, int], float] = {}
        most = float(np.abs(lam).max())
        for c, i in enumerate(self._contacts.normals):
            if mode[i]:
                continue
            normal, name = float(lam[i]), mode[i + 1 : i + 3]
            found[i, 1] = self._left(normal, most)
            if not any(name):
                friction = math.hypot(*lam[i + 1 : i + 3])
                found[i + 1, 1] = self._left(float(self._contacts.mu[c]) * normal - friction, most)
            elif self._contacts.mu[c] > 0.0:
                found.update(zip(((i + 1, 0), (i + 2, 0)), ends(slips[c], name, x), strict=False))
        return found

    def _left(self, margin: float, most: float) -> float:
        is_shared = self._contacts.forces.split is Split.LAWFUL
        return most if is_shared and margin < _SHARED * most else margin + PASSED * most

    def leaving(self, lam: Array, left: Array, slack: Array, mode: Mode) -> dict[int, int]:
        """Modes in which contacts that shared their force go on, where no share is left.

        Args:
            lam: Multipliers by a friction that is a little smaller, of the rows as in `margins`.
            left: The w there.
            slack: What counts as none of it.
            mode: The one that ends.
        """
        ways: dict[int, int] = {}
        most = max(float(lam[i]) for i in self._contacts.normals)
        for i, after in zip(self._contacts.normals, self.found(left, slack), strict=True):
            if mode[i]:
                continue
            is_idle = not any(mode[i : i + 3]) and lam[i] <= EASED * most
            ways.update(zip(range(i, i + 3), OPEN if is_idle else after, strict=True))
        return ways

    def left(self, lam: Array, switch: int) -> dict[int, int]:
        """Modes after a contact opens or begins to slip.

        Args:
            lam: Multipliers of the last solve, as in `margins`.
            switch: Row of its normal where it opens, else of its first tangent.
        """
        i = next(i for i in self._contacts.normals if i <= switch < i + 3)
        after = OPEN if switch == i else (0, *begun(-lam[i + 1 : i + 3]))
        return dict(zip(range(i, i + 3), after, strict=True))

    def turned(self, slips: Array, x: State, mode: Mode) -> list[int]:
        """Contacts whose slips should have other names, at the start of a step.

        Args:
            slips: As for `margins`.
            mode: One entry each of the rows that go from event to event.
        """
        slow = slowest(x)
        return [
            c for c, i in self.slipping(mode) if has_turned(slips[c], mode[i + 1 : i + 3], slow)
        ]

    def slow(self, slips: Array, x: State, mode: Mode, switch: int) -> list[int]:
        """Contacts whose slips should have other names where one is slow or strays.

        Args:
            slips: As for `margins`.
            mode: One entry each of the rows that go from event to event.
            switch: A tangent of that slip; nothing is found where it has ended.
        """
        sizes, slow = np.linalg.norm(slips, axis=1), slowest(x)
        slipping = self.slipping(mode)
        if any(sizes[c] <= slow for c, i in slipping if i < switch < i + 3):
            return []
        return [
            c for c, i in slipping if i < switch < i + 3 or slow < sizes[c] <= _TOGETHER * slow
        ]

    def touching(self, mode: Mode) -> set[int]:
        """Rows of contacts that touch in a mode."""
        normals = (i for i in self._contacts.normals if not mode[i])
        return {at for i in normals for at in range(i, i + 3)}

    def slips_now(self, slips: Array, x: State) -> list[int]:
        """Normals of contacts whose points move along one another, closed or not.

        Args:
            slips: As for `margins`.
        """
        moving = np.linalg.norm(slips, axis=1) > slowest(x)
        return [
            i for i, moves in zip(self._contacts.normals, moving.tolist(), strict=True) if moves
        ]

    def turning(self, mode: Mode) -> bool:
        """Whether a slip may turn."""
        return any(not is_fine(mode[i + 1 : i + 3]) for _, i in self.slipping(mode))

    def longest(self, left: Array, mode: Mode) -> float:
        """Length of a step in which no slip that may turn changes by much [s].

        Args:
            left: The w of the last solve, of the rows that go from event to event.
            mode: One entry each of these.
        """
        length = math.inf
        for c, i in self.slipping(mode):
            slip = self._contacts.moving[c]
            if slip is not None and not is_fine(mode[i + 1 : i + 3]):
                rate = math.hypot(*left[i + 1 : i + 3])
                length = min(length, CHANGE * math.hypot(*slip) / max(rate, TINY))
        return length

    def renamed(self, left: Array, slack: Array, chosen: Collection[int]) -> dict[int, int]:
        """Modes of slips with the names that the last solve gives them.

        Args:
            left: The w, of the rows that go from event to event.
            slack: What counts as none of it.
        """
        found: dict[int, int] = {}
        for c, (i, slip) in enumerate(
            zip(self._contacts.normals, self._contacts.moving, strict=True)
        ):
            if c in chosen and slip is not None:
                rate, none = left[i + 1 : i + 3], float(slack[i + 1 : i + 3].max())
                name = named(slip, rate, none, self._contacts.slowest)
                found.update(zip((i + 1, i + 2), name, strict=True))
        return found

    def slipping(self, mode: Mode) -> list[tuple[int, int]]:
        """Contacts that slip, and where their normals stand."""
        every = enumerate(self._contacts.normals)
        return [(c, i) for c, i in every if not mode[i] and any(mode[i + 1 : i + 3])]
