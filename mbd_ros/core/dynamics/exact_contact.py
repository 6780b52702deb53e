"""A contact with friction among rows that give way at events: open, sticking or slipping.

Sticking, its normal and tangents are three equations. Slipping, friction is mu times the normal
force against the slip velocity: the normal alone is an equation, and pushes along

    D = n - mu d' t,   d = v_t / |v_t|

so that the mobility J M^-1 D' is not symmetric. Modes of the tangents are 0 while it sticks, 1
while it is open, and else two odd numbers along d: they say on which side of v_t = 0 a slip goes
on, so that forces are smooth up to the end of the slip and beyond. Source: F. Pfeiffer, C.
Glocker, Multibody Dynamics with Unilateral Contacts, 1996, ch. 5.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.model.kinematics import Kinematics
from mbd_ros.core.optimization.active_set import least_norm, on_active_set
from mbd_ros.core.optimization.box_qp import exchanged
from mbd_ros.core.optimization.contact_problem import ContactProblem
from mbd_ros.core.row_laws import Kind
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.core.thresholds import CONTRADICTION, ON_SURFACE, ZERO_ROW
from mbd_ros.errors import SolveError

OPEN: Mode = (1, 1, 1)
STICKS: Mode = (0, 0, 0)
_TURNED = 0.8  # cosine of the angle from which a direction is named anew
_NO_SLIP = 100.0 * ON_SURFACE  # of 1 + the largest velocity: how slow a slip may end


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


class ExactContact:
    """The contact of a scene among all of its rows that give way.

    Args:
        rows: The rows.

    Attributes:
        rows: Where its normal and tangents stand among them.
        slipping: Its slip velocity in the last solve, shape (2,); None where it was none.
    """

    def __init__(self, rows: ConstraintRows) -> None:
        self.slipping: Array | None = None
        self._part = next(b.part for b in rows.blocks if b.law.kind is Kind.CONE)
        cone, *self._others = rows.cones
        self._cone, self.rows, self._mu = cone, cone.slots, cone.mu
        self._constraints, self._names = rows, [row.name for row in rows.rows]
        self._tangents = slice(self.rows.start + 1, self.rows.stop)

    def solve(
        self,
        motion: Any,
        q: Array,
        x: State,
        a: Array,
        bounds: tuple[Array, Array],
        mode: Mode,
        *,
        is_open: bool,
    ) -> Solved:
        """Multipliers and accelerations in a mode of the contact.

        Args:
            motion: The `FreeMotion` without rows that give way.
            q: Integrated configuration.
            x: State of all joints, with k refreshed.
            a: Accelerations of all joints without the rows.
            bounds: Smallest and largest multipliers of all rows.
            mode: Of its normal and tangents; empty where it is looked for, beside the other rows.
            is_open: Whether it is too far away to touch.

        Raises:
            SolveError: The rows that are on contradict one another, or no forces are found.
        """
        if self._others:
            names = ", ".join(cone.name for cone in (self._cone, *self._others))
            raise SolveError(f"accelerations of several contacts with friction: {names}")
        k = motion.mechanism.k
        J, b = self._constraints.conditions(k, x)
        slip, d = self.slip(k, x), None
        slips = not is_open and (not mode or any(mode[1:]))
        self.slipping = slip if math.hypot(*slip) > slowest(x) else None
        if slips and self.slipping is not None:
            d = self._along(slip, mode)
        D = J if d is None else self._pushes(J, d)
        response = motion.respond(q, D.T)
        A, w = J.dot(response), J.dot(a) + b
        lam = self._touching(A, w, bounds) if slips and d is None else _answer(A, w, *bounds)
        left, terms = A.dot(lam) + w, np.abs(A).dot(np.abs(lam)) + np.abs(w)
        force, added = D.T.dot(lam), response.dot(lam)
        if d is not None:
            lam[self._tangents] = -self._mu * lam[self.rows.start] * d
        return Solved(lam, force, added, left, terms)

    def slip(self, k: Kinematics, x: State) -> Array:
        """The velocity v_t of the point along the plane, shape (2,)."""
        velocity: Array = self._part.jacobian(k, x).dot(x.v) + self._part.rate(k, x)
        return velocity[1:]

    def found(self, left: Array, slack: Array) -> Mode:
        """Mode that the last solve found, for the w of the contact and what counts as none."""
        if left[0] > slack[0]:
            return OPEN
        if self.slipping is not None:
            return 0, *side(self.slipping)
        if math.hypot(*left[1:]) <= slack[1:].max():
            return STICKS
        return 0, *side(left[1:])

    def left(self, lam: Array, *, opens: bool) -> Mode:
        """Mode after it opens or begins to slip, for the multipliers of the contact."""
        return OPEN if opens else (0, *side(-lam[1:]))

    def margin(self, lam: Array) -> float:
        """How far friction is from its largest, for the multipliers of the contact."""
        return self._mu * float(lam[0]) - math.hypot(*lam[1:])

    def turned(self, k: Kinematics, x: State, mode: Mode) -> Mode:
        """The mode of a slip, named anew where its direction has turned far."""
        slip = self.slip(k, x)
        size = math.hypot(*slip)
        if size <= slowest(x) or slip.dot(mode[1:]) >= _TURNED * size * math.hypot(*mode[1:]):
            return mode
        return 0, *side(slip)

    def _along(self, slip: Array, mode: Mode) -> Array:
        """Direction of a slip, on the side that the mode names."""
        d = slip / math.hypot(*slip)
        return -d if mode and d.dot(mode[1:]) < 0.0 else d

    def _pushes(self, J: Array, d: Array) -> Array:
        """D: the normal with friction, shape (m, nv)."""
        D, normal = J.copy(), self.rows.start
        D[normal] -= self._mu * d.dot(J[self._tangents])
        return D

    def _touching(self, A: Array, w: Array, bounds: tuple[Array, Array]) -> Array:
        """Multipliers where the point does not slip yet: it may open, stick or begin to slip."""
        diagonal = A.diagonal()
        size = np.where(diagonal > 0.0, diagonal, 1.0)
        speed = float((np.abs(w) / np.sqrt(size)).max())
        contacts = ContactProblem(A, diagonal, self._names, [self._cone])
        lower, upper = bounds
        at_least = lower.copy()
        at_least[self.rows] = 0.0
        return contacts.solve(w, at_least, upper, speed)


def side(slip: Array) -> tuple[int, int]:
    """Two odd numbers along a slip, which name its direction in a mode."""
    size = math.hypot(*slip)
    first, second = (min(2 * math.floor(2.0 * float(each) / size) + 1, 3) for each in slip)
    return first, second


def slowest(x: State) -> float:
    """Slip velocity that counts as none."""
    return _NO_SLIP * (1.0 + float(np.abs(x.v).max()))


def _answer(A: Array, w: Array, lower: Array, upper: Array) -> Array:
    """Multipliers of rows that hold or are at a bound, for any A."""
    diagonal = A.diagonal()
    unmoved = diagonal <= ZERO_ROW * float(np.abs(diagonal).max())
    unit = 1.0 / np.sqrt(np.where(unmoved, 1.0, diagonal))
    scaled = unit[:, None] * A * unit + np.diag(np.where(unmoved, 1.0, 0.0))
    w, lower, upper = unit * w, lower / unit, upper / unit
    on = np.isinf(lower) & np.isinf(upper)
    if (on | (lower == upper)).all():  # equations alone, which may depend on one another
        lam = on_active_set(scaled, w, np.where(on, 0.0, lower), on, least_norm)
        left = np.abs(scaled.dot(lam) + w)[on].max(initial=0.0)
        terms = np.abs(scaled).dot(np.abs(lam)) + np.abs(w)
        if left <= CONTRADICTION * terms.max():
            return unit * lam
        raise SolveError("rows of a contact and those beside it contradict one another")
    found = exchanged(scaled, w, lower, upper, solve=least_norm)
    if found is None:
        raise SolveError("no forces are found for a contact that slips and the rows beside it")
    return unit * found
