"""Uniform quintic B-splines of cells, and of the same cells joined in pairs.

    b(x) = 2^-5 sum_k C(6, k) b(2 x - k), k = 0 .. 6

Source: C. de Boor, A Practical Guide to Splines, 1978, chapter XI (insertion of knots).
"""

import math

import numpy as np

from mbd_ros.core.signals.long_products import product
from mbd_ros.core.signals.spline_pieces import DEGREE, pieces
from mbd_ros.core.state import Array

_ENDS = -0.5, 0.5  # of a cell, which the middles of its halves are half as far from its middle as
_SHARES = [math.comb(DEGREE + 1, k) / 2.0**DEGREE for k in range(DEGREE + 2)]
_MIDDLE = pieces(0.5)[:, 0]  # values of the six splines of a cell there


def joined(sums: Array) -> Array:
    """Sums of b y with the splines of pairs of cells.

    Args:
        sums: Those with the splines of the cells, an even number of them; shape (m, splines).
    """
    splines = (sums.shape[1] - DEGREE) // 2 + DEGREE
    padded = np.pad(sums, ((0, 0), (DEGREE, DEGREE + 1)))
    found: Array = np.zeros((len(sums), splines))
    for k, share in enumerate(_SHARES):
        found += share * padded[:, k : k + 2 * splines : 2]
    return found


def parted(coefficients: Array) -> Array:
    """Coefficients of the splines of the halves of cells, for the same function.

    Args:
        coefficients: Of the splines of the cells, shape (m, splines).
    """
    m, splines = coefficients.shape
    padded = np.zeros((m, 2 * splines + DEGREE + 1))
    for k, share in enumerate(_SHARES):
        padded[:, k : k + 2 * splines : 2] += share * coefficients
    return padded[:, DEGREE : 2 * splines]


def middles(coefficients: Array) -> Array:
    """Values in the middle of each cell, shape (m, cells).

    Args:
        coefficients: Of the splines of the cells, shape (m, splines).
    """
    cells = coefficients.shape[1] - DEGREE
    found: Array = np.zeros((len(coefficients), cells))
    for p, share in enumerate(_MIDDLE):
        found += share * coefficients[:, p : p + cells]
    return found


def joined_powers(sums: Array) -> Array:
    """Sums of y u^k, u the place from the middle of a cell on, for pairs of cells.

    u of a pair is (u -+ 1/2) / 2.

    Args:
        sums: For the cells, an even number of them; shape (k, cells).
    """
    found: Array = np.zeros((len(sums), sums.shape[1] // 2))
    for half, end in enumerate(_ENDS):
        shares = [
            [math.comb(k, j) * end ** max(k - j, 0) / 2.0**k for j in range(len(sums))]
            for k in range(len(sums))
        ]
        found += product(np.array(shares), sums[:, half::2])
    return found
