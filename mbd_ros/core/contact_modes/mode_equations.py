"""Contacts in a mode that is known: equations of what is on, and nothing else.

    J a + drift = 0 of the rows that are on,   M a + h = tau + D' lam

Sticking, the normal and the tangents of a contact are three equations, and D = J. Slipping,
friction is mu times the normal force against the slip velocity: the normal alone is an equation,
and pushes along

    D = n - mu d' t,   d = v_t / |v_t|

so that the mobility J M^-1 D' is not symmetric. A ball that sticks rolls. Most accelerations are
found so. Where the mode does not say what contacts do, or equations alone do not split their
forces by the laws of contact, `ExactContacts` finds them as if for the first time, by
`contact_forces`. What contacts do next is the subject of `contact_modes`. Source: F. Pfeiffer, C.
Glocker, Multibody Dynamics with Unilateral Contacts, 1996, ch. 5.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.contact_modes.contact_forces import ContactForces, Split, Touch
from mbd_ros.core.contact_modes.slip_directions import direction, is_fine, slowest
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.optimization.least_norm import balanced, least_balanced
from mbd_ros.core.rows.constraint import Kind
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.core.thresholds import ZERO_ROW

_TOGETHER = 100.0  # times a slip that counts as none: those of others that end with it
EASED = 1.0e-6  # of friction: so little less shows how contacts begin to move


class ContactsInMode:
    """The equations of one mode.

    Args:
        rows: Rows that give way, all from event to event, with constant bounds.
        contacts: The contacts among them.
        mode: One entry a row.
    """

    def __init__(self, rows: ConstraintRows, contacts: ExactContacts, mode: Mode) -> None:
        self._rows = rows
        self._contacts = contacts
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
    rows: ConstraintRows, contacts: ExactContacts, count: int, mode: Mode
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


class ExactContacts:
    """The contacts of a scene among all of its rows that give way.

    Args:
        at: Which of them go from event to event, shape (n,).

    Attributes:
        normals: Where the normals stand among these, their tangents behind them, shape (c,).
        names: Of the contacts.
        mu: Their coefficients of friction, shape (c,).
        forces: What finds their multipliers.
        moving: Their slips in the last solve, shape (2,) each; None where one is none.
        slowest: What counted as none there.
    """

    def __init__(self, rows: ConstraintRows, at: NDArray[np.intp]) -> None:
        starts = [cone.slots.start for cone in rows.cones]
        self.normals: list[int] = np.searchsorted(at, starts).tolist()
        self.names = tuple(cone.name for cone in rows.cones)
        self._rows = rows
        self.mu = np.array([cone.mu for cone in rows.cones])
        self._starts = np.array(starts, dtype=np.intp)
        self._tangents = self._starts[:, None] + (1, 2)
        self._flat = self._tangents.ravel()
        self._parts = [block.part for block in rows.blocks if block.law.kind is Kind.CONE]
        self.forces = ContactForces(rows)
        self._known: tuple[Mode, ContactsInMode | None] = ((), None)
        self._asked: tuple[Any, bool, Balance | None] = ((), False, None)
        self._count = len(at)
        self._has_no_others = len(rows.rows) == 3 * len(starts)
        self.moving: list[Array | None] = [None] * len(starts)
        self.slowest = 0.0

    def solve(
        self,
        motion: Any,
        q: Array,
        x: State,
        a: Array,
        bounds: tuple[Array, Array],
        mode: Mode,
        free: Collection[int],
        *,
        splits: bool = True,
    ) -> Solved:
        """Multipliers and accelerations in a mode of the contacts.

        Args:
            motion: The `FreeMotion` without rows that give way.
            x: State of all joints, with k refreshed.
            a: Accelerations of all joints without the rows.
            bounds: Smallest and largest multipliers of all rows.
            mode: One entry each of the rows that go from event to event.
            free: Those whose mode is looked for.
            splits: Whether it matters how contacts that stick share their force.

        Raises:
            SolveError: The rows that are on contradict one another, or no forces are found.
        """
        k = motion.mechanism.k
        J, b = self._rows.conditions(k, x)
        touches, along = self._touches(self.slips_by(k, J, x), slowest(x), mode, free)
        D = self._pushes(J, along)
        response = motion.respond(q, D.T)
        A, w = J.dot(response), J.dot(a) + b
        lam = self.forces.solve(A, w, bounds, touches, splits=splits)
        left, terms = A.dot(lam) + w, np.abs(A).dot(np.abs(lam)) + np.abs(w)
        size = np.sqrt(np.abs(A.diagonal()))
        terms += size * (size * np.abs(lam)).max()  # rounding of forces that cancel there
        force, added = D.T.dot(lam), response.dot(lam)
        for i, d in along.items():
            lam[self._tangents[i]] = -self.mu[i] * lam[self._starts[i]] * d
        return Solved(lam, force, added, left, terms)

    def balance(
        self, motion: Any, q: Array, x: State, a: Array, mode: Mode, *, splits: bool
    ) -> Balance | None:
        """The same where the mode says what contacts do; None where it does not.

        Args:
            motion: As for `solve`.
            q: As for `solve`.
            x: As for `solve`.
            a: As for `solve`.
            mode: As for `solve`; all of it is known.
            splits: As for `solve`.

        Raises:
            SolveError: The rows that are on contradict one another.
        """
        t = None if self._has_no_others else x.t  # stages sum the same time in other ways
        asked = mode, t, x.q.tobytes(), x.v.tobytes(), x.z.tobytes(), a.tobytes()
        before, had_splits, found = self._asked
        if found is None or asked != before or (splits and not had_splits):
            if mode != self._known[0]:
                self._known = mode, contacts_in(self._rows, self, self._count, mode)
            known = self._known[1]
            found = None if known is None else known.solve(motion, q, x, a, splits=splits)
            self._asked = asked, splits, found
        if found is not None:
            self.forces.split = Split.LEAST if found.is_split else Split.ONE
            self.moving, self.slowest = [None] * len(self.normals), slowest(x)
            for c, slip in found.moving.items():
                self.moving[c] = slip
        return found

    def slips(self, k: Kinematics, x: State) -> Array:
        """The velocities v_t of the points along their planes, shape (c, 2)."""
        every = [part.jacobian(k, x).dot(x.v) for part in self._parts]
        slips: Array = (np.concatenate(every).reshape(-1, 3) + self._rates(k, x))[:, 1:]
        return slips

    def slips_by(self, k: Kinematics, J: Array, x: State) -> Array:
        """The same, where J of all rows is known."""
        slips: Array = J[self._flat].dot(x.v).reshape(-1, 2) + self._rates(k, x)[:, 1:]
        return slips

    def _rates(self, k: Kinematics, x: State) -> Array:
        """The part of these that surfaces move by themselves, with normals, shape (c, 3)."""
        return np.concatenate([part.rate(k, x) for part in self._parts]).reshape(-1, 3)

    @property
    def shares(self) -> bool:
        """Whether equations alone did not split the forces of the last solve."""
        return self.forces.split is not Split.ONE

    @contextmanager
    def eased(self) -> Iterator[None]:
        """Where modes are looked for inside, friction is a little smaller."""
        self.forces.grip = 1.0 - EASED
        try:
            yield
        finally:
            self.forces.grip = 1.0

    def _touches(
        self, slips: Array, slow: float, mode: Mode, free: Collection[int]
    ) -> tuple[list[Touch], dict[int, Array]]:
        """How every contact touches, and along which directions which of them slip."""
        touches, along = list[Touch](), dict[int, Array]()
        self.moving, self.slowest = [None] * len(self.normals), slow
        for c, i in enumerate(self.normals):
            is_free, name = i in free, mode[i + 1 : i + 3]
            if not is_free and mode[i]:
                touches.append(Touch.OPEN)
            elif not is_free and not any(name):
                touches.append(Touch.STICKS)
            else:
                size = math.hypot(*slips[c])
                none = _TOGETHER * slow if is_free else slow
                is_slow = size <= none and (is_free or not is_fine(name))
                if not is_slow:
                    self.moving[c] = slips[c]
                if is_slow and self.mu[c] > 0.0:
                    touches.append(Touch.MAY)
                    continue
                along[c] = direction(slips[c], () if is_free else name)
                touches.append(Touch.MAY_SLIP if is_free else Touch.SLIPS)
        return touches, along

    def _pushes(self, J: Array, along: dict[int, Array]) -> Array:
        """D: the normals with friction, shape (m, nv)."""
        if not along:
            return J
        D = J.copy()
        for c, d in along.items():
            D[self._starts[c]] -= self.mu[c] * d.dot(J[self._tangents[c]])
        return D


class Solved(NamedTuple):
    """What rows that give way do at one state.

    Attributes:
        lam: Their multipliers, shape (m,).
        force: Of these on all joints, shape (nv,).
        added: Accelerations of all joints by it, shape (nv,).
        left: The w of the rows, shape (m,).
        terms: Size of the terms in w, shape (m,).
    """

    lam: Array
    force: Array
    added: Array
    left: Array
    terms: Array
