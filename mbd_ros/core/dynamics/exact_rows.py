"""Rows that give way at events only: on, off or at a bound, by the mode.

A row that is on is an equation, one at a bound is a force, one that is off is not there. The mode
of a row is 0 while it is on; 1 where its multiplier is at the lower bound (a gap that is open,
friction of a joint that slips forwards), -1 at the upper one.
"""

from collections.abc import Callable, Collection, Sequence
from enum import Enum
from typing import Any, cast

import numpy as np

from mbd_ros.core.dynamics.exact_contact import OPEN, ExactContact, side
from mbd_ros.core.model.kinematics import Reads
from mbd_ros.core.optimization.bounded_rows import BoundedRows
from mbd_ros.core.row_laws import Kind, Level
from mbd_ros.core.rows.row_layout import RowBlock
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.core.thresholds import ON_SURFACE, TIE

_CORRECTIONS = 4


class Reach(Enum):
    """What has to be zero before a row may be on."""

    GAP = "gap"  # g, and g': one-sided rows of positions
    SLIP = "slip"  # g': rows of velocities
    DEMAND = "demand"  # g'' + kd g' + kp g: drives, which follow within their limit
    FRICTION = "friction"  # the slip, where the normal before it is on


def rounding(x: State) -> float:
    """Height over a surface that counts as none."""
    return ON_SURFACE * float(1.0 + max(np.abs(x.q).max(), np.abs(x.v).max()))


