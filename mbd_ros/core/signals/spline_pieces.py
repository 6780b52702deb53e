"""Quintic B-splines of uniform knots as polynomials within a cell."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array

DEGREE = 5

# order of a derivative, signals that pass, where its values go, and in which columns
Wanted = Sequence[tuple[int, NDArray[np.intp], Array, NDArray[np.intp]]]


def pieces(origin: float) -> Array:
    """Coefficients of u^k, k = 0 .. 5, of the six splines of a cell, shape (spline, k).

    b_p(u) = 1/5! sum_j (-1)^j C(6, j) (u + origin + 5 - p - j)^5 over the terms that are positive.

    Args:
        origin: Place in the cell that u = 0 is, 0 its beginning and 1 its end.

    Source: C. de Boor, A Practical Guide to Splines, 1978, chapter IX (truncated powers).
    """
    n, found = DEGREE, np.zeros((DEGREE + 1, DEGREE + 1))
    for p in range(n + 1):
        for j in range(n + 1 - p):
            shift, sign = n - p - j, (-1.0) ** j * math.comb(n + 1, j) / math.factorial(n)
            for k in range(n + 1):
                found[p, k] += sign * math.comb(n, k) * (shift + origin) ** (n - k)
    return found
