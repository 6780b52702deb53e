"""Which rates of rows that may depend on one another impulses can answer."""

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import redundant
from mbd_ros.core.time_stepping.unilateral_rows import Slots

_OF_ONE = 3  # rows of one contact
_FLAT = 1.0e-10  # of the product of its mobilities: rows that may depend on one another
_DEPENDS = 1.0e-6  # of rates that no impulses make: what sliding tangents have of them


class AnsweredRates:
    """Rates that no impulses make, remembered while A is the same."""

    def __init__(self) -> None:
        self._last: tuple[Array, Array] | None = None

    def none(self, A: Array) -> Array:
        """Rates that no impulses make, orthonormal in columns, shape (m, dependent)."""
        if self._last is None or self._last[0] is not A:
            values, ways = np.linalg.eigh(0.5 * (A + A.T))
            self._last = A, ways[:, values <= redundant(len(A)) * values[-1]]
        return self._last[1]

    def possible(self, late: Array, A: Array, slide: Slots) -> Array:
        """Earlier rates of tangents that slide, as far as they contradict no other rows.

        Args:
            late: Rates, 0 but at these tangents, shape (m,).
            A: Rates that impulses add, shape (m, m).
            slide: The tangents that slide.
        """
        if is_independent(A) or not (none := self.none(A)).size:
            return late
        over, sizes, _ = np.linalg.svd(none[slide], full_matrices=False)
        over = over[:, sizes > _DEPENDS]
        late[slide] -= over.dot(over.T.dot(late[slide]))
        return late


def is_independent(A: Array) -> bool:
    """Whether the rows of one contact certainly do not depend on one another; no for more."""
    if len(A) != _OF_ONE:
        return False
    (n, x, y), (_, p, q), (_, _, r) = A.tolist()
    volume = n * (p * r - q * q) - x * (x * r - q * y) + y * (x * q - p * y)
    return bool(volume > _FLAT * n * p * r)
