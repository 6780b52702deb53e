"""Impulses of contacts with friction beside those of rows between bounds, exactly.

    w = A p + b
    contacts:             p_n >= least,   w_n >= 0,   (p_n - least) w_n = 0,   |p_t| <= mu p_n
                          w_t = -alpha p_t,   alpha >= 0,   alpha = 0 where |p_t| < mu p_n
    rows between bounds:  lower <= p <= upper, w = 0 inside, w >= 0 at lower, w <= 0 at upper

The laws are those of Signorini and Coulomb, the cones are round. p may be impulses and w
velocities, or forces and accelerations. A may be singular, as four feet of one box make it: p is
then of least norm. It is not symmetric where rows push along other directions than they hold.
Every answer is checked by what it leaves of the laws.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.optimization.cone_contact import cone_contact
from mbd_ros.core.optimization.scaled_contacts import ScaledContacts
from mbd_ros.core.rows.row_layout import Cone
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import CONTRADICTION, HELD_BY_ROWS
from mbd_ros.errors import SolveError

_ROUNDING = 1.0e-11  # of a rate, relative to those that the velocity can mean


class Residuals(NamedTuple):
    """How far impulses are from the laws, recomputed from them.

    Attributes:
        primal: Largest rate that the laws of normals and of rows between bounds forbid [m/s].
        dual: Largest impulse beyond its bounds [N·s].
        cone: Largest friction beyond its cone [N·s].
        correction: Largest slip that is not against its friction, or that friction inside of its
            cone leaves [m/s].
    """

    primal: float
    dual: float
    cone: float
    correction: float


class ContactProblem:
    """Solves the problem above for one configuration.

    Args:
        A: Rates that impulses add, shape (m, m).
        loose: Diagonal of A while no bilateral row holds, shape (m,).
        names: Of the rows, for messages.
        cones: The contacts among them, by their slots; the other rows have bounds.
    """

    def __init__(
        self, A: Array, loose: Array, names: Sequence[str], cones: Sequence[Cone]
    ) -> None:
        self._A, self._loose, self._names, self._cones = A, loose, names, tuple(cones)
        self._mobile = A.diagonal() > HELD_BY_ROWS * loose
        self._moves = self._mobile.copy()
        for cone in cones:  # no friction where nothing moves the normal
            self._moves[cone.slots] = self._mobile[cone.slots.start]
        is_one = len(A) == 3 and len(cones) == 1 and self._moves[0]
        self._only = self._cones[0].mu if is_one else None
        self._scaled: ScaledContacts | None = None
        self._answered = np.zeros((4, len(A)))

    def solve(
        self,
        b: Array,
        lower: Array,
        upper: Array,
        speed: float,
        late: Array | None = None,
        warm: Array | None = None,
    ) -> Array:
        """The impulses, shape (m,), fresh.

        Args:
            b: Rates without them, shape (m,).
            lower: Smallest impulses, those of normals among them, shape (m,).
            upper: Largest ones of rows between bounds, shape (m,).
            speed: Velocity in the mass metric, which no rate exceeds by much.
            late: What rates have more in the laws than in b, shape (m,): 0 but at tangents, where
                friction is against the slip of another time.
            warm: Impulses to begin with, shape (m,); none by default.

        Raises:
            SolveError: Nothing keeps a row from moving as it must not, or no impulses are found.
        """
        if late is not None:
            b = b + late
        p = self._unmoved(b, lower, upper, speed)
        if self._only is not None:
            rounding = _ROUNDING * speed * float(self._loose[0]) ** 0.5
            p = cone_contact(self._A, b, self._only, float(lower[0]), rounding)
        elif self._moves.any():
            p[self._moves] = self._problem().solve(b, lower, upper, speed, warm)
        self._answered = np.array((p, b, lower, upper))
        return p

    def pushing(self, b: Array, speed: float, least: Array | None = None) -> Array:
        """The impulses of contacts and of rows that only push.

        Args:
            b: As for `solve`.
            speed: As for `solve`.
            least: What they push at least, shape (m,); 0 by default.

        Raises:
            SolveError: As for `solve`.
        """
        none = np.zeros(len(b))
        return self.solve(b, none if least is None else least, none + np.inf, speed)

    @property
    def residuals(self) -> Residuals:
        """What the last answer leaves of the laws; rows that nothing moves leave nothing."""
        p, b, lower, upper = self._answered
        beyond = np.maximum(lower - p, p - upper)
        for cone in self._cones:
            beyond[cone.slots.start + 1 : cone.slots.stop] = 0.0
        dual = max(float(beyond.max(initial=0.0)), 0.0)
        over = [
            float(np.hypot(*p[cone.slots][1:])) - cone.mu * float(p[cone.slots.start])
            for cone in self._cones
        ]
        primal, correction = self._problem().left(p, b, lower, upper)
        return Residuals(primal, dual, max(0.0, *over), correction)

    def _problem(self) -> ScaledContacts:
        """The rows that something moves."""
        if self._scaled is None:
            self._scaled = ScaledContacts(
                *(self._A, self._moves, self._mobile, self._names, self._cones)
            )
        return self._scaled

    def _unmoved(self, b: Array, lower: Array, upper: Array, speed: float) -> Array:
        """Impulses of rows that nothing moves; 0 for the others."""
        p = np.zeros(len(b))
        if self._moves.all():
            return p
        size = np.sqrt(np.where(self._loose > 0.0, self._loose, 1.0)) * speed
        none = self._moves | (np.abs(b) <= CONTRADICTION * size)
        for cone in self._cones:
            none[cone.slots.start + 1 : cone.slots.stop] = True
        p = np.where(none, 0.0, np.where(b < 0.0, upper, lower))
        if not np.isfinite(p).all():
            name = self._names[int(np.isfinite(p).argmin())]
            raise SolveError(f"nothing can keep constraint row {name} from closing")
        return p
