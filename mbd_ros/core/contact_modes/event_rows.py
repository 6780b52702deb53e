"""Event-driven rows: unilateral and bounded constraints whose mode changes at events only.

The mode of a row is 0 while it is active, which makes it an equation; 1 while its multiplier is at
the lower bound (a gap that is open, friction of a joint that slips forwards), and -1 while it is
at the upper one. At a bound the row exerts a known force, which is 0 for an open gap.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.complementarity.bounded_rows import BoundedRows
from mbd_ros.core.contact_modes.row_distances import Distances, Reach, RowDistances, reach_of
from mbd_ros.core.contact_modes.row_solution import RowSolution
from mbd_ros.core.kinematics.kinematics import Reads
from mbd_ros.core.rows.constraint_rows import ConstraintRows, RowBlock
from mbd_ros.core.state import NONE, Array, Mode, State
from mbd_ros.core.thresholds import TIE

# from a state and its acceleration without the rows to that with their forces
AddForces = Callable[[State, Array], Array]


class EventRows:
    """Unilateral and bounded rows whose mode changes at events only.

    Rows that are solved for in every evaluation stand beside them. Distances to what the rows
    reach, their rates, and the nearest state on them come from `RowDistances`.

    Args:
        motion: The `FreeMotion` without unilateral and bounded rows.
        solver: All of these rows, those of every evaluation among them.

    Attributes:
        names: Names of the multipliers, one a row.
        slots: Places of their multipliers among those of the scene, shape (n,).
        reach: One entry a row.
        restitution: Coefficient of restitution of each row, shape (n,).
        contacts: The contacts with friction among them; None without any.
    """

    def __init__(self, motion: Any, solver: BoundedRows) -> None:
        self._motion = motion
        self.solver = solver
        rows = self._rows = solver.constraints
        entries = [
            entry
            for entry in _rows_of(rows.blocks)
            if not (entry[2].law.is_rigid or entry[2].smoothed)
        ]
        self._at = np.array([i for i, *_ in entries], dtype=np.intp)
        self.names = tuple(rows.rows[i].name for i, *_ in entries)
        self.slots = rows.slots[self._at]
        self.reach = tuple(reach_of(block, number) for _, number, block in entries)
        self.restitution = np.array([block.law.restitution for *_, block in entries])
        self.contacts = None
        self._has_no_others = len(entries) == len(rows.rows)
        if rows.cones:
            from mbd_ros.core.contact_modes.contact_modes import ContactModes
            from mbd_ros.core.contact_modes.mode_equations import EventContacts

            self.contacts = EventContacts(rows, self._at)
            self._contact_modes = ContactModes(self.contacts)
        self._distances = RowDistances(motion, rows, self._at, self.reach, self.contacts)
        self.measure = self._distances.measure
        self.rates = self._distances.rates
        self.modes_by_distance = self._distances.modes
        self.project = self._distances.project
        self._bound_forces: tuple[Mode, AddForces | None] = ((), None)

    def is_idle(self, mode: Mode) -> bool:
        """Whether no row exerts a force in a mode, as far as that is known while building."""
        return is_idle(self._rows, self._at, mode)

    def bound_forces(self, mode: Mode) -> AddForces | None:
        """Return the function that adds the forces of rows that all are at a bound.

        None: a row has to be solved for, or none exerts a force.
        """
        if mode != self._bound_forces[0]:
            self._bound_forces = mode, bound_forces(self._motion, self._rows, self._at, mode)
        return self._bound_forces[1]

    def accelerate(
        self,
        y: State,
        a: Array,
        undecided: Collection[int] = (),
        *,
        splits: bool = True,
        is_weighed: bool = False,
        friction: float = 1.0,
    ) -> RowSolution:
        """Solve for the accelerations of what is integrated with the rows of a mode.

        Args:
            y: State of what is integrated. Its mode begins with one entry a row; where it is
                empty, the distances decide.
            a: Acceleration without the rows, of the last `accelerate` of the motion, shape (nv,).
            undecided: Rows whose mode is looked for: their multipliers may be all that their law
                allows.
            splits: Whether it matters how contacts that stick share their force.
            is_weighed: Whether `slack` of the solution is needed.
            friction: Share of the coefficients of friction that counts for undecided contacts.

        Raises:
            SolveError: The active rows contradict one another.
        """
        motion, rows, mode = self._motion, self._rows, y.mode
        joint_q, joint_v, joint_a = motion.joint_motion(y.q, y.v, a)
        x = State(y.t, joint_q, joint_v, y.z)
        motion.mechanism.k.refresh(joint_q, joint_v, rows.reads)
        if rows.varies:
            rows.limit(motion.mechanism.k, x)
        if not mode:
            mode, undecided = self._distances.modes_at(x)
        lower, upper = rows.lower[self._at], rows.upper[self._at]
        contacts = self.contacts
        if contacts is not None and not (undecided or is_weighed):
            known = contacts.balance(motion, y.q, x, joint_a, mode, splits=splits)
            if known is not None:
                return RowSolution(
                    np.asarray(motion.coordinates.integrated(known.a)),
                    known.lam,
                    known.force,
                    known.lam[self._at],
                    known.w[self._at],
                    lower,
                    upper,
                    NONE,
                    known.contacts,
                )
        bounds = bounds_in_mode(rows, self._at, mode, undecided)
        if contacts is None:
            solution = self.solver.solve(motion, y.q, x, joint_a, *bounds)
            of_contacts = None
        else:
            solution, of_contacts = contacts.solve(
                motion, y.q, x, joint_a, bounds, mode, undecided, splits=splits, friction=friction
            )
        return RowSolution(
            solution.a,
            solution.lam,
            solution.force,
            solution.lam[self._at],
            solution.w[self._at],
            lower,
            upper,
            TIE * solution.terms[self._at],
            of_contacts,
        )

    def solve(
        self,
        y: State,
        u: Array | None,
        mode: Mode,
        undecided: Collection[int] = (),
        *,
        is_weighed: bool = False,
        friction: float = 1.0,
    ) -> RowSolution:
        """Solve for the rows at a state of what is integrated, in a mode.

        Args:
            y: State of what is integrated.
            u: Inputs, as for `System.evaluate`.
            mode: One entry a row, then those of others.
            undecided: Rows whose mode is looked for.
            is_weighed: Whether `slack` of the solution is needed.
            friction: Share of the coefficients of friction that counts for undecided contacts.
        """
        y = y._replace(mode=mode)
        a = self._motion.accelerate(y, u)
        return self.accelerate(y, a, undecided, is_weighed=is_weighed, friction=friction)

    def row_accelerations(self, y: State, u: Array | None, mode: Mode) -> Array:
        """Return w = g'' of all rows in a mode, shape (n,)."""
        add_forces = self.bound_forces(mode)
        if add_forces is None and not (self._has_no_others and self.is_idle(mode)):
            return self.solve(y, u, mode).w
        y, motion = y._replace(mode=mode), self._motion
        a = motion.accelerate(y, u)
        if add_forces is not None:
            a = add_forces(y, a)
        joint_a = motion.joint_motion(y.q, y.v, a)[2]
        J, b = self._rows.conditions(motion.mechanism.k, self._distances.expand(y))
        return np.asarray((J.dot(joint_a) + b)[self._at])

    def response(
        self, y: State, u: Array | None, chosen: Sequence[int]
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Return J and b with w = J a + b of some rows, and the accelerations that they add.

        Returns:
            J of shape (k, nv of the robot), b of shape (k,), accelerations of all joints by each
            multiplier, shape (nv of the robot, k), smallest and largest multipliers, shape (k,).
        """
        numbers = list(chosen)
        solution = self.solve(y, u, (1,) * len(self.names))
        x, at = self._distances.expand(y), self._at[numbers]
        J, b = self._rows.conditions(self._motion.mechanism.k, x)
        J, b = J[at].copy(), b[at].copy()
        lower, upper = solution.lower[numbers], solution.upper[numbers]
        return J, b, self._motion.respond(y.q, J.T), lower, upper

    def decided_mode(self, solution: RowSolution) -> Mode:
        """Return the mode that a solution with undecided rows says; a tie is active.

        A row that is active without need ends its mode at once.
        """
        above, below = solution.w > solution.slack, solution.w < -solution.slack
        sides = (above.astype(int) - below).tolist()
        if self.contacts is not None:
            modes = self._contact_modes.decided(solution)
            for i, three in zip(self.contacts.normals, modes, strict=True):
                sides[i : i + 3] = three
        return tuple(sides)

    def friction_margins(
        self, measured: Distances, solution: RowSolution, mode: Mode
    ) -> dict[tuple[int, int], float]:
        """Return the margins of the normals and tangents of contacts in a mode."""
        if self.contacts is None:
            return {}
        return self._contact_modes.margins(*self._distances.slips(measured), solution, mode)

    def modes_after(
        self, y: State, u: Array | None, mode: Mode, switch: int, side: int
    ) -> dict[int, int]:
        """Return the modes, by row, with which a switch is left on a side.

        Args:
            y: State of what is integrated, where a margin of the switch is 0.
            u: Inputs there.
            mode: The mode that ends.
            switch: Number of the row.
            side: 1 where it is left at its lower bound, -1 at its upper one.
        """
        contacts = self.contacts
        if contacts is None or not any(i <= switch < i + 3 for i in contacts.normals):
            return {switch: side}
        solution = self.solve(y, u, mode)
        if solution.contacts is None or not solution.contacts.is_shared:
            return self._contact_modes.after(solution.lam, switch)
        touching = self._contact_modes.touching(mode)
        eased = self.solve(y, u, mode, touching, friction=self._contact_modes.eased_friction)
        return self._contact_modes.after_sharing(eased, mode)

    def renamed_slips(
        self, y: State, u: Array | None, mode: Mode, switch: int | None = None
    ) -> dict[int, int]:
        """Return modes of contacts whose slip goes on under another name; empty where none does.

        Args:
            y: State of what is integrated.
            u: Inputs there.
            mode: The present one.
            switch: Tangent of a slip that is slow; None at the start of a step.
        """
        if self.contacts is None or not self._contact_modes.slipping(mode):
            return {}
        if switch is None:
            chosen = self._contact_modes.turned(*self._slips(y), mode)
        elif self.reach[switch] is Reach.FRICTION and mode[switch]:
            chosen = self._contact_modes.slow(*self._slips(y), mode, switch)
        else:
            return {}
        if not chosen:
            return {}
        return self._contact_modes.renamed(self.solve(y, u, mode, is_weighed=True), chosen)

    def slipping_contacts(self, y: State, closed: Collection[int]) -> list[int]:
        """Return the normals of contacts that slip, among those of closed ones."""
        if self.contacts is None:
            return []
        moving = self._contact_modes.moving_normals(*self._slips(y))
        return [i for i in moving if i in closed]

    def _slips(self, y: State) -> tuple[Array, State]:
        return self._distances.slips(self._distances.measure(y))

    def longest_step(self, y: State, u: Array | None, mode: Mode) -> float:
        """Return the length of a step in which no slip of a contact changes by much [s]."""
        if self.contacts is None or not self._contact_modes.may_turn(mode):
            return math.inf
        return self._contact_modes.longest_step(self.solve(y, u, mode), mode)


