"""Contacts with friction and rows between bounds, each in the unit of its own rate.

Normals and tangents of a contact have units of their own, so that A has a diagonal of about one;
the coefficients of friction change with them.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.optimization.cone_newton import Bounds, ConeNewton, Contacts, kept
from mbd_ros.core.optimization.contact_search import searched
from mbd_ros.core.optimization.least_impulses import least_impulses
from mbd_ros.core.rows.row_layout import Cone
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import TINY
from mbd_ros.errors import SolveError

_ENOUGH = 1.0e-14  # of the impulses: what an answer may leave of the natural map
_ACCEPTED = 1.0e-11  # the same of the best one that any way finds
_POLISH = 3  # steps, where impulses of least norm are not as exact
_ROUNDING = 1.0e-14  # of a rate, relative to those that the velocity can mean
_NOTHING = 1.0e-15  # the same of rates that no impulse has to end


class ScaledContacts:
    """Solves for the rows that something moves.

    Args:
        A: Rates that impulses add, of all rows, shape (m, m).
        moves: The rows that are solved for, shape (m,).
        mobile: Rows that something moves; only tangents are solved for beside these, shape (m,).
        names: Of all rows, for messages.
        cones: The contacts among all rows.
    """

    def __init__(
        self,
        A: Array,
        moves: NDArray[np.bool_],
        mobile: NDArray[np.bool_],
        names: Sequence[str],
        cones: Sequence[Cone],
    ) -> None:
        self._at, self._names = moves.nonzero()[0], names
        at, place = self._at, np.cumsum(moves) - 1
        moved = [cone for cone in cones if moves[cone.slots.start]]
        normal = place[[cone.slots.start for cone in moved]].astype(np.intp)
        first, second = normal + 1, normal + 2
        size = np.where(mobile, A.diagonal(), 0.0)[at]
        tangent = np.maximum(size[first], size[second])
        is_free = tangent == 0.0  # nothing moves it along its plane
        size[first] = size[second] = np.where(is_free, 1.0, tangent)
        self._unit = unit = 1.0 / np.sqrt(size)
        mu = np.array([cone.mu for cone in moved]) * unit[normal] / unit[first]
        is_other = np.ones(len(at), dtype=np.bool_)
        is_other[normal] = is_other[first] = is_other[second] = False
        others = is_other.nonzero()[0]
        contacts = Contacts(others, normal, first, second, np.where(is_free, 0.0, mu))
        self._newton = ConeNewton(unit[:, None] * A[np.ix_(at, at)] * unit, contacts)

    def solve(
        self, b: Array, lower: Array, upper: Array, speed: float, warm: Array | None
    ) -> Array:
        """Impulses of the rows that are solved for, fresh.

        Args:
            b: Rates without impulses, of all rows, shape (m,).
            lower: Smallest impulses, shape (m,).
            upper: Largest ones, shape (m,).
            speed: Velocity in the mass metric.
            warm: Impulses to begin with, shape (m,).

        Raises:
            SolveError: No impulses are found.
        """
        at, unit = self._at, self._unit
        b, least = unit * b[at], self._bounds(lower, upper, unit).least
        size = max(float(np.abs(b).max()), float(least.max(initial=0.0)), speed * _NOTHING, TINY)
        unit = size * unit
        b, bounds = b / size, self._bounds(lower, upper, unit)
        start = np.zeros(len(at)) if warm is None else warm[at] / unit
        enough = _ENOUGH + _ROUNDING * speed / size
        p, left = searched(self._newton, b, bounds, start, enough)
        if left > max(_ACCEPTED, enough):
            raise SolveError(self._failed(b, bounds, p))
        p = kept(self._newton.contacts, bounds, p)
        if self._newton.depends:
            p = self._shortest(b, bounds, p)
        answer: Array = unit * p
        return answer

    def _shortest(self, b: Array, bounds: Bounds, p: Array) -> Array:
        """The impulses of least norm that do what p does."""
        newton = self._newton
        seen = newton.see(b, bounds, p)
        exact = _ENOUGH * (1.0 + float(np.abs(p).max()))
        most = max(exact, float(np.abs(seen.left).max()))
        found = least_impulses(newton, seen, bounds, p, self._unit)
        left = float(np.abs(newton.see(b, bounds, found).left).max())
        if left > most:
            found, left = newton.solve(b, bounds, found, _POLISH)
            found = kept(newton.contacts, bounds, found)
        return found if left <= most else p

    def left(self, p: Array, b: Array, lower: Array, upper: Array) -> tuple[float, float]:
        """What impulses leave of the laws: of normals and bounded rows, and of slips [m/s]."""
        at, unit, contacts = self._at, self._unit, self._newton.contacts
        if not len(at):
            return 0.0, 0.0
        seen = self._newton.see(unit * b[at], self._bounds(lower, upper, unit), p[at] / unit)
        rates = np.abs(seen.left) / unit
        slips = np.hypot(rates[contacts.first], rates[contacts.second])
        rates[contacts.first] = rates[contacts.second] = 0.0
        return float(rates.max()), float(slips.max(initial=0.0))

    def _bounds(self, lower: Array, upper: Array, unit: Array) -> Bounds:
        at, contacts = self._at, self._newton.contacts
        lower, upper = lower[at] / unit, upper[at] / unit
        return Bounds(lower[contacts.others], upper[contacts.others], lower[contacts.normal])

    def _failed(self, b: Array, bounds: Bounds, p: Array) -> str:
        """What is wrong with the best impulses."""
        off = np.abs(self._newton.see(b, bounds, p).left)
        worst, left = self._names[self._at[int(off.argmax())]], float(off.max())
        return (
            f"no impulses are found for contacts and the rows beside them: the best ones leave "
            f"{left:.1e} of the rates, most at row {worst}"
        )
