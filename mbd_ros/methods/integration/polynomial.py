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
    bases = _bases(places)
    once = np.array([np.polyval(np.polyint(basis), theta) for basis in bases])
    twice = np.array([np.polyval(np.polyint(basis, 2), theta) for basis in bases])
    return once, twice


def powers(places: Sequence[float] | Array) -> tuple[Array, Array]:
    """The same weights as polynomials of theta.

        once[i] = sum_k first[i, k] theta^(k + 1),   twice[i] = sum_k second[i, k] theta^(k + 2)

    Args:
        places: Where the values are, all different, shape (n,).

    Returns:
        first and second, shape (n, n) each.
    """
    bases = _bases(places)
    first = np.array([np.polyint(basis)[-2::-1] for basis in bases])
    second = np.array([np.polyint(basis, 2)[-3::-1] for basis in bases])
    return first, second


def _bases(places: Sequence[float] | Array) -> list[Array]:
    """The polynomials that are 1 at one place and 0 at the others, highest power first."""
    found = []
    for i, place in enumerate(places):
        basis = np.atleast_1d(np.poly(np.delete(places, i)))
        found.append(basis / np.polyval(basis, place))
    return found
