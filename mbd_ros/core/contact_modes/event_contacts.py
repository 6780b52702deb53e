"""Contacts with friction among rows that give way at events: open, sticking or slipping.

Sticking, the normal and the tangents of a contact are three equations. Slipping, friction is mu
times the normal force against the slip velocity: the normal alone is an equation, and pushes along

    D = n - mu d' t,   d = v_t / |v_t|

so that the mobility J M^-1 D' is not symmetric. A ball that sticks rolls. What contacts do next
is the subject of `contact_modes`. Source: F. Pfeiffer, C. Glocker, Multibody Dynamics with
Unilateral Contacts, 1996, ch. 5.
"""

import math
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.contact_modes.mode_equations import Balance, ContactsInMode, contacts_in
from mbd_ros.core.contact_modes.mode_multipliers import ContactForces, Split, Touch
from mbd_ros.core.contact_modes.slip_directions import direction, is_fine, slowest
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.multiplier_laws import Kind
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import Array, Mode, State

_TOGETHER = 100.0  # times a slip that counts as none: those of others that end with it
EASED = 1.0e-6  # of friction: so little less shows how contacts begin to move


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


class ExactContacts:
    """The contacts of a scene among all of its rows that give way.

    Args:
        rows: The rows.
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
        self._rows, self.mu = rows, np.array([cone.mu for cone in rows.cones])
        self._starts = np.array(starts, dtype=np.intp)
        self._tangents = self._starts[:, None] + (1, 2)
        self._flat = self._tangents.ravel()
        self._parts = [block.part for block in rows.blocks if block.law.kind is Kind.CONE]
        self.forces = ContactForces(rows)
        self._known: tuple[Mode, ContactsInMode | None] = ((), None)
        self._asked: tuple[Any, bool, Balance | None] = ((), False, None)
        self._count, self._has_no_others = len(at), len(rows.rows) == 3 * len(starts)
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
            q: Integrated configuration.
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
