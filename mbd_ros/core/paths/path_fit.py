"""The length of a path as a polynomial of joints, by least squares of lengths and moment arms."""

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.paths.polynomial_path import chebyshev
from mbd_ros.core.state import Array

# positions (n, joints) -> those that have a path, their lengths and slopes (n, joints)
Measure = Callable[[Array], tuple[Array, Array, Array]]

_GOOD = 1.0e-8  # m: finer is not asked for
_WORSE = 1.3  # times the least error: fewer terms are worth that
_DEGREES = (4, 6, 8, 10, 12, 14, 16)
_MOST_TERMS = 80
_POSES = 6  # per term of the largest polynomial
_TESTS = 0.25  # of the poses: not for fitting


class Fit(NamedTuple):
    """A polynomial and how good it is.

    Attributes:
        terms: Exponents of the joints and a coefficient [m], as `PolynomialPath` takes them.
        degree: The largest sum of exponents.
        length_error: Root mean square in poses that were not fitted [m].
        arm_error: The same of moment arms [m per rad or m].
    """

    terms: list[list[float]]
    degree: int
    length_error: float
    arm_error: float


def fitted(limits: Array, measure: Measure) -> Fit:
    """The polynomial of the least degree that is nearly as good as any.

    Args:
        limits: Lower and upper limit of each joint, shape (joints, 2).
        measure: Gives lengths and slopes.
    """
    degrees = [n for n in _DEGREES if len(_exponents(n, len(limits))) <= _MOST_TERMS] or [2]
    count = _POSES * len(_exponents(degrees[-1], len(limits)))
    angles = np.random.default_rng(0).uniform(0.0, np.pi, (count, len(limits)))
    low, high = limits.T
    positions, lengths, slopes = measure(0.5 * (low + high) - 0.5 * (high - low) * np.cos(angles))
    z, scale = (2.0 * positions - low - high) / (high - low), 2.0 / (high - low)
    tested = np.arange(len(z)) < _TESTS * len(z)
    found = list[Fit]()
    for degree in degrees:
        exponents = _exponents(degree, len(limits))
        A = _equations(z, scale, exponents)
        b = np.hstack((lengths[:, None], slopes))
        rows = A[~tested].reshape(-1, len(exponents))
        c = np.linalg.lstsq(rows, b[~tested].ravel(), rcond=None)[0]
        off = np.sqrt(np.mean((A[tested] @ c - b[tested]) ** 2, axis=0))
        terms = [[*map(float, e), float(one)] for e, one in zip(exponents, c, strict=True)]
        found.append(Fit(terms, degree, float(off[0]), float(off[1:].max())))
        if off.max() < _GOOD:
            break
    length, arm = min(one.length_error for one in found), min(one.arm_error for one in found)
    fine = (f for f in found if f.length_error <= _WORSE * length and f.arm_error <= _WORSE * arm)
    return next(fine, found[-1])


def _exponents(degree: int, joints: int) -> NDArray[np.intp]:
    """All with a sum up to the degree, shape (terms, joints)."""
    every = itertools.product(range(degree + 1), repeat=joints)
    return np.array([one for one in every if sum(one) <= degree], dtype=np.intp)


def _equations(z: Array, scale: Array, exponents: NDArray[np.intp]) -> Array:
    """Each term's length and slopes, shape (n, 1 + joints, terms)."""
    joints = z.shape[1]
    found = np.ones((len(z), 1 + joints, len(exponents)))
    for i in range(joints):
        values, slopes = chebyshev(z[:, i], int(exponents.max()), 1)
        value, slope = (np.array(one)[exponents[:, i]].T for one in (values, slopes))
        for row in range(1 + joints):
            found[:, row] *= slope * scale[i] if row == 1 + i else value
    return found
