"""The length of a path as a polynomial of joints, and its fit.

A polynomial of Chebyshev polynomials is fitted by least squares to lengths and moment arms in
random poses; a part of the poses is kept apart to say how good it is.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.kinematics.paths.paths import Path
from mbd_ros.core.kinematics.sampled_kinematics import SampledKinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError

LARGEST_DEGREE = 30
MOST_TERMS = 1000
Measure = Callable[[Array], tuple[Array, Array, Array]]
"""Positions (n, joints) -> those that have a path, their lengths and slopes (n, joints)."""
_GOOD = 1.0e-8  # m: finer is not asked for
_WORSE = 1.3  # times the least error: fewer terms are worth that
_LEAST_DEGREE = 2  # of joints so many that all others have too many terms
_DEGREES = (4, 6, 8, 10, 12, 14, 16)
_MOST_TERMS = 80
_POSES = 6  # per term of the largest polynomial
_TESTS = 0.25  # of the poses: not for fitting


class PolynomialPath(Path):
    """A sum of products of Chebyshev polynomials: l = sum c prod T_e(z_i).

    z goes from -1 to 1 between the limits of a joint, within which the polynomial holds. The
    tension acts in the joints.

    Args:
        joints: Joint -> its lower and upper limit [rad or m].
        terms: An exponent e of each joint, then c [m].

    Raises:
        ModelError: Unknown joint, limits without room, or a term of another form.
    """

    def __init__(
        self,
        robot: Robot,
        joints: Mapping[str, Sequence[float]],
        terms: Sequence[Sequence[float]],
    ) -> None:
        self._joints = [robot.joint(name) for name in joints]
        self.over = ", ".join(joint.name for joint in self._joints)
        self._nv = int(robot.model.nv)
        count = len(joints)
        limits = list(joints.values())
        for name, pair in joints.items():
            if len(pair) != 2 or not pair[0] < pair[1]:
                raise ModelError(f"polynomial: {name}: expected [lower, upper], got {list(pair)}")
        if not 0 < len(terms) <= MOST_TERMS or any(len(one) != count + 1 for one in terms):
            wanted = f"1 to {MOST_TERMS} lists of {count} exponents and a coefficient"
            raise ModelError(f"polynomial: terms: expected {wanted}")
        table = np.array(terms, dtype=np.float64)
        self._exponents = _checked_exponents(table[:, :count])
        self._coefficients = table[:, count]
        low, high = np.array(limits, dtype=np.float64).T
        self._middle = 0.5 * (low + high)
        self._scale = 2.0 / (high - low)

    def length(self, k: Kinematics, x: State) -> float:
        """The l [m]."""
        found: float = self._sum(self._factors(k, x, 0), [0] * len(self._joints))
        return found

    def measured(self, k: Kinematics, x: State) -> tuple[float, Array]:
        """The l [m] and its slopes, shape (nv,)."""
        factors, slope = self._factors(k, x, 1), k.zeros(self._nv)
        for i, joint in enumerate(self._joints):
            slope[joint.v] = self._sum(factors, self._orders(i))
        return self._sum(factors, [0] * len(self._joints)), slope

    def drift(self, k: Kinematics, x: State) -> float:
        """The sum of l_ij v_i v_j [m/s^2]."""
        factors, bent = self._factors(k, x, 2), 0.0
        for i, joint in enumerate(self._joints):
            for j, other in enumerate(self._joints):
                slope = self._sum(factors, self._orders(i, j))
                bent += slope * k.item(x.v, joint.v) * k.item(x.v, other.v)
        return bent

    def sampled(self, k: SampledKinematics) -> tuple[Array, Array]:
        """The l [m] and its slopes of n samples."""
        factors = self._products([k.q[:, joint.q] for joint in self._joints], 1)
        slopes = np.zeros((len(k.q), self._nv))
        for i, joint in enumerate(self._joints):
            slopes[:, joint.v] = self._sum(factors, self._orders(i))
        return self._sum(factors, [0] * len(self._joints)), slopes

    def _orders(self, *joints: int) -> list[int]:
        """How often the length is differentiated by each joint."""
        return [joints.count(i) for i in range(len(self._joints))]

    def _factors(self, k: Kinematics, x: State, order: int) -> list[list[Any]]:
        return self._products([k.item(x.q, joint.q) for joint in self._joints], order)

    def _products(self, positions: Sequence[Any], order: int) -> list[list[Any]]:
        """Factors of all terms: of each joint its value, slope and bend, as far as asked for."""
        found = []
        for i, q in enumerate(positions):
            scale, exponents = float(self._scale[i]), self._exponents[:, i]
            z = (q - float(self._middle[i])) * scale
            orders = chebyshev(z, int(exponents.max()), order)
            found.append([np.array(one)[exponents] * scale**n for n, one in enumerate(orders)])
        return found

    def _sum(self, factors: Sequence[Sequence[Any]], orders: Sequence[int]) -> Any:
        product = factors[0][orders[0]]
        for one, order in zip(factors[1:], orders[1:], strict=True):
            product = product * one[order]
        return self._coefficients.dot(product)


def _checked_exponents(given: Array) -> NDArray[np.intp]:
    found = given.astype(np.intp)
    if (found != given).any() or (found < 0).any() or (found > LARGEST_DEGREE).any():
        raise ModelError(f"polynomial: exponents: whole numbers 0 .. {LARGEST_DEGREE}")
    return found


def chebyshev(z: Any, degree: int, order: int) -> list[list[Any]]:
    """T_0 .. T_degree at z, then as many of their derivatives, up to the second one, as asked for.

    Args:
        z: A float, an array or a symbol.
        degree: The largest one.
        order: 0, 1 or 2.
    """
    none, double = 0.0 * z, 2.0 * z
    found = [[none + 1.0, z], [none, none + 1.0], [none, none]][: order + 1]
    for _ in range(degree - 1):
        for n in range(order, -1, -1):
            of = found[n]
            more = 2.0 * n * found[n - 1][-1] if n else 0.0
            of.append(double * of[-1] + more - of[-2])
    return found


def fitted(limits: Array, measure: Measure) -> Fit:
    """The polynomial of the least degree that is nearly as good as any.

    Args:
        limits: Lower and upper limit of each joint, shape (joints, 2).
        measure: Gives lengths and slopes.
    """
    degrees = [n for n in _DEGREES if len(_exponents_up_to(n, len(limits))) <= _MOST_TERMS]
    degrees = degrees or [_LEAST_DEGREE]
    count = _POSES * len(_exponents_up_to(degrees[-1], len(limits)))
    angles = np.random.default_rng(0).uniform(0.0, np.pi, (count, len(limits)))
    low, high = limits.T
    positions, lengths, slopes = measure(0.5 * (low + high) - 0.5 * (high - low) * np.cos(angles))
    z, scale = (2.0 * positions - low - high) / (high - low), 2.0 / (high - low)
    tested = np.arange(len(z)) < _TESTS * len(z)
    found = list[Fit]()
    for degree in degrees:
        exponents = _exponents_up_to(degree, len(limits))
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


def _exponents_up_to(degree: int, joints: int) -> NDArray[np.intp]:
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
