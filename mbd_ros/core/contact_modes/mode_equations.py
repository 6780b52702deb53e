"""Equations of motion of contacts in a known mode.

    J a + drift = 0 of the active rows,   M a + h = tau + D' lam

Where a contact sticks, its normal and its tangents are three equations, and D = J. Where it slips,
friction is mu times the normal force against the slip velocity: the normal alone is an equation,
and pushes along

    D = n - mu d' t,   d = v_t / |v_t|

so that the mobility J M^-1 D' is not symmetric. A ball that rolls sticks. `ModeEquations` solves
them. `EventContacts` solves the laws of contact instead, by `contact_forces`, where the mode does
not say what contacts do, or where equations alone share forces among contacts against these laws.
`contact_modes` decides which mode comes next. Source: F. Pfeiffer, C. Glocker, Multibody Dynamics
with Unilateral Contacts, 1996, ch. 5.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.complementarity.bounded_rows import BoundedSolution
from mbd_ros.core.contact_modes.contact_forces import ContactForces, Touch
from mbd_ros.core.contact_modes.row_solution import ContactSolution, Split
from mbd_ros.core.contact_modes.slip_directions import direction, is_fine, slowest
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.optimization.least_norm import balanced, least_balanced
from mbd_ros.core.rows.constraint import Kind
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.core.thresholds import ZERO_ROW

_TOGETHER = 100.0  # times a slip that counts as none: slips of others that end with it


class ModeEquations:
    """The equations of one mode.

    Args:
        rows: Unilateral and bounded rows, all event-driven, with constant bounds.
        contacts: The contacts among them.
        mode: One entry a row.

    Attributes:
        active: Numbers of the active rows, ascending.
    """

    def __init__(self, rows: ConstraintRows, contacts: EventContacts, mode: Mode) -> None:
        self._rows = rows
        self._contacts = contacts
        m = len(rows.rows)
        active = {i for i, side in enumerate(mode[:m]) if side == 0}
        self._bound_lam = np.where(np.array(mode[:m]) == 1, rows.lower, rows.upper)
        self._turning: list[tuple[int, Mode]] = []
        names: dict[int, Mode] = {}
        for c, i in enumerate(contacts.normals):
            name = mode[i + 1 : i + 3]
            self._bound_lam[i : i + 3] = 0.0
            if mode[i] or any(name):
                active.difference_update((i + 1, i + 2))
            if not mode[i] and any(name):
                names[c] = name
        self.active = np.array(sorted(active), dtype=np.intp)
        self._bound_lam[self.active] = 0.0
        self._has_bound_forces = bool(self._bound_lam.any())
        at = {row: n for n, row in enumerate(self.active.tolist())}
        sticking = [i for c, i in enumerate(contacts.normals) if i in active and c not in names]
        self._sticking = np.array([[at[i + j] for j in range(3)] for i in sticking], dtype=np.intp)
        slipping = [contacts.normals[c] for c in names if contacts.mu[c] > 0.0]
        self._slipping = np.array([at[i] for i in slipping], dtype=np.intp)
        n = len(self.active)
        self._pick = np.zeros((n + len(slipping), m))  # D, then normals without friction
        self._pick[range(n), self.active] = 1.0
        self._pick[range(n, n + len(slipping)), slipping] = 1.0
        self._at = [at.get(i, -1) for i in contacts.normals]
        for c, name in names.items():
            if is_fine(name):
                self._add_friction(c, direction(np.ones(2), name))
            else:
                self._turning.append((c, name))

    def solve(
        self, motion: Any, q: Array, x: State, a: Array, *, splits: bool = True
    ) -> Balance | None:
        """Solve for multipliers and accelerations.

        Args:
            motion: The `FreeMotion` without unilateral and bounded rows.
            q: Configuration of what is integrated.
            x: State of all joints, with k refreshed.
            a: Accelerations of all joints without the rows, shape (nv of the robot,).
            splits: Whether it matters how contacts that stick share their force.

        Returns:
            None where equations alone do not say what the contacts do.

        Raises:
            SolveError: The active rows contradict one another.
        """
        k, n = motion.mechanism.k, len(self.active)
        J, b = self._rows.conditions(k, x)
        slips: list[Array | None] | None = [None] * len(self._at)
        if self._turning:
            slips = self._follow_slips(k, J, x)
        if slips is None:
            return None
        D, E = self._pick.dot(J), J.take(self.active, 0)
        response = motion.respond(q, D.T)
        bound_force = self._bound_lam.dot(J) if self._has_bound_forces else None
        if bound_force is not None:
            a = a + motion.respond(q, bound_force.reshape(-1, 1))[:, 0]
        A = E.dot(response[:, :n])
        unit = self._units(A, (D[n:] * response[:, n:].T).sum(axis=1))
        w, has_slips = E.dot(a) + b.take(self.active), len(self._slipping) > 0
        pushes, is_split = balanced(A, w, unit)
        moving_pushes = pushes
        if is_split and (splits or has_slips):
            pushes, is_split = least_balanced(A, w, unit)
            if is_split and not self._keeps_laws(pushes):
                return None
            if has_slips:  # friction moves bodies by how they share their normal forces
                moving_pushes = pushes
        a = a + response[:, :n].dot(moving_pushes)
        lam, force = pushes.dot(self._pick[:n]), pushes.dot(D[:n])
        if bound_force is not None:
            lam, force = lam + self._bound_lam, force + bound_force
        split = Split.LEAST if is_split else Split.ONE
        contacts = ContactSolution(split, slips, slowest(x))
        return Balance(lam, force, a, J.dot(a) + b, contacts)

    def _keeps_laws(self, pushes: Array) -> bool:
        """Whether active contacts push, with forces inside their cones."""
        lam = self._bound_lam.copy()
        lam[self.active] = pushes
        return self._contacts.forces.is_lawful(lam)

    def _follow_slips(self, k: Kinematics, J: Array, x: State) -> list[Array | None] | None:
        """Let friction follow slip velocities that turn; None where one is too slow for that."""
        followed: list[Array | None] = [None] * len(self._at)
        slow = slowest(x)
        slips = self._contacts.slips_by(k, J, x)
        for c, name in self._turning:
            slip = slips[c]
            if slip.dot(slip) <= slow * slow:
                return None
            self._add_friction(c, direction(slip, name))
            followed[c] = slip
        return followed

    def _add_friction(self, c: int, along: Array) -> None:
        """Let the normal of a contact push against its slip, too."""
        i = self._contacts.normals[c]
        self._pick[self._at[c], i + 1 : i + 3] = -self._contacts.mu[c] * along

    def _units(self, A: Array, smooth: Array) -> Array:
        """Return the multipliers that change the rates of rows about alike, shape (n,).

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


