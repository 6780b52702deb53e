"""Rows that give way at events only: on, off or at a bound, by the mode.

A row that is on is an equation, one at a bound is a force, one that is off is not there. The mode
of a row is 0 while it is on; 1 where its multiplier is at the lower bound (a gap that is open,
friction of a joint that slips forwards), -1 at the upper one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.complementarity.bounded_rows import BoundedRows
from mbd_ros.core.contact_modes.row_distances import Reach, RowHeights, reach_of
from mbd_ros.core.kinematics.kinematics import Reads
from mbd_ros.core.rows.constraint_rows import ConstraintRows, RowBlock
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.core.thresholds import TIE

# from t, q, v and the acceleration without the rows to that with their forces
Pushing = Callable[[float, Array, Array, Array], Array]


class ExactRows:
    """Rows that give way, in a mode.

    Rows that are solved for in every evaluation stand beside them. Their heights, g', ways and the
    nearest state on them are those of `RowHeights`.

    Args:
        motion: The `FreeMotion` without rows that give way.
        solver: Of all rows that give way, those of every evaluation among them.

    Attributes:
        names: As the multipliers, one a row.
        slots: Of their multipliers among those of the scene, shape (n,).
        reach: One entry a row.
        restitution: Shape (n,).
        lam: Multipliers of the last solve, shape (n,).
        left: Their w = g'' + kd g' + kp g there, shape (n,).
        lower: Their lower bounds there, shape (n,).
        upper: Their upper bounds there, shape (n,).
        contacts: The contacts with friction among them; None without any.
    """

    def __init__(self, motion: Any, solver: BoundedRows) -> None:
        self._motion = motion
        self.solver = solver
        rows = self._rows = solver.constraints
        exact = [
            each for each in _each(rows.blocks) if not (each[2].law.is_rigid or each[2].smoothed)
        ]
        self._at = np.array([i for i, *_ in exact], dtype=np.intp)
        self.names = tuple(rows.rows[i].name for i, *_ in exact)
        self.slots = rows.slots[self._at]
        self.reach = tuple(reach_of(block, own) for _, own, block in exact)
        self.restitution = np.array([block.law.restitution for *_, block in exact])
        n = len(exact)
        self.contacts = None
        self._is_alone = n == len(rows.rows)  # no row is solved for in every evaluation
        if rows.cones:
            from mbd_ros.core.contact_modes.contact_modes import ContactModes
            from mbd_ros.core.contact_modes.mode_equations import ExactContacts

            self.contacts = ExactContacts(rows, self._at)
            self._modes = ContactModes(self.contacts)
        self._over = RowHeights(motion, rows, self._at, self.reach, self.contacts)
        self.heights = self._over.heights
        self.approach = self._over.approach
        self.ways = self._over.ways
        self.onto = self._over.onto
        self.lam, self.left, self.lower, self.upper, self._slack = np.zeros((5, n))
        self._pushing: tuple[Mode, Pushing | None] = ((), None)

    def is_idle(self, mode: Mode) -> bool:
        """Whether no row acts in a mode, as far as that is known while building."""
        return is_idle(self._rows, self._at, mode)

    def pushing(self, mode: Mode) -> Pushing | None:
        """What adds the forces of rows at their bounds; None where one has to be solved for."""
        if mode != self._pushing[0]:
            self._pushing = mode, pushing(self._motion, self._rows, self._at, mode)
        return self._pushing[1]

    def accelerate(
        self,
        t: float,
        q: Array,
        v: Array,
        a: Array,
        mode: Mode,
        free: Collection[int] = (),
        *,
        splits: bool = True,
        is_weighed: bool = False,
    ) -> Array:
        """Accelerations of what is integrated, with the rows of a mode.

        Args:
            a: Acceleration without the rows, of the last `accelerate` of the motion.
            mode: Begins with one entry a row; the state decides where it is empty.
            free: Rows whose mode is looked for: their multipliers may be all that the law allows.
            splits: Whether multipliers of contacts matter that share a force and stick.
            is_weighed: Whether `renamed` asks, for what counts as none of w.

        Raises:
            SolveError: The rows that are on contradict one another.
        """
        motion, rows = self._motion, self._rows
        joint_q, joint_v, joint_a = motion.joint_motion(q, v, a)
        x = State(t, joint_q, joint_v, motion.mechanism.z)
        motion.mechanism.k.refresh(joint_q, joint_v, rows.reads)
        if rows.varies:
            rows.limit(motion.mechanism.k, x)
        if not mode:
            mode, free = self._over.ways_at(x)
        self.lower, self.upper = rows.lower[self._at], rows.upper[self._at]
        if self.contacts is not None and not (free or is_weighed):
            known = self.contacts.balance(motion, q, x, joint_a, mode, splits=splits)
            if known is not None:
                self.solver.multipliers, self.solver.force = known.lam, known.force
                self.lam, self.left = known.lam[self._at], known.left[self._at]
                return np.asarray(motion.coordinates.integrated(known.a))
        bounds = bounds_in(rows, self._at, mode, free)
        if self.contacts is not None:
            found = self.contacts.solve(motion, q, x, joint_a, bounds, mode, free, splits=splits)
            self.solver.multipliers, self.solver.force = found.lam, found.force
            a, left, terms = motion.coordinates.integrated(joint_a + found.added), *found[3:]
        else:
            a, left, terms = self.solver.held(motion, q, x, joint_a, *bounds)
        self.lam, self.left = self.solver.multipliers[self._at], left[self._at]
        self._slack = TIE * terms[self._at]
        return a

    def solve(
        self,
        y: State,
        u: Array | None,
        mode: Mode,
        free: Collection[int] = (),
        *,
        is_weighed: bool = False,
    ) -> Array:
        """As `accelerate`, at a state of what is integrated."""
        a, mechanism = self._over.freely(y, u, mode), self._motion.mechanism
        before, mechanism.z = mechanism.z, y.z
        try:
            return self.accelerate(y.t, y.q, y.v, a, mode, free, is_weighed=is_weighed)
        finally:
            mechanism.z = before

    def rates_left(self, y: State, u: Array | None, mode: Mode) -> Array:
        """The w = g'' of all rows in a mode; without a solve where none is on."""
        pushed = self.pushing(mode)
        if pushed is None and not (self._is_alone and self.is_idle(mode)):
            self.solve(y, u, mode)
            return self.left
        a, motion = self._over.freely(y, u, mode), self._motion
        before, motion.mechanism.z = motion.mechanism.z, y.z
        try:
            if pushed is not None:
                a = pushed(y.t, y.q, y.v, a)
            joint_a = motion.joint_motion(y.q, y.v, a)[2]
            J, b = self._rows.conditions(motion.mechanism.k, self._over.placed(y))
            return np.asarray((J.dot(joint_a) + b)[self._at])
        finally:
            motion.mechanism.z = before

    def answer(
        self, y: State, u: Array | None, chosen: Sequence[int]
    ) -> tuple[Array, Array, Array]:
        """J and b with w = J a + b of some rows, and the accelerations that they add, (nv, k)."""
        self.solve(y, u, (1,) * len(self.names))
        x, at = self._over.placed(y), self._at[list(chosen)]
        J, b = self._rows.conditions(self._motion.mechanism.k, x)
        J, b = J[at].copy(), b[at].copy()
        return J, b, self._motion.respond(y.q, J.T)

    def found(self) -> Mode:
        """The mode that the last `accelerate` found; a tie is on, and ends if it has to."""
        above, below = self.left > self._slack, self.left < -self._slack
        ways = (above.astype(int) - below).tolist()
        if self.contacts is not None:
            modes = self._modes.found(self.left, self._slack)
            for i, three in zip(self.contacts.normals, modes, strict=True):
                ways[i : i + 3] = three
        return tuple(ways)

    def friction(self, y: State, mode: Mode) -> dict[tuple[int, int], float]:
        """Margins of the tangents of contacts in a mode, by the multipliers of the last solve."""
        if self.contacts is None:
            return {}
        return self._modes.margins(*self._over.slips(y), self.lam, mode)

    def leaving(
        self, y: State, u: Array | None, mode: Mode, switch: int, way: int
    ) -> dict[int, int]:
        """The modes with which a switch is left in a direction."""
        contacts = self.contacts
        if contacts is None or not any(i <= switch < i + 3 for i in contacts.normals):
            return {switch: way}
        self.solve(y, u, mode)
        if not contacts.shares:
            return self._modes.left(self.lam, switch)
        with contacts.eased():
            self.solve(y, u, mode, self._modes.touching(mode))
        return self._modes.leaving(self.lam, self.left, self._slack, mode)

    def renamed(
        self, y: State, u: Array | None, mode: Mode, switch: int | None = None
    ) -> dict[int, int]:
        """Modes of contacts whose slip goes on under another name; empty where none does.

        Args:
            y: State of what is integrated.
            mode: The present one.
            switch: Tangent of a slip that is slow; None at the start of a step.
        """
        if self.contacts is None or not self._modes.slipping(mode):
            return {}
        if switch is None:
            chosen = self._modes.turned(*self._over.slips(y), mode)
        elif self.reach[switch] is Reach.FRICTION and mode[switch]:
            chosen = self._modes.slow(*self._over.slips(y), mode, switch)
        else:
            return {}
        if not chosen:
            return {}
        self.solve(y, u, mode, is_weighed=True)
        return self._modes.renamed(self.left, self._slack, chosen)

    def slipping(self, y: State, closed: Collection[int]) -> list[int]:
        """Normals of contacts that slip, among those of closed ones."""
        if self.contacts is None:
            return []
        moving = self._modes.slips_now(*self._over.slips(y))
        return [i for i in moving if i in closed]

    def longest(self, y: State, u: Array | None, mode: Mode) -> float:
        """Length of a step in which no slip of a contact changes by much [s]."""
        if self.contacts is None or not self._modes.turning(mode):
            return math.inf
        self.solve(y, u, mode)
        return self._modes.longest(self.left, mode)


def _each(blocks: tuple[RowBlock, ...]) -> list[tuple[int, int, RowBlock]]:
    """Number of every row, its number in its block, and the block."""
    own = ((n, block) for block in blocks for n in range(len(block.rows)))
    return [(i, *each) for i, each in enumerate(own)]


def bounds_in(
    rows: ConstraintRows, at: NDArray[np.intp], mode: Mode, free: Collection[int]
) -> tuple[Array, Array]:
    """Smallest and largest multipliers of all rows in a mode.

    Args:
        rows: Rows that give way.
        at: Which of them go from event to event, shape (n,).
        mode: Begins with one entry each of these.
        free: Those whose mode is looked for.
    """
    lower, upper = rows.lower.copy(), rows.upper.copy()
    for i, (row, way) in enumerate(zip(at, mode, strict=False)):
        if i in free:
            continue
        if way == 0:
            lower[row], upper[row] = -np.inf, np.inf
        elif way == 1:
            upper[row] = lower[row]
        else:
            lower[row] = upper[row]
    return lower, upper


def is_idle(rows: ConstraintRows, at: NDArray[np.intp], mode: Mode) -> bool:
    """Whether no row acts in a mode, as far as that is known while building.

    Args:
        rows: Rows that give way.
        at: Which of them go from event to event, shape (n,).
        mode: Begins with one entry each of these.
    """
    return (
        len(mode) > 0
        and not rows.varies
        and all(way == 1 and rows.lower[i] == 0.0 for way, i in zip(mode, at, strict=False))
    )


def pushing(motion: Any, rows: ConstraintRows, at: NDArray[np.intp], mode: Mode) -> Pushing | None:
    """What adds the forces of rows that all are at a bound; None where one has to be solved for.

    Args:
        motion: The `FreeMotion` without rows that give way.
        rows: Rows that give way.
        at: Which of them go from event to event, shape (n,).
        mode: Begins with one entry each of these.
    """
    n = len(at)
    if len(rows.rows) > n or len(mode) < n or not all(mode[:n]):
        return None
    k, at_lower = motion.mechanism.k, np.array(mode[:n]) == 1
    pairs = zip(rows.parts, rows.slices, strict=True)
    known = np.where(at_lower, rows.lower, rows.upper)
    acting = [(part, mine) for part, mine in pairs if rows.varies or known[mine].any()]
    reads = max((part.reads for part, _ in acting), default=Reads.NOTHING)

    def pushed(t: float, q: Array, v: Array, a: Array) -> Array:
        joint_q, joint_v, joint_a = motion.joint_motion(q, v, a)
        x = State(t, joint_q, joint_v, motion.mechanism.z)
        k.refresh(joint_q, joint_v, reads)
        lam = known
        if rows.varies:
            rows.limit(k, x)
            lam = np.where(at_lower, rows.lower, rows.upper)
        force = sum(lam[mine].dot(part.jacobian(k, x)) for part, mine in acting)
        response = motion.respond(q, np.reshape(force, (-1, 1)))[:, 0]
        return cast(Array, motion.coordinates.integrated(joint_a + response))

    return pushed if acting else None
