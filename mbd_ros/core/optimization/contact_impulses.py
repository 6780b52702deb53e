"""Impulses of a contact with friction beside those of rows between bounds.

Rows between bounds hold, w = 0, or are at a bound. Those that hold leave a problem of the contact
alone, which `cone_contact` solves exactly; which ones do is found by exchange of rows, and where
that does not end, by trying.
"""

import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.optimization.active_set import least_norm
from mbd_ros.core.optimization.bounded_impulses import BoundedImpulses
from mbd_ros.core.optimization.cone_contact import cone_contact
from mbd_ros.core.rows.row_layout import Cone
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import CONTRADICTION, HELD_BY_ROWS, TINY
from mbd_ros.errors import SolveError

_EXCHANGES = 20
_TRIES = 20_000
_FITS = 1.0e-10  # of a rate or an impulse, relative: what may be left of a law
_ROUNDING = 1.0e-11  # of a rate, relative to those that the velocity can mean
Slots = NDArray[np.intp]
Sides = NDArray[np.int8]  # -1 at the lower bound, 1 at the upper one, 0 where w = 0


class _Asked(NamedTuple):
    """Arguments of `ContactImpulses.solve`."""

    b: Array
    lower: Array
    upper: Array
    speed: float


class ContactImpulses:
    """Solves for one contact and the rows between bounds, for one configuration.

    Args:
        A: Rates that impulses add, symmetric, shape (m, m).
        loose: Diagonal of A while no bilateral row holds, shape (m,).
        names: Of the rows, for messages.
        cone: The contact among them; the other rows have bounds.
    """

    def __init__(self, A: Array, loose: Array, names: Sequence[str], cone: Cone) -> None:
        self._A, self._loose, self._names, self._cone = 0.5 * (A + A.T), loose, names, cone
        is_other = np.ones(len(A), dtype=np.bool_)
        is_other[cone.slots] = False
        self._at, self._others = np.flatnonzero(~is_other), np.flatnonzero(is_other)
        self._moves = (A.diagonal() > HELD_BY_ROWS * loose)[self._others]
        chosen = [names[i] for i in self._others.tolist()]
        own = A[np.ix_(self._others, self._others)]
        self._bounded = BoundedImpulses(own, loose[self._others], chosen)

    def solve(self, b: Array, lower: Array, upper: Array, speed: float) -> Array:
        """The impulses, shape (m,), fresh.

        Args:
            b: Rates without them, shape (m,).
            lower: Smallest impulses, that of the normal among them, shape (m,).
            upper: Largest ones of the other rows, shape (m,).
            speed: Velocity in the mass metric.

        Raises:
            SolveError: Nothing keeps a row from moving as it must not, or no impulses are found.
        """
        others, p, asked = self._others, np.zeros(len(b)), _Asked(b, lower, upper, speed)
        if not len(others):
            return self._contact(p, others, asked)
        low, high = lower[others], upper[others]
        p[others] = self._bounded.solve(b[others], low, high, speed)
        sides = _sides(p[others], low, high)
        for _ in range(_EXCHANGES):
            p = self._with(sides, asked)
            w = self._A.dot(p) + b
            if self._fits(p, w, asked):
                return p
            diagonal = np.where(self._moves, self._A.diagonal()[others], 1.0)
            found = _sides(p[others] - w[others] / diagonal, low, high)
            sides = np.where(self._moves, found, sides)
        for choice in self._choices(sides, low, high):
            p = self._with(choice, asked)
            if self._fits(p, self._A.dot(p) + b, asked):
                return p
        name = self._names[self._cone.slots.start]
        raise SolveError(f"no impulses are found for contact {name} and the rows beside it")

    def pushing(self, b: Array, speed: float, least: Array | None = None) -> Array:
        """The impulses of the contact and of rows that only push.

        Args:
            b: As for `solve`.
            speed: As for `solve`.
            least: What they push at least, shape (m,); 0 by default.

        Raises:
            SolveError: As for `solve`.
        """
        none = np.zeros(len(b))
        return self.solve(b, none if least is None else least, none + np.inf, speed)

    def _with(self, sides: Sides, asked: _Asked) -> Array:
        """Impulses with each of the other rows on its side."""
        others, p = self._others, np.zeros(len(asked.b))
        at_bound = np.where(sides < 0, asked.lower[others], asked.upper[others])
        p[others] = np.where(sides == 0, 0.0, at_bound)
        return self._contact(p, others[sides == 0], asked)

    def _contact(self, p: Array, on: Slots, asked: _Asked) -> Array:
        """Completes impulses by those of the contact and of rows with w = 0."""
        A, at = self._A, self._at
        i, rate = int(at[0]), A.dot(p) + asked.b
        own, held = A[np.ix_(at, at)], np.zeros((0, 4))
        if len(on):
            answer = np.column_stack((A[np.ix_(on, at)], rate[on]))
            held = least_norm(A[np.ix_(on, on)], answer)
            own = own - A[np.ix_(at, on)].dot(held[:, :3])
        r = rate[at] - A[np.ix_(at, on)].dot(held[:, 3])
        fastest = float(self._loose[i]) ** 0.5 * asked.speed
        push = np.zeros(3)
        if own[0, 0] > HELD_BY_ROWS * self._loose[i]:
            own = 0.5 * (own + own.T)
            push = cone_contact(own, r, self._cone.mu, float(asked.lower[i]), _ROUNDING * fastest)
        elif r[0] < -CONTRADICTION * fastest:
            raise SolveError(f"nothing can keep constraint row {self._names[i]} from closing")
        p = p.copy()
        p[at], p[on] = push, -held[:, :3].dot(push) - held[:, 3]
        return p

    def _fits(self, p: Array, w: Array, asked: _Asked) -> bool:
        """Whether the laws of the other rows hold; that of the contact does."""
        at = self._others[self._moves]
        size, p, speed = np.sqrt(self._loose[at]), p[at], max(asked.speed, TINY)
        lower, upper, slack = asked.lower[at], asked.upper[at], _FITS * (speed / size + np.abs(p))
        rate = w[at] / (size * speed)
        opens, closes = (rate > _FITS) & (p > lower + slack), (rate < -_FITS) & (p < upper - slack)
        inside = (p >= lower - slack) & (p <= upper + slack)
        return bool((inside & ~opens & ~closes).all())

    def _choices(self, sides: Sides, lower: Array, upper: Array) -> Iterator[Sides]:
        """All sides that rows may be on; none where they are too many."""
        ways = [
            [side for side, may in ((0, True), (-1, low > -np.inf), (1, high < np.inf)) if may]
            if moves
            else [int(side)]
            for side, low, high, moves in zip(sides, lower, upper, self._moves, strict=True)
        ]
        if np.prod([float(len(each)) for each in ways]) <= _TRIES:
            for choice in itertools.product(*ways):
                yield np.array(choice, dtype=np.int8)


def _sides(p: Array, lower: Array, upper: Array) -> Sides:
    """At which bound impulses are."""
    return np.where(p <= lower, -1, np.where(p >= upper, 1, 0)).astype(np.int8)
