"""Equations of a smoothing spline: sums over samples, and fourth differences that are kept small.

(N + stiffness D' D) c = b, D the fourth differences of coefficients
"""

import math

import numpy as np

from mbd_ros.core.signals.banded import Banded
from mbd_ros.core.signals.spline_pieces import DEGREE
from mbd_ros.core.state import Array

ORDER = 4  # of the derivative that is kept small
_HOLD = 1.0e-12  # share by which the main diagonal grows where rounding took its rank
_DIFFERENCE = [math.comb(ORDER, j) * (-1.0) ** j for j in range(ORDER + 1)]


class SmoothingEquations:
    """Prepared for several b.

    Args:
        normal: N in upper banded form, shape (DEGREE + 1, n).
        stiffness: That of the differences, > 0.
    """

    def __init__(self, normal: Array, stiffness: float) -> None:
        self._normal, self._stiffness = normal, stiffness
        band = normal.copy()
        for k, diagonal in enumerate(_penalty(band.shape[1])):
            band[DEGREE - k, k:] += stiffness * diagonal
        try:
            self._banded = Banded(band)
        except np.linalg.LinAlgError:  # a wide gap of many cells: only the penalty holds them
            band[DEGREE] *= 1.0 + _HOLD
            self._banded = Banded(band)

    def solve(self, known: Array, refined: bool = False) -> Array:
        """Solution for b of shape (m, n), same shape.

        Args:
            known: The b.
            refined: Take what is left of b as another b. Differences of smooth coefficients are
                small and known well, a row of D' D times them is not: what stiff equations lose
                to rounding comes back.
        """
        found = self._banded.solve(known.T).T
        if refined:
            found = found + self._banded.solve(self._left(known, found).T).T
        return found

    def _left(self, known: Array, found: Array) -> Array:
        """What is left of b."""
        left = known - self._normal[DEGREE] * found
        for k in range(1, min(DEGREE, found.shape[1] - 1) + 1):
            diagonal = self._normal[DEGREE - k, k:]
            left[:, :-k] -= diagonal * found[:, k:]
            left[:, k:] -= diagonal * found[:, :-k]
        pulls, n = self._stiffness * np.diff(found, ORDER, axis=1), found.shape[1] - ORDER
        for j, share in enumerate(_DIFFERENCE):
            left[:, j : j + n] -= share * pulls
        return left


def _penalty(size: int) -> list[Array]:
    """Diagonals, from the main one up, of the squares of fourth differences of `size` numbers."""
    row = _DIFFERENCE
    diagonals = []
    for k in range(min(ORDER + 1, size)):
        diagonal = np.zeros(size - k)
        for j in range(ORDER + 1 - k):
            diagonal[j : j + size - ORDER] += row[j] * row[j + k]
        diagonals.append(diagonal)
    return diagonals
