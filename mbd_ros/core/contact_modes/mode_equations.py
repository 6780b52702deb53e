"""Contacts in a mode that is known: the equations of what is on, and nothing else.

So most accelerations are found. Where the mode does not say what contacts do, or equations alone
do not split their forces by the laws of contact, `ExactContacts` finds them as if for the first
time.
"""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbd_ros.core.contact_modes.slip_directions import direction, is_fine, slowest
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.optimization.redundant_equations import balanced, least_balanced
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.core.thresholds import ZERO_ROW

if TYPE_CHECKING:
    from mbd_ros.core.contact_modes.event_contacts import ExactContacts


class Balance(NamedTuple):
    """What rows do in their mode.

    Attributes:
        lam: Their multipliers, shape (m,).
        force: Of these on all joints, shape (nv,).
        a: Accelerations of all joints with it, shape (nv,).
        left: The w of the rows, shape (m,).
        is_split: Whether equations alone do not split the force; lam is then the least one.
        moving: Slips that follow the velocity, by their contacts.
    """

    lam: Array
    force: Array
    a: Array
    left: Array
    is_split: bool
    moving: dict[int, Array]


class ContactsInMode:
    """The equations of one mode.

    Args:
        rows: Rows that give way, all from event to event, with constant bounds.
        contacts: The contacts among them.
        mode: One entry a row.
    """

    def __init__(self, rows: ConstraintRows, contacts: "ExactContacts", mode: Mode) -> None:
        self._rows, self._contacts = rows, contacts
        m = len(rows.rows)
        on = {i for i, way in enumerate(mode[:m]) if way == 0}
        self._known = np.where(np.array(mode[:m]) == 1, rows.lower, rows.upper)
        self._turning: list[tuple[int, Mode]] = []
        names: dict[int, Mode] = {}
        for c, i in enumerate(contacts.normals):
            own, name = range(i, i + 3), mode[i + 1 : i + 3]
            self._known[i : i + 3] = 0.0
            if mode[i] or any(name):
                on.difference_update(own[1:])
            if not mode[i] and any(name):
                names[c] = name
        self.on = np.array(sorted(on), dtype=np.intp)
        self._known[self.on] = 0.0
        self._is_pushed = bool(self._known.any())
        at = {row: n for n, row in enumerate(self.on.tolist())}
        sticking = [i for c, i in enumerate(contacts.normals) if i in on and c not in names]
        self._sticking = np.array([[at[i + j] for j in range(3)] for i in sticking], dtype=np.intp)
        slipping = [contacts.normals[c] for c in names if contacts.mu[c] > 0.0]
        self._slipping = np.array([at[i] for i in slipping], dtype=np.intp)
        n = len(self.on)
        self._pick = np.zeros((n + len(slipping), m))  # D, then normals without friction
        self._pick[range(n), self.on] = 1.0
        self._pick[range(n, n + len(slipping)), slipping] = 1.0
        self._at = [at.get(i, -1) for i in contacts.normals]
        for c, name in names.items():
            if is_fine(name):
                self._rub(c, direction(np.ones(2), name))
            else:
                self._turning.append((c, name))

    def solve(
        self, motion: Any, q: Array, x: State, a: Array, *, splits: bool = True
    ) -> Balance | None:
        """Multipliers and accelerations; None where more than equations says what they are.

        Args:
            motion: The `FreeMotion` without rows that give way.
            q: Integrated configuration.
            x: State of all joints, with k refreshed.
            a: Accelerations of all joints without the rows.
            splits: Whether it matters how contacts that stick share their force.

        Raises:
            SolveError: The rows that are on contradict one another.
        """
        k, n = motion.mechanism.k, len(self.on)
        J, b = self._rows.conditions(k, x)
        moving = self._turn(k, J, x) if self._turning else {}
        if moving is None:
            return None
        D, E = self._pick.dot(J), J.take(self.on, 0)
        response = motion.respond(q, D.T)
        known = self._known.dot(J) if self._is_pushed else None
        if known is not None:
            a = a + motion.respond(q, known.reshape(-1, 1))[:, 0]
        A = E.dot(response[:, :n])
        unit = self._units(A, (D[n:] * response[:, n:].T).sum(axis=1))
        w, slips = E.dot(a) + b.take(self.on), len(self._slipping) > 0
        found, is_split = balanced(A, w, unit)
        moved = found
        if is_split and (splits or slips):
            found, is_split = least_balanced(A, w, unit)
            if is_split and not self._keep_laws(found):
                return None
            if slips:  # friction moves bodies by how they share their normal forces
                moved = found
        a = a + response[:, :n].dot(moved)
        lam, force = found.dot(self._pick[:n]), found.dot(D[:n])
        if known is not None:
            lam, force = lam + self._known, force + known
        return Balance(lam, force, a, J.dot(a) + b, is_split, moving)

    def _keep_laws(self, found: Array) -> bool:
        """Whether contacts that are on push, inside their cones."""
        lam = self._known.copy()
        lam[self.on] = found
        return self._contacts.forces.is_lawful(lam)

    def _turn(self, k: Kinematics, J: Array, x: State) -> dict[int, Array] | None:
        """Let slips follow their velocity; None where one is too slow to have a direction."""
        moving: dict[int, Array] = {}
        slow = slowest(x)
        slips = self._contacts.slips_by(k, J, x)
        for c, name in self._turning:
            slip = slips[c]
            if slip.dot(slip) <= slow * slow:
                return None
            self._rub(c, direction(slip, name))
            moving[c] = slip
        return moving

    def _rub(self, c: int, along: Array) -> None:
        """Let the normal of a contact push against its slip, too."""
        i = self._contacts.normals[c]
        self._pick[self._at[c], i + 1 : i + 3] = -self._contacts.mu[c] * along

    def _units(self, A: Array, smooth: Array) -> Array:
        """Multipliers that change the rates of rows about alike, shape (n,).

        Args:
            A: Rates that multipliers add, shape (n, n).
            smooth: Those that normals of slips add without friction, shape (s,).
        """
        size = np.abs(A.diagonal())
        if len(smooth):  # friction may take from the normal what it moves
            size[self._slipping] = np.maximum(size[self._slipping], smooth)
        if len(self._sticking):
            size[self._sticking] = size[self._sticking].max(axis=1)[:, None]
        largest = size.max()
        if size.min() <= ZERO_ROW * largest:
            size[size <= ZERO_ROW * largest] = 1.0
        unit: Array = 1.0 / np.sqrt(size)
        return unit


def contacts_in(
    rows: ConstraintRows, contacts: "ExactContacts", count: int, mode: Mode
) -> ContactsInMode | None:
    """The equations of a mode; None where a mode does not say them.

    Args:
        rows: Rows that give way.
        contacts: The contacts among them.
        count: Number of the rows that go from event to event.
        mode: Begins with one entry each of these.
    """
    if rows.varies or len(rows.rows) > count or len(mode) < count:
        return None
    known = ContactsInMode(rows, contacts, mode)
    return known if len(known.on) else None
