"""Integrals of the polynomial through values at given places."""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.state import Array


def integrals(places: Sequence[float] | Array, theta: float) -> tuple[Array, Array]:
    """Weights of values f_i in the integrals of the polynomial through them, from 0 to theta.

        int_0^theta f = sum_i once[i] f_i,   int_0^theta int_0^s f = sum_i twice[i] f_i

    Args:
        places: Where the values are, all different, shape (n,).
        theta: Where the integrals end.

    Returns:
        once and twice, shape (n,) each.
    """
    once, twice = np.zeros(len(places)), np.zeros(len(places))
    for i, place in enumerate(places):
        basis = np.atleast_1d(np.poly(np.delete(places, i)))
        basis = basis / np.polyval(basis, place)
        once[i] = np.polyval(np.polyint(basis), theta)
        twice[i] = np.polyval(np.polyint(basis, 2), theta)
    return once, twice