def _rows_of(blocks: tuple[RowBlock, ...]) -> list[tuple[int, int, RowBlock]]:
    """Return the number of every row, its number in its block, and the block."""
    numbered = ((n, block) for block in blocks for n in range(len(block.rows)))
    return [(i, *entry) for i, entry in enumerate(numbered)]


def bounds_in_mode(
    rows: ConstraintRows, at: NDArray[np.intp], mode: Mode, undecided: Collection[int]
) -> tuple[Array, Array]:
    """Return the smallest and largest multipliers of all rows in a mode, shape (m,) each.

    Args:
        rows: Unilateral and bounded rows.
        at: Which of them are event-driven, shape (n,).
        mode: Begins with one entry each of these.
        undecided: Those whose mode is looked for.
    """
    lower, upper = rows.lower.copy(), rows.upper.copy()
    for i, (row, side) in enumerate(zip(at, mode, strict=False)):
        if i in undecided:
            continue
        if side == 0:
            lower[row], upper[row] = -np.inf, np.inf
        elif side == 1:
            upper[row] = lower[row]
        else:
            lower[row] = upper[row]
    return lower, upper


def is_idle(rows: ConstraintRows, at: NDArray[np.intp], mode: Mode) -> bool:
    """Whether no row exerts a force in a mode, as far as that is known while building.

    Args:
        rows: Unilateral and bounded rows.
        at: Which of them are event-driven, shape (n,).
        mode: Begins with one entry each of these.
    """
    return (
        len(mode) > 0
        and not rows.varies
        and all(side == 1 and rows.lower[i] == 0.0 for side, i in zip(mode, at, strict=False))
    )


