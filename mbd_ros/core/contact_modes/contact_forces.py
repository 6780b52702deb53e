"""Multipliers of contacts and of the rows beside them at one state.

In a known mode the multipliers solve its equations, A lam + w = 0 of the active rows, with any
sign: events are then located from smooth motions. Where the mode is looked for, and where contacts
share a force that equations do not split, the multipliers obey the laws of contact. Among several
solutions the one of the smallest norm is taken.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.complementarity.contact_problem import ContactProblem
from mbd_ros.core.contact_modes.row_solution import Split
from mbd_ros.core.optimization.box_qp import exchanged, least_norm
from mbd_ros.core.optimization.least_norm import least_balanced
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import TIE, ZERO_ROW
from mbd_ros.errors import JammedError, SolveError

_MINORS = 4096  # that are looked at
_WITHIN = 1.0e-12  # of the largest multiplier: by which a law may be passed


class Touch(Enum):
    """How a contact touches at a state."""

    OPEN = "open"
    STICKS = "sticks"
    SLIPS = "slips"
    MAY_SLIP = "may slip"  # it slips, or opens
    MAY = "may"  # it opens, sticks or begins to slip


_SLIPS = Touch.SLIPS, Touch.MAY_SLIP
_LAWS = {Touch.STICKS: Touch.MAY, Touch.SLIPS: Touch.MAY_SLIP}


class ContactForces:
    """Solves for the multipliers of all unilateral and bounded rows, contacts among them."""

    def __init__(self, rows: ConstraintRows) -> None:
        self._cones = rows.cones
        self._names = [row.name for row in rows.rows]
        self._starts = np.array([cone.slots.start for cone in rows.cones], dtype=np.intp)
        self._of_contacts = (self._starts[:, None] + (0, 1, 2)).ravel()
        self._mu = np.array([cone.mu for cone in rows.cones])

    def solve(
        self,
        A: Array,
        w: Array,
        bounds: tuple[Array, Array],
        touches: Sequence[Touch],
        *,
        splits: bool = True,
        friction: float = 1.0,
    ) -> tuple[Array, Split]:
        """Return the multipliers, shape (m,), fresh, and how contacts share their forces.

        Args:
            A: Rates w that multipliers add, shape (m, m).
            w: Those without them, shape (m,).
            bounds: Smallest and largest multipliers; those of contacts follow from `touches`.
            touches: One entry a contact.
            splits: Whether it matters how contacts that stick share their force.
            friction: Share of the coefficients of friction that counts for undecided contacts.

        Raises:
            SolveError: The active rows contradict one another, or no forces are found.
        """
        lower, upper = bounds[0].copy(), bounds[1].copy()
        for start, touch in zip(self._starts.tolist(), touches, strict=True):
            self._bound(lower, upper, start, touch)
        if Touch.MAY in touches or Touch.MAY_SLIP in touches:
            return self._solve_laws(A, w, lower, upper, touches, friction), Split.ONE
        unit = self._units(A)
        is_active = np.isinf(lower) & np.isinf(upper)
        if not (is_active | (lower == upper)).all():
            return _exchange(A, w, lower, upper, unit), Split.ONE
        lam, is_split = _balance(A, w, np.where(is_active, 0.0, lower), is_active, unit)
        if not is_split:
            return lam, Split.ONE
        if not (splits or Touch.SLIPS in touches) or self.is_lawful(lam):
            return lam, Split.LEAST
        return self._share(lam, A, w, bounds, touches)

    def _solve_laws(
        self,
        A: Array,
        w: Array,
        lower: Array,
        upper: Array,
        touches: Sequence[Touch],
        friction: float,
    ) -> Array:
        """Return the multipliers that keep the laws of all contacts, shape (m,).

        Raises:
            SolveError: There are none.
        """
        acts = lower < upper
        for start, touch in zip(self._starts.tolist(), touches, strict=True):
            acts[start + 1 : start + 3] |= touch is Touch.MAY
        on = np.flatnonzero(acts)
        first = np.searchsorted(on, self._starts).tolist()
        cones = tuple(
            cone._replace(slots=slice(at, at + 3), mu=friction * cone.mu)
            for cone, at, touch in zip(self._cones, first, touches, strict=True)
            if touch is Touch.MAY
        )
        lam = np.where(acts, 0.0, lower)
        delassus, rate = A[np.ix_(on, on)], (w + A.dot(lam))[on]
        size = np.abs(delassus.diagonal())
        speed = float((np.abs(rate) / np.sqrt(np.where(size > 0.0, size, 1.0))).max(initial=0.0))
        names = [self._names[i] for i in on]
        try:
            problem = ContactProblem(delassus, delassus.diagonal(), names, cones)
            lam[on] = problem.solve(rate, lower[on], upper[on], speed)
        except SolveError as error:
            slips = [at for at, touch in zip(first, touches, strict=True) if touch in _SLIPS]
            if slips and _jams(delassus[np.ix_(slips, slips)]):
                where = ", ".join(names[at] for at in slips)
                raise JammedError(
                    f"friction leaves {where} no consistent acceleration (Painlevé)"
                ) from error
            raise
        return lam

    def _share(
        self, lam: Array, A: Array, w: Array, bounds: tuple[Array, Array], touches: Sequence[Touch]
    ) -> tuple[Array, Split]:
        """Share the same force among contacts so that their laws hold, if there is a way to."""
        may = [_LAWS.get(touch, touch) for touch in touches]
        lower, upper = bounds[0].copy(), bounds[1].copy()
        for start, touch in zip(self._starts.tolist(), may, strict=True):
            self._bound(lower, upper, start, touch)
        try:
            shared = self._solve_laws(A, w, lower, upper, may, 1.0)
        except SolveError:
            return lam, Split.NONE
        end, terms = A.dot(shared) + w, np.abs(A).dot(np.abs(shared)) + np.abs(w)
        size = np.sqrt(np.abs(A.diagonal()))
        terms += size * (size * np.abs(shared)).max()  # rounding of forces that cancel there
        is_active = np.zeros(len(w), dtype=np.bool_)
        for start, touch in zip(self._starts.tolist(), touches, strict=True):
            is_active[start : start + 3] = touch is Touch.STICKS
            is_active[start] |= touch is Touch.SLIPS
        if (np.abs(end) > TIE * terms)[is_active].any():
            return lam, Split.NONE
        return shared, Split.LAWFUL

    def is_lawful(self, lam: Array) -> bool:
        """Whether all contacts that touch push, with forces inside their cones."""
        push = lam[self._of_contacts].reshape(-1, 3)
        slack = _WITHIN * float(np.abs(push).max(initial=0.0))
        friction = np.sqrt(np.einsum("ij,ij->i", push[:, 1:], push[:, 1:]))
        return bool((np.maximum(friction, 0.0) <= self._mu * push[:, 0] + slack).all())

    def _units(self, A: Array) -> Array:
        """Return the multipliers that change the rates of rows about alike, shape (m,)."""
        size = np.abs(A.diagonal())
        each = size[self._of_contacts].reshape(-1, 3)
        each[:, 0] = each.max(axis=1)  # friction may take from the normal what it moves
        size[self._of_contacts] = each.ravel()
        still = size <= ZERO_ROW * float(size.max(initial=0.0))
        return np.asarray(1.0 / np.sqrt(np.where(still, 1.0, size)))

    @staticmethod
    def _bound(lower: Array, upper: Array, start: int, touch: Touch) -> None:
        """Set the bounds of the three rows of a contact."""
        lower[start : start + 3], upper[start : start + 3] = 0.0, 0.0
        if touch is Touch.STICKS:
            lower[start : start + 3], upper[start : start + 3] = -np.inf, np.inf
        elif touch is Touch.SLIPS:
            lower[start], upper[start] = -np.inf, np.inf
        elif touch is not Touch.OPEN:
            upper[start] = np.inf


def _balance(
    A: Array, w: Array, bound: Array, is_active: NDArray[np.bool_], unit: Array
) -> tuple[Array, bool]:
    """Return multipliers with A lam + w = 0 of the active rows, and whether there are several.

    Among several they are those of the smallest norm.
    """
    lam, rows = np.where(is_active, 0.0, bound), np.flatnonzero(is_active)
    if not len(rows):
        return lam, False
    right = (w + A.dot(lam))[rows]
    lam[rows], is_split = least_balanced(A[np.ix_(rows, rows)], right, unit[rows])
    return lam, is_split


def _exchange(A: Array, w: Array, lower: Array, upper: Array, unit: Array) -> Array:
    """Return multipliers of rows that are active or at a bound, for any A."""
    still = A.diagonal() == 0.0
    scaled = unit[:, None] * A * unit + np.diag(np.where(still, 1.0, 0.0))
    lam = exchanged(scaled, unit * w, lower / unit, upper / unit, solve=least_norm)
    if lam is None:
        raise SolveError(
            "no forces were found for a contact that slips and the constraints beside it"
        )
    return unit * lam


def _jams(A: Array) -> bool:
    """Whether normal forces of slips may have no solution: A is not a P-matrix.

    Source: F. Génot, B. Brogliato, New results on Painlevé paradoxes, Eur. J. Mech. A 18, 1999.
    """
    n = len(A)
    minors = (s for k in range(1, n + 1) for s in itertools.combinations(range(n), k))
    return any(np.linalg.det(A[np.ix_(s, s)]) <= 0.0 for s in itertools.islice(minors, _MINORS))