class ExactRows:
    """Rows that give way, in a mode.

    Heights are positive in mode 1 and negative in mode -1: gaps, slip velocities. Rows that are
    solved for in every evaluation stand beside them.

    Args:
        motion: The `FreeMotion` without rows that give way.
        solver: Of all rows that give way, those of every evaluation among them.

    Attributes:
        names: As the multipliers, one a row.
        slots: Of their multipliers among those of the scene, shape (n,).
        reach: One entry a row.
        restitution: Shape (n,).
        solver: As given.
        lam: Multipliers of the last solve, shape (n,).
        left: Their w = g'' + kd g' + kp g there, shape (n,).
        lower: Their lower bounds there, shape (n,).
        upper: Their upper bounds there, shape (n,).
        contact: Where a normal and its two tangents stand among them; None without a contact.
    """

    def __init__(self, motion: Any, solver: BoundedRows) -> None:
        self._motion, self.solver = motion, solver
        rows = self._rows = solver.constraints
        exact = [each for each in _each(rows.blocks) if _is_exact(each[2])]
        self._at = np.array([i for i, *_ in exact], dtype=np.intp)
        self.names = tuple(rows.rows[i].name for i, *_ in exact)
        self.slots = rows.slots[self._at]
        self.reach = tuple(reach_of(block, own) for _, own, block in exact)
        self.restitution = np.array([block.law.restitution for *_, block in exact])
        self._is_gap, self._is_slip, self._is_friction = (
            np.array([one is kind for one in self.reach])
            for kind in (Reach.GAP, Reach.SLIP, Reach.FRICTION)
        )
        n, kinds = len(exact), [block.law.kind for *_, block in exact]
        self.contact, self._contact = None, None
        if Kind.CONE in kinds:
            first = kinds.index(Kind.CONE)
            self.contact, self._contact = slice(first, first + 3), ExactContact(rows)
        self.lam, self.left, self.lower, self.upper, self._slack = np.zeros((5, n))
        self._none = np.zeros(len(rows.rows))

    def is_idle(self, mode: Mode) -> bool:
        """Whether no row acts in a mode, as far as that is known while building."""
        return (
            len(mode) > 0
            and not self._rows.varies
            and all(
                way == 1 and self._rows.lower[i] == 0.0
                for way, i in zip(mode, self._at, strict=False)
            )
        )

    def pushing(self, mode: Mode) -> Callable[[float, Array, Array, Array], Array] | None:
        """What adds the forces of rows at their bounds; None where one has to be solved for.

        Args:
            mode: Begins with one entry a row.

        Returns:
            A function of t, q, v and the acceleration without the rows.
        """
        motion, rows, n = self._motion, self._rows, len(self.names)
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

        return pushed

    def accelerate(
        self, t: float, q: Array, v: Array, a: Array, mode: Mode, free: Collection[int] = ()
    ) -> Array:
        """Accelerations of what is integrated, with the rows of a mode.

        Args:
            t: Time [s].
            q: Integrated configuration.
            v: Integrated velocity.
            a: Acceleration without the rows, of the last `accelerate` of the motion.
            mode: Begins with one entry a row; the state decides where it is empty.
            free: Rows whose mode is looked for: their multipliers may be all that the law allows.

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
            mode, free = self._ways(x)
        lower, upper = self._bounds(mode, free)
        if self._contact is not None:
            a, left, terms = self._with_contact(
                *(self._contact, q, x, joint_a, (lower, upper), mode, free)
            )
        else:
            a, left, terms = self.solver.held(motion, q, x, joint_a, lower, upper)
        self.lam, self.left = self.solver.multipliers[self._at], left[self._at]
        self._slack = TIE * terms[self._at]
        self.lower, self.upper = rows.lower[self._at], rows.upper[self._at]
        return a

    def _with_contact(
        self,
        contact: ExactContact,
        q: Array,
        x: State,
        a: Array,
        bounds: tuple[Array, Array],
        mode: Mode,
        free: Collection[int],
    ) -> tuple[Array, Array, Array]:
        """As `BoundedRows.held`, with a contact."""
        at = self.contact
        assert at is not None
        is_free = at.start in free
        found = contact.solve(
            *(self._motion, q, x, a, bounds, () if is_free else mode[at]),
            is_open=not is_free and mode[at.start] != 0,
        )
        self.solver.multipliers, self.solver.force = found.lam, found.force
        return self._motion.coordinates.integrated(a + found.added), found.left, found.terms

    def solve(self, y: State, u: Array | None, mode: Mode, free: Collection[int] = ()) -> Array:
        """As `accelerate`, at a state of what is integrated."""
        a, mechanism = self._freely(y, u, mode), self._motion.mechanism
        before, mechanism.z = mechanism.z, y.z
        try:
            return self.accelerate(y.t, y.q, y.v, a, mode, free)
        finally:
            mechanism.z = before

    def answer(
        self, y: State, u: Array | None, chosen: Sequence[int]
    ) -> tuple[Array, Array, Array]:
        """J and b with w = J a + b of some rows, and the accelerations that they add, (nv, k)."""
        self.solve(y, u, (1,) * len(self.names))
        x, at = self._placed(y), self._at[list(chosen)]
        J, b = self._rows.conditions(self._motion.mechanism.k, x)
        J, b = J[at].copy(), b[at].copy()
        return J, b, self._motion.respond(y.q, J.T)

    def found(self) -> Mode:
        """The mode that the last `accelerate` found; a tie is on, and ends if it has to."""
        above, below = self.left > self._slack, self.left < -self._slack
        ways = (above.astype(int) - below).tolist()
        if self._contact is not None:
            at = self.contact
            ways[at] = self._contact.found(self.left[at], self._slack[at])
        return tuple(ways)

    def friction(self, y: State, mode: Mode) -> dict[tuple[int, int], float]:
        """Margins of the tangents of a contact in a mode, by the multipliers of the last solve."""
        at, contact = self.contact, self._contact
        if at is None or contact is None or mode[at.start]:
            return {}
        first, named = at.start + 1, mode[at][1:]
        if not any(named):
            return {(first, 1): contact.margin(self.lam[at])}
        slip = contact.slip(self._motion.mechanism.k, self._placed(y))
        return {(first, 0): float(slip.dot(named)) / float(np.linalg.norm(named))}

    def leaving(self, switch: int, way: int) -> dict[int, int]:
        """The modes with which a switch is left in a direction, after a solve."""
        at = self.contact
        if at is None or not at.start <= switch < at.stop:
            return {switch: way}
        after = OPEN if switch == at.start else (0, *side(-self.lam[at][1:]))
        return dict(zip(range(at.start, at.stop), after, strict=True))

    def turned(self, y: State, mode: Mode) -> dict[int, int]:
        """Modes of a contact whose slip has turned; empty where it has not, or does not slip."""
        at, contact = self.contact, self._contact
        if at is None or contact is None or mode[at.start] or not any(mode[at]):
            return {}
        after = contact.turned(self._motion.mechanism.k, self._placed(y), mode[at])
        return dict(zip(range(at.start, at.stop), after, strict=True)) if after != mode[at] else {}

    def heights(self, y: State) -> Array:
        """Gaps, slip velocities, and 1 for rows without height, shape (n,)."""
        return self._heights(self._placed(y))

    def approach(self, y: State) -> Array:
        """The g' of all rows, shape (n,)."""
        return self._approach(self._placed(y))

    def ways(self, y: State) -> tuple[Mode, list[int]]:
        """Modes by the heights, and rows that may be on."""
        return self._ways(self._placed(y))

    def onto(self, y: State, mode: Mode, *, moves: bool = True) -> State:
        """The state on the rows that are on, moved as their forces move it: g = 0, then g' = 0.

        Args:
            y: State of what is integrated.
            mode: Begins with one entry a row.
            moves: Whether its velocity changes, too.
        """
        on = np.array([not way for way in mode[: len(self.names)]], dtype=np.bool_)
        gaps, slips = on & self._is_gap, on & (self._is_gap | self._is_slip | self._is_friction)
        for _ in range(_CORRECTIONS if gaps.any() else 0):
            g = self._heights(self._placed(y))
            if np.abs(g[gaps]).max() <= np.spacing(1.0 + np.abs(y.q).max()):
                break
            move = self._move(y, g, gaps)
            y = y._replace(q=self._motion.coordinates.chart.integrate(y.q, move))
        if moves and slips.any():
            rate = self.approach(y)
            if np.abs(rate[slips]).max() > np.spacing(np.abs(y.v).max()):
                y = y._replace(v=y.v + self._move(y, rate, slips))
        return y

    def _move(self, y: State, size: Array, chosen: Array) -> Array:
        """The smallest motion of what is integrated, in the mass metric, that ends a size."""
        motion = self._motion
        self._freely(y, None, y.mode)
        x = self._placed(y)
        J = self._rows.jacobian(motion.mechanism.k, x)[self._at[chosen]]
        response = motion.respond(y.q, J.T)
        share = np.linalg.lstsq(J.dot(response), -size[chosen], rcond=1.0e-13)[0]
        return motion.coordinates.integrated(response.dot(share))

    def _freely(self, y: State, u: Array | None, mode: Mode) -> Array:
        """Accelerations of what is integrated without the rows."""
        mechanism = self._motion.mechanism
        before = mechanism.mode, mechanism.z
        mechanism.mode, mechanism.z = mode, y.z
        try:
            return self._motion.accelerate(y.t, y.q, y.v, u)
        finally:
            mechanism.mode, mechanism.z = before

    def _placed(self, y: State) -> State:
        """State of all joints, with k as the rows need it."""
        x = self._motion.coordinates.expand(y)
        self._motion.mechanism.k.refresh(x.q, x.v, self._rows.reads)
        return x

    def _heights(self, x: State) -> Array:
        k = self._motion.mechanism.k
        heights = np.ones(len(self.names))
        if self._is_gap.any():
            heights[self._is_gap] = self._rows.residual(k, x)[self._at[self._is_gap]]
        if self._is_slip.any():
            heights[self._is_slip] = self._approach(x)[self._is_slip]
        if self._contact is not None and self.contact is not None:
            heights[self.contact.start + 1] = np.linalg.norm(self._contact.slip(k, x))
        return heights

    def _approach(self, x: State) -> Array:
        k = self._motion.mechanism.k
        rate: Array = self._rows.jacobian(k, x).dot(x.v) + self._rows.rate(k, x)
        return rate[self._at]

    def _ways(self, x: State) -> tuple[Mode, list[int]]:
        heights, rate, slack = self._heights(x), self._approach(x), rounding(x)
        on = np.where(self._is_gap, heights, np.abs(heights)) <= slack
        on &= ~self._is_gap | (rate <= slack)
        on |= ~(self._is_gap | self._is_slip)
        if self.contact is not None:
            on[self.contact] = on[self.contact.start]
        ways = np.where((heights < 0.0) & ~self._is_gap, -1, 1)
        return tuple(ways.tolist()), np.flatnonzero(on).tolist()

    def _bounds(self, mode: Mode, free: Collection[int]) -> tuple[Array, Array]:
        """Smallest and largest multipliers of all rows in a mode."""
        lower, upper = self._rows.lower.copy(), self._rows.upper.copy()
        for i, (at, way) in enumerate(zip(self._at, mode, strict=False)):
            if i in free:
                continue
            if way == 0:
                lower[at], upper[at] = -np.inf, np.inf
            elif way == 1:
                upper[at] = lower[at]
            else:
                lower[at] = upper[at]
        return lower, upper


def stiff(block: RowBlock) -> RowBlock:
    """The block without gains, unless it is a drive: what is on is on exactly."""
    if reach_of(block) is Reach.DEMAND:
        return block
    nothing = np.zeros(len(block.rows))
    return block._replace(gains=(nothing, nothing))


def _each(blocks: tuple[RowBlock, ...]) -> list[tuple[int, int, RowBlock]]:
    """Number of every row, its number in its block, and the block."""
    own = [(number, block) for block in blocks for number in range(len(block.rows))]
    return [(i, number, block) for i, (number, block) in enumerate(own)]


def _is_exact(block: RowBlock) -> bool:
    return not (block.law.is_rigid or block.smoothed)


def reach_of(block: RowBlock, own: int = 0) -> Reach:
    """What has to be zero before a row of a block may be on.

    Args:
        block: The block.
        own: Number of the row in it.
    """
    if block.law.kind is Kind.CONE:
        return Reach.FRICTION if own else Reach.GAP
    if block.level is Level.VELOCITY:
        return Reach.SLIP
    return Reach.GAP if block.law.kind is Kind.UNILATERAL else Reach.DEMAND