def bound_forces(
    motion: Any, rows: ConstraintRows, at: NDArray[np.intp], mode: Mode
) -> AddForces | None:
    """Return the function that adds the forces of rows that all are at a bound.

    Args:
        motion: The `FreeMotion` without the rows.
        rows: Unilateral and bounded rows.
        at: Which of them are event-driven, shape (n,).
        mode: Begins with one entry each of these.

    Returns:
        None where a row has to be solved for, or where none exerts a force.
    """
    n = len(at)
    if len(rows.rows) > n or len(mode) < n or not all(mode[:n]):
        return None
    k, is_at_lower = motion.mechanism.k, np.array(mode[:n]) == 1
    pairs = zip(rows.parts, rows.slices, strict=True)
    constant = np.where(is_at_lower, rows.lower, rows.upper)
    active = [(part, at) for part, at in pairs if rows.varies or constant[at].any()]
    reads = max((part.reads for part, _ in active), default=Reads.NOTHING)

    def add_forces(y: State, a: Array) -> Array:
        joint_q, joint_v, joint_a = motion.joint_motion(y.q, y.v, a)
        x = State(y.t, joint_q, joint_v, y.z)
        k.refresh(joint_q, joint_v, reads)
        lam = constant
        if rows.varies:
            rows.limit(k, x)
            lam = np.where(is_at_lower, rows.lower, rows.upper)
        force = sum(lam[at].dot(part.jacobian(k, x)) for part, at in active)
        response = motion.respond(y.q, np.reshape(force, (-1, 1)))[:, 0]
        return cast(Array, motion.coordinates.integrated(joint_a + response))

    return add_forces if active else None