def equations_in_mode(
    rows: ConstraintRows, contacts: EventContacts, count: int, mode: Mode
) -> ModeEquations | None:
    """Return the equations of a mode; None where a mode does not say them.

    Args:
        rows: Unilateral and bounded rows.
        contacts: The contacts among them.
        count: Number of the event-driven rows.
        mode: Begins with one entry each of these.
    """
    if rows.varies or len(rows.rows) > count or len(mode) < count:
        return None
    equations = ModeEquations(rows, contacts, mode)
    return equations if len(equations.active) else None


class Balance(NamedTuple):
    """Forces and accelerations of rows in their mode.

    Attributes:
        lam: Multipliers, shape (m,).
        force: Force of these on all joints, shape (nv of the robot,).
        a: Accelerations of all joints with it, shape (nv of the robot,).
        w: The g'' of the rows, shape (m,).
        contacts: Slips that follow their velocity, and how contacts share their forces.
    """

    lam: Array
    force: Array
    a: Array
    w: Array
    contacts: ContactSolution


class EventContacts:
    """The event-driven contacts of a scene among all of its unilateral and bounded rows.

    Args:
        rows: All of these rows.
        at: Which of them are event-driven, shape (n,).

    Attributes:
        normals: Numbers of the normals among the event-driven rows; their tangents follow them.
        names: Names of the contacts.
        mu: Their coefficients of friction, shape (c,).
        forces: Solver of their multipliers.
    """

    def __init__(self, rows: ConstraintRows, at: NDArray[np.intp]) -> None:
        starts = [cone.slots.start for cone in rows.cones]
        self.normals: list[int] = np.searchsorted(at, starts).tolist()
        self.names = tuple(cone.name for cone in rows.cones)
        self._rows = rows
        self.mu = np.array([cone.mu for cone in rows.cones])
        self._starts = np.array(starts, dtype=np.intp)
        self._tangents = self._starts[:, None] + (1, 2)
        self._all_tangents = self._tangents.ravel()
        self._parts = [block.part for block in rows.blocks if block.law.kind is Kind.CONE]
        self.forces = ContactForces(rows)
        self._equations: tuple[Mode, ModeEquations | None] = ((), None)
        self._count = len(at)

    def solve(
        self,
        motion: Any,
        q: Array,
        x: State,
        a: Array,
        bounds: tuple[Array, Array],
        mode: Mode,
        undecided: Collection[int],
        *,
        splits: bool = True,
        friction: float = 1.0,
    ) -> tuple[BoundedSolution, ContactSolution]:
        """Solve the laws of contact for multipliers and accelerations.

        Args:
            motion: The `FreeMotion` without unilateral and bounded rows.
            q: Configuration of what is integrated.
            x: State of all joints, with k refreshed.
            a: Accelerations of all joints without the rows, shape (nv of the robot,).
            bounds: Smallest and largest multipliers of all rows.
            mode: One entry each of the event-driven rows.
            undecided: Those whose mode is looked for.
            splits: Whether it matters how contacts that stick share their force.
            friction: Share of the coefficients of friction that counts for undecided contacts.

        Raises:
            SolveError: The active rows contradict one another, or no forces are found.
        """
        k = motion.mechanism.k
        J, b = self._rows.conditions(k, x)
        slow = slowest(x)
        touches, along, slips = self._touches(self.slips_by(k, J, x), slow, mode, undecided)
        D = self._pushes(J, along)
        response = motion.respond(q, D.T)
        A, w = J.dot(response), J.dot(a) + b
        lam, split = self.forces.solve(A, w, bounds, touches, splits=splits, friction=friction)
        end, terms = A.dot(lam) + w, np.abs(A).dot(np.abs(lam)) + np.abs(w)
        size = np.sqrt(np.abs(A.diagonal()))
        terms += size * (size * np.abs(lam)).max()  # rounding of forces that cancel there
        force, added = D.T.dot(lam), response.dot(lam)
        for i, d in along.items():
            lam[self._tangents[i]] = -self.mu[i] * lam[self._starts[i]] * d
        a = motion.coordinates.integrated(a + added)
        return BoundedSolution(a, lam, force, end, terms), ContactSolution(split, slips, slow)

    def balance(
        self, motion: Any, q: Array, x: State, a: Array, mode: Mode, *, splits: bool
    ) -> Balance | None:
        """Solve the equations of a mode; None where the mode does not say them.

        Args:
            motion: The `FreeMotion` without unilateral and bounded rows.
            q: Configuration of what is integrated.
            x: State of all joints, with k refreshed.
            a: Accelerations of all joints without the rows, shape (nv of the robot,).
            mode: Begins with one entry each of the event-driven rows.
            splits: Whether it matters how contacts that stick share their force.

        Raises:
            SolveError: The active rows contradict one another.
        """
        mode = mode[: self._count]
        if mode != self._equations[0]:
            self._equations = mode, equations_in_mode(self._rows, self, self._count, mode)
        equations = self._equations[1]
        return None if equations is None else equations.solve(motion, q, x, a, splits=splits)

    def slips(self, k: Kinematics, x: State) -> Array:
        """Return the velocities v_t of the points along their planes, shape (c, 2)."""
        rates = [part.jacobian(k, x).dot(x.v) for part in self._parts]
        slips: Array = (np.concatenate(rates).reshape(-1, 3) + self._rates(k, x))[:, 1:]
        return slips

    def slips_by(self, k: Kinematics, J: Array, x: State) -> Array:
        """Return the velocities v_t of the points, given J of all rows, shape (c, 2)."""
        slips: Array = J[self._all_tangents].dot(x.v).reshape(-1, 2) + self._rates(k, x)[:, 1:]
        return slips

    def _rates(self, k: Kinematics, x: State) -> Array:
        """Return the part of the rates by which surfaces move by themselves, shape (c, 3)."""
        return np.concatenate([part.rate(k, x) for part in self._parts]).reshape(-1, 3)

    def _touches(
        self, slips: Array, slow: float, mode: Mode, undecided: Collection[int]
    ) -> tuple[list[Touch], dict[int, Array], list[Array | None]]:
        """Return how every contact touches, directions of those that slip, and their slips."""
        touches, along = list[Touch](), dict[int, Array]()
        moving: list[Array | None] = [None] * len(self.normals)
        for c, i in enumerate(self.normals):
            is_undecided, name = i in undecided, mode[i + 1 : i + 3]
            if not is_undecided and mode[i]:
                touches.append(Touch.OPEN)
            elif not is_undecided and not any(name):
                touches.append(Touch.STICKS)
            else:
                size = math.hypot(*slips[c])
                none = _TOGETHER * slow if is_undecided else slow
                is_slow = size <= none and (is_undecided or not is_fine(name))
                if not is_slow:
                    moving[c] = slips[c]
                if is_slow and self.mu[c] > 0.0:
                    touches.append(Touch.MAY)
                    continue
                along[c] = direction(slips[c], () if is_undecided else name)
                touches.append(Touch.MAY_SLIP if is_undecided else Touch.SLIPS)
        return touches, along, moving

    def _pushes(self, J: Array, along: dict[int, Array]) -> Array:
        """Return D, the directions of forces: the normals with friction, shape (m, nv)."""
        if not along:
            return J
        D = J.copy()
        for c, d in along.items():
            D[self._starts[c]] -= self.mu[c] * d.dot(J[self._tangents[c]])
        return D
