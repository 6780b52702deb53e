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

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.complementarity.cone_contact import cone_contact, cone_residuals
from mbd_ros.core.complementarity.scaled_contacts import EXACT, ScaledContacts
from mbd_ros.core.rows.row_layout import Cone
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import HELD_BY_ROWS

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
        self._A, self._loose, self._names, self._cones = A, loose, names, cones
        is_one = len(A) == 3 and len(cones) == 1
        self._is_one = is_one and float(A[0, 0]) > HELD_BY_ROWS * float(loose[0])
        self._problem: ScaledContacts | None = None
        self._answered: tuple[Array, ...] = ()

    def solve(
        self,
        b: Array,
        lower: Array,
        upper: Array,
        speed: float,
        late: Array | None = None,
        warm: Array | None = None,
        *,
        shared: bool = True,
        accepted: float = EXACT,
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
            shared: Whether impulses that depend on one another are those of least norm, which
                takes as long as the answer; else they are any that do the same.
            accepted: What the best impulses may leave of the laws where none are found that leave
                rounding alone, of the largest rate without them.

        Raises:
            SolveError: Nothing keeps a row from moving as it must not, or no impulses are found.
        """
        if late is not None:
            b = b + late
        if self._is_one:
            rounding = _ROUNDING * speed * math.sqrt(self._loose[0])
            p = cone_contact(self._A, b, self._cones[0].mu, float(lower[0]), rounding)
        elif self._opens(b, lower):
            p = np.zeros(len(b))
        else:
            p = self._scaled().solve(b, lower, upper, speed, warm, accepted, shared=shared)
        self._answered = p, b, lower, upper
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
        if self._is_one:
            return Residuals(*cone_residuals(self._A, b, p, self._cones[0].mu, float(lower[0])))
        beyond, over = np.maximum(lower - p, p - upper), 0.0
        for cone in self._cones:
            normal, first, second = p[cone.slots].tolist()
            beyond[cone.slots.start + 1 : cone.slots.stop] = 0.0
            over = max(over, math.hypot(first, second) - cone.mu * normal)
        primal, correction = self._scaled().left(p, b, lower, upper)
        return Residuals(primal, max(float(beyond.max(initial=0.0)), 0.0), over, correction)

    def _opens(self, b: Array, lower: Array) -> bool:
        """Whether contacts alone are left without impulses."""
        if len(b) != 3 * len(self._cones) or lower.any():
            return False
        rates: list[float] = b.tolist()
        return all(rates[cone.slots.start] >= 0.0 for cone in self._cones)

    def _scaled(self) -> ScaledContacts:
        if self._problem is None:
            given = self._A, self._loose, self._names, self._cones
            self._problem = ScaledContacts(*given)
        return self._problem
