"""Length of a path as a polynomial of joint positions, and fitting of such polynomials.

A sum of products of Chebyshev polynomials is fitted by least squares to lengths and moment arms at
random configurations; some configurations are reserved for measuring the error.
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
"""Positions (n, joints) -> those with a valid path, its lengths and Jacobians (n, joints)."""
_GOOD = 1.0e-8  # [m], an error that is small enough
_WORSE = 1.3  # acceptable ratio to the smallest error, for fewer terms
_LEAST_DEGREE = 2  # used if all others have too many terms
_DEGREES = (4, 6, 8, 10, 12, 14, 16)
_MOST_TERMS = 80
_POSES = 6  # per term of the largest polynomial
_TESTS = 0.25  # fraction of the configurations that is reserved for tests


class PolynomialPath(Path):
    """Sum of products of Chebyshev polynomials: l = sum c prod T_e(z_i).

    z_i is the position of a joint, scaled to -1 .. 1 between its limits, within which the
    polynomial is valid. The tension acts in the joints.

    Args:
        robot: The robot.
        joints: Joint -> lower and upper limit [rad or m].
        terms: For each term, the degree e for every joint, then the coefficient c [m].

    Raises:
        ModelError: A joint is unknown, limits do not increase, or a term has another form.
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
        if not 0 < len(terms) <= MOST_TERMS or any(len(term) != count + 1 for term in terms):
            expected = f"1 to {MOST_TERMS} lists of {count} exponents and a coefficient"
            raise ModelError(f"polynomial: terms: expected {expected}")
        table = np.array(terms, dtype=np.float64)
        self._exponents = _checked_exponents(table[:, :count])
        self._coefficients = table[:, count]
        low, high = np.array(limits, dtype=np.float64).T
        self._middle = 0.5 * (low + high)
        self._scale = 2.0 / (high - low)

    def length(self, k: Kinematics, x: State) -> float:
        """Return l [m]."""
        length: float = self._sum(self._factors(k, x, 0), [0] * len(self._joints))
        return length

    def measured(self, k: Kinematics, x: State) -> tuple[float, Array]:
        """Return l [m] and J, shape (nv,)."""
        factors, slope = self._factors(k, x, 1), k.zeros(self._nv)
        for i, joint in enumerate(self._joints):
            slope[joint.v] = self._sum(factors, self._orders(i))
        return self._sum(factors, [0] * len(self._joints)), slope

    def drift(self, k: Kinematics, x: State) -> float:
        """Return the sum of l_ij v_i v_j [m/s^2]."""
        factors, drift = self._factors(k, x, 2), 0.0
        for i, joint in enumerate(self._joints):
            for j, other in enumerate(self._joints):
                slope = self._sum(factors, self._orders(i, j))
                drift += slope * k.item(x.v, joint.v) * k.item(x.v, other.v)
        return drift

    def sampled(self, k: SampledKinematics) -> tuple[Array, Array]:
        """Return l [m] and J of n samples."""
        factors = self._products([k.q[:, joint.q] for joint in self._joints], 1)
        slopes = np.zeros((len(k.q), self._nv))
        for i, joint in enumerate(self._joints):
            slopes[:, joint.v] = self._sum(factors, self._orders(i))
        return self._sum(factors, [0] * len(self._joints)), slopes

    def _orders(self, *joints: int) -> list[int]:
        """Return how often the length is differentiated by each joint."""
        return [joints.count(i) for i in range(len(self._joints))]

    def _factors(self, k: Kinematics, x: State, order: int) -> list[list[Any]]:
        return self._products([k.item(x.q, joint.q) for joint in self._joints], order)

    def _products(self, positions: Sequence[Any], order: int) -> list[list[Any]]:
        """Return the factors of all terms per joint, and their derivatives up to `order`."""
        factors = []
        for i, q in enumerate(positions):
            scale, exponents = float(self._scale[i]), self._exponents[:, i]
            z = (q - float(self._middle[i])) * scale
            orders = chebyshev(z, int(exponents.max()), order)
            factors.append([np.array(T)[exponents] * scale**n for n, T in enumerate(orders)])
        return factors

    def _sum(self, factors: Sequence[Sequence[Any]], orders: Sequence[int]) -> Any:
        product = factors[0][orders[0]]
        for factor, order in zip(factors[1:], orders[1:], strict=True):
            product = product * factor[order]
        return self._coefficients.dot(product)


