"""Contacts with friction and rows between bounds, each in the unit of its own rate.

Normals and tangents of a contact have units of their own, so that A has a diagonal of about one;
the coefficients of friction change with them.
"""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.complementarity.cone_newton import Bounds, ConeNewton, Contacts, kept
from mbd_ros.core.complementarity.contact_solvers import searched
from mbd_ros.core.complementarity.least_norm_impulses import least_impulses
from mbd_ros.core.rows.row_layout import Cone
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import CONTRADICTION, HELD_BY_ROWS, TINY
from mbd_ros.errors import SolveError

_ENOUGH = 1.0e-14  # of the impulses: what an answer may leave of the natural map
EXACT = 1.0e-11  # the same of the best one that any way finds, unless more is accepted
_POLISH = 3  # steps, where impulses of least norm are not as exact
_ROUNDING = 1.0e-14  # of a rate, relative to those that the velocity can mean
_NOTHING = 1.0e-15  # the same of rates that no impulse has to end


class ScaledContacts:
    """As `ContactProblem`, in units of the rows.

    Rows that nothing moves exert what their bounds say and change nothing, and where nothing moves
    a normal there is no friction.

    Args:
        A: Rates that impulses add, shape (m, m).
        loose: Diagonal of A while no bilateral row holds, shape (m,).
        names: Of the rows, for messages.
        cones: The contacts among them.
    """

    def __init__(
        self, A: Array, loose: Array, names: Sequence[str], cones: Sequence[Cone]
    ) -> None:
        self._loose, self._names = loose, names
        mobile = A.diagonal() > HELD_BY_ROWS * loose
        self._moves = moves = mobile.copy()
        self._pulls_nothing = np.zeros(len(A), dtype=np.bool_)
        for cone in cones:
            moves[cone.slots] = mobile[cone.slots.start]
            self._pulls_nothing[cone.slots.start + 1 : cone.slots.stop] = True
        self._at, place = moves.nonzero()[0], moves.cumsum() - 1
        at = self._at
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
        self._newton = ConeNewton(unit[:, None] * A.take(at, 0).take(at, 1) * unit, contacts)

    def solve(
        self,
        b: Array,
        lower: Array,
        upper: Array,
        speed: float,
        warm: Array | None,
        accepted: float,
        *,
        shared: bool,
    ) -> Array:
        """The impulses, shape (m,), fresh.

        Args:
            b: Rates without impulses, shape (m,).
            lower: Smallest impulses, shape (m,).
            upper: Largest ones, shape (m,).
            speed: Velocity in the mass metric.
            warm: Impulses to begin with, shape (m,).
            accepted: What an answer may leave of the laws where none leaves rounding alone.
            shared: Whether those that depend on one another are of least norm.

        Raises:
            SolveError: Nothing keeps a row from closing, or no impulses are found.
        """
        answer = self._unmoved(b, lower, upper, speed)
        if not len(self._at):
            return answer
        at, unit = self._at, self._unit
        b, least = unit * b[at], self._bounds(lower, upper, unit).least
        size = max(float(np.abs(b).max()), float(least.max(initial=0.0)), speed * _NOTHING, TINY)
        unit = size * unit
        b, bounds = b / size, self._bounds(lower, upper, unit)
        start = np.zeros(len(at)) if warm is None else warm[at] / unit
        enough = _ENOUGH + _ROUNDING * speed / size
        p, left = searched(self._newton, b, bounds, start, (enough, accepted))
        if left > enough:
            self._newton.seen = self._newton.see(b, bounds, p)
        if left > max(accepted, enough):
            raise SolveError(self._failed())
        p = kept(self._newton.contacts, bounds, self._newton.seen, p)
        if shared and self._newton.depends and p.any():
            p = self._shortest(b, bounds, p)
        answer[at] = unit * p
        return answer

    def _unmoved(self, b: Array, lower: Array, upper: Array, speed: float) -> Array:
        """Impulses of rows that nothing moves; 0 for the others."""
        p = np.zeros(len(b))
        if len(self._at) == len(b):
            return p
        length = np.sqrt(np.where(self._loose > 0.0, self._loose, 1.0))
        none = self._moves | self._pulls_nothing
        none |= np.abs(b) <= CONTRADICTION * length * speed
        p = np.where(none, 0.0, np.where(b < 0.0, upper, lower))
        if not np.isfinite(p).all():
            name = self._names[int(np.isfinite(p).argmin())]
            raise SolveError(f"nothing can keep constraint row {name} from closing")
        return p

    def _shortest(self, b: Array, bounds: Bounds, p: Array) -> Array:
        """The impulses of least norm that do what p does."""
        newton = self._newton
        seen = newton.seen
        exact = _ENOUGH * (1.0 + float(np.abs(p).max()))
        most = max(exact, float(np.abs(seen.left).max()))
        found = least_impulses(newton, seen, bounds, p, self._unit)
        left = float(np.abs(newton.see(b, bounds, found).left).max())
        if left > most:
            found, left = newton.solve(b, bounds, found, _POLISH)
            found = kept(newton.contacts, bounds, newton.seen, found)
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

    def _failed(self) -> str:
        """What is wrong with the best impulses."""
        off = np.abs(self._newton.seen.left)
        worst, left = self._names[self._at[int(off.argmax())]], float(off.max())
        return (
            f"no impulses are found for contacts and the rows beside them: the best ones leave "
            f"{left:.1e} of the rates, most at row {worst}"
        )
