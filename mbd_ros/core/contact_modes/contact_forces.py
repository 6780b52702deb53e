"""Multipliers of contacts at one state, beside those of the rows around them.

In a mode they are what its equations ask for, A lam + w = 0 of what is on, of any sign: so events
are located from smooth motions. Where modes are looked for, and where contacts share a force that
equations do not split, they keep the laws of contact. Among equal ones they have the smallest
norm.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.complementarity.contact_problem import ContactProblem
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
    """Finds the multipliers of all rows that give way.

    Attributes:
        split: How the last ones were found.
        grip: Share of the coefficients of friction that counts where modes are looked for.
    """

    def __init__(self, rows: ConstraintRows) -> None:
        self._cones = rows.cones
        self._names = [row.name for row in rows.rows]
        self._starts = np.array([cone.slots.start for cone in rows.cones], dtype=np.intp)
        self._of_contacts = (self._starts[:, None] + (0, 1, 2)).ravel()
        self._mu = np.array([cone.mu for cone in rows.cones])
        self.split = Split.ONE
        self.grip = 1.0

    def solve(
        self,
        A: Array,
        w: Array,
        bounds: tuple[Array, Array],
        touches: Sequence[Touch],
        *,
        splits: bool = True,
    ) -> Array:
        """The multipliers, shape (m,), fresh.

        Args:
            A: Rates w that multipliers add, shape (m, m).
            w: Those without them, shape (m,).
            bounds: Smallest and largest multipliers; those of contacts follow from `touches`.
            touches: One entry a contact.
            splits: Whether it matters how contacts that stick share their force.

        Raises:
            SolveError: The rows that are on contradict one another, or no forces are found.
        """
        lower, upper = bounds[0].copy(), bounds[1].copy()
        for start, touch in zip(self._starts.tolist(), touches, strict=True):
            self._bound(lower, upper, start, touch)
        self.split = Split.ONE
        if Touch.MAY in touches or Touch.MAY_SLIP in touches:
            return self.lawful(A, w, lower, upper, touches)
        unit = self._units(A)
        on = np.isinf(lower) & np.isinf(upper)
        if not (on | (lower == upper)).all():
            return _exchanged(A, w, lower, upper, unit)
        lam = self._balanced(A, w, np.where(on, 0.0, lower), on, unit)
        if self.split is Split.ONE or not (splits or Touch.SLIPS in touches):
            return lam
        if self.is_lawful(lam):
            return lam
        return self._shared(lam, A, w, bounds, touches)

    def lawful(
        self,
        A: Array,
        w: Array,
        lower: Array,
        upper: Array,
        touches: Sequence[Touch],
    ) -> Array:
        """The multipliers that keep all laws, shape (m,).

        Args:
            A: As for `solve`.
            w: As for `solve`.
            lower: Smallest multipliers, those of contacts that may touch too, shape (m,).
            upper: Largest ones, shape (m,).
            touches: One entry a contact.

        Raises:
            SolveError: There are none.
        """
        acts = lower < upper
        for start, touch in zip(self._starts.tolist(), touches, strict=True):
            acts[start + 1 : start + 3] |= touch is Touch.MAY
        on = np.flatnonzero(acts)
        first = np.searchsorted(on, self._starts).tolist()
        cones = tuple(
            cone._replace(slots=slice(at, at + 3), mu=self.grip * cone.mu)
            for cone, at, touch in zip(self._cones, first, touches, strict=True)
            if touch is Touch.MAY
        )
        lam = np.where(acts, 0.0, lower)
        own, rate = A[np.ix_(on, on)], (w + A.dot(lam))[on]
        size = np.abs(own.diagonal())
        speed = float((np.abs(rate) / np.sqrt(np.where(size > 0.0, size, 1.0))).max(initial=0.0))
        names = [self._names[i] for i in on]
        try:
            problem = ContactProblem(own, own.diagonal(), names, cones)
            lam[on] = problem.solve(rate, lower[on], upper[on], speed)
        except SolveError as error:
            slips = [at for at, touch in zip(first, touches, strict=True) if touch in _SLIPS]
            if slips and _jams(own[np.ix_(slips, slips)]):
                where = ", ".join(names[at] for at in slips)
                raise JammedError(
                    f"friction leaves {where} no consistent acceleration (Painlevé)"
                ) from error
            raise
        return lam

    def _shared(
        self, lam: Array, A: Array, w: Array, bounds: tuple[Array, Array], touches: Sequence[Touch]
    ) -> Array:
        """A share of the same force among contacts that keeps their laws, if there is one."""
        may = [_LAWS.get(touch, touch) for touch in touches]
        lower, upper = bounds[0].copy(), bounds[1].copy()
        for start, touch in zip(self._starts.tolist(), may, strict=True):
            self._bound(lower, upper, start, touch)
        self.split = Split.NONE
        try:
            found = self.lawful(A, w, lower, upper, may)
        except SolveError:
            return lam
        left, terms = A.dot(found) + w, np.abs(A).dot(np.abs(found)) + np.abs(w)
        size = np.sqrt(np.abs(A.diagonal()))
        terms += size * (size * np.abs(found)).max()  # rounding of forces that cancel there
        on = np.zeros(len(w), dtype=np.bool_)
        for start, touch in zip(self._starts.tolist(), touches, strict=True):
            on[start : start + 3] = touch is Touch.STICKS
            on[start] |= touch is Touch.SLIPS
        if (np.abs(left) > TIE * terms)[on].any():
            return lam
        self.split = Split.LAWFUL
        return found

    def _balanced(
        self, A: Array, w: Array, bound: Array, on: NDArray[np.bool_], unit: Array
    ) -> Array:
        """The multipliers with w = 0 of rows that are on; the smallest where they are several."""
        lam, rows = np.where(on, 0.0, bound), np.flatnonzero(on)
        if not len(rows):
            return lam
        right = (w + A.dot(lam))[rows]
        found, is_split = least_balanced(A[np.ix_(rows, rows)], right, unit[rows])
        if is_split:
            self.split = Split.LEAST
        lam[rows] = found
        return lam

    def is_lawful(self, lam: Array) -> bool:
        """Whether multipliers of contacts that touch push, inside their cones."""
        push = lam[self._of_contacts].reshape(-1, 3)
        slack = _WITHIN * float(np.abs(push).max(initial=0.0))
        friction = np.sqrt(np.einsum("ij,ij->i", push[:, 1:], push[:, 1:]))
        return bool((np.maximum(friction, 0.0) <= self._mu * push[:, 0] + slack).all())

    def _units(self, A: Array) -> Array:
        """Multipliers that change the rates of rows about alike, shape (m,)."""
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


def _exchanged(A: Array, w: Array, lower: Array, upper: Array, unit: Array) -> Array:
    """Multipliers of rows that hold or are at a bound, for any A."""
    still = A.diagonal() == 0.0
    scaled = unit[:, None] * A * unit + np.diag(np.where(still, 1.0, 0.0))
    found = exchanged(scaled, unit * w, lower / unit, upper / unit, solve=least_norm)
    if found is None:
        raise SolveError("no forces are found for a contact that slips and the rows beside it")
    return unit * found


def _jams(A: Array) -> bool:
    """Whether normal forces of slips may have no solution: A is not a P-matrix.

    Source: F. Génot, B. Brogliato, New results on Painlevé paradoxes, Eur. J. Mech. A 18, 1999.
    """
    n = len(A)
    minors = (s for k in range(1, n + 1) for s in itertools.combinations(range(n), k))
    return any(np.linalg.det(A[np.ix_(s, s)]) <= 0.0 for s in itertools.islice(minors, _MINORS))


class Split(Enum):
    """Whether equations alone say how contacts share their forces."""

    ONE = "one"
    LEAST = "least"  # they do not, and the least norm keeps the laws
    LAWFUL = "lawful"  # another share of them does
    NONE = "none"  # none does: the mode is over