def _checked_exponents(values: Array) -> NDArray[np.intp]:
    exponents = values.astype(np.intp)
    is_valid = (exponents == values) & (exponents >= 0) & (exponents <= LARGEST_DEGREE)
    if not is_valid.all():
        raise ModelError(f"polynomial: exponents: whole numbers 0 .. {LARGEST_DEGREE}")
    return exponents


def chebyshev(z: Any, degree: int, order: int) -> list[list[Any]]:
    """Return T_0 .. T_degree at z, and their derivatives up to an order.

    Args:
        z: A float, an array or a symbol.
        degree: Largest degree.
        order: Order of the highest derivative, 0, 1 or 2.
    """
    zero, double = 0.0 * z, 2.0 * z
    values = [[zero + 1.0, z], [zero, zero + 1.0], [zero, zero]][: order + 1]
    for _ in range(degree - 1):
        for n in range(order, -1, -1):
            T = values[n]
            lower_order = 2.0 * n * values[n - 1][-1] if n else 0.0
            T.append(double * T[-1] + lower_order - T[-2])
    return values


def fitted(limits: Array, measure: Measure) -> Fit:
    """Fit the polynomial of the lowest degree that is nearly as accurate as the best one.

    Args:
        limits: Lower and upper limit of each joint, shape (joints, 2).
        measure: Function that returns lengths and Jacobians of the path.
    """
    degrees = [n for n in _DEGREES if len(_exponents_up_to(n, len(limits))) <= _MOST_TERMS]
    degrees = degrees or [_LEAST_DEGREE]
    count = _POSES * len(_exponents_up_to(degrees[-1], len(limits)))
    angles = np.random.default_rng(0).uniform(0.0, np.pi, (count, len(limits)))
    low, high = limits.T
    positions, lengths, slopes = measure(0.5 * (low + high) - 0.5 * (high - low) * np.cos(angles))
    z, scale = (2.0 * positions - low - high) / (high - low), 2.0 / (high - low)
    tested = np.arange(len(z)) < _TESTS * len(z)
    fits = list[Fit]()
    for degree in degrees:
        exponents = _exponents_up_to(degree, len(limits))
        A = _equations(z, scale, exponents)
        b = np.hstack((lengths[:, None], slopes))
        rows = A[~tested].reshape(-1, len(exponents))
        c = np.linalg.lstsq(rows, b[~tested].ravel(), rcond=None)[0]
        errors = np.sqrt(np.mean((A[tested] @ c - b[tested]) ** 2, axis=0))
        terms = [[*map(float, e), float(value)] for e, value in zip(exponents, c, strict=True)]
        fits.append(Fit(terms, degree, float(errors[0]), float(errors[1:].max())))
        if errors.max() < _GOOD:
            break
    length, arm = min(fit.length_error for fit in fits), min(fit.arm_error for fit in fits)
    fine = (f for f in fits if f.length_error <= _WORSE * length and f.arm_error <= _WORSE * arm)
    return next(fine, fits[-1])


def _exponents_up_to(degree: int, joints: int) -> NDArray[np.intp]:
    """Return all exponents with a sum up to the degree, shape (terms, joints)."""
    every = itertools.product(range(degree + 1), repeat=joints)
    return np.array([exponents for exponents in every if sum(exponents) <= degree], dtype=np.intp)


def _equations(z: Array, scale: Array, exponents: NDArray[np.intp]) -> Array:
    """Return length and derivatives of each term, shape (n, 1 + joints, terms)."""
    joints = z.shape[1]
    equations = np.ones((len(z), 1 + joints, len(exponents)))
    for i in range(joints):
        values, slopes = chebyshev(z[:, i], int(exponents.max()), 1)
        value, slope = (np.array(T)[exponents[:, i]].T for T in (values, slopes))
        for row in range(1 + joints):
            equations[:, row] *= slope * scale[i] if row == 1 + i else value
    return equations


class Fit(NamedTuple):
    """A fitted polynomial with its errors.

    Attributes:
        terms: Exponents of the joints and a coefficient [m], see `PolynomialPath`.
        degree: Largest sum of exponents.
        length_error: Root mean square error of the length at test configurations [m].
        arm_error: Largest root mean square error of a moment arm there [m per rad or m].
    """

    terms: list[list[float]]
    degree: int
    length_error: float
    arm_error: float
