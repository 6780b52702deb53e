"""Explicit Runge-Kutta methods as data."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array


class Tableau(NamedTuple):
    """Coefficients of an explicit Runge-Kutta method for y' = f(t, y).

        y_i = y + h sum_j a[i, j] k_j,   k_i = f(t + c_i h, y_i),   c_i = sum_j a[i, j]

    Row `stages` of `a` is the step itself; the rows after it serve the dense output only.

    Attributes:
        a: Strictly lower triangular, shape (n, n), n > stages.
        stages: Evaluations of a step.
        error_order: Order of the error estimate.
        errors: Error estimates as weights of the rates, shape (m, k): one row, or two (5th and
            3rd order) that are combined as in DOP853.
        dense: What the dense output adds to the cubic through both ends, as weights of the rates,
            shape (d, n).
    """

    a: Array
    stages: int
    error_order: int = 0
    errors: Array = np.zeros((0, 0))
    dense: Array = np.zeros((0, 0))

    @property
    def terms(self) -> Array:
        """F0, F1, .. of `weights` as weights of the rates, shape (3 + d, n)."""
        start, end = np.eye(len(self.a))[[0, self.stages]]
        step = self.a[self.stages]
        hermite = [step, start - step, 2.0 * step - start - end]
        return np.vstack([hermite, self.dense.reshape(-1, len(step))])

    def weights(self, theta: float) -> Array:
        """Weights w of the rates with y(t + theta h) = y + h sum_i w_i k_i, shape (n,).

            y + theta (F0 + (1 - theta) (F1 + theta (F2 + (1 - theta) (F3 + ..))))

        Source: Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, 1993, II.6.

        Args:
            theta: Part of the step, 0 .. 1.
        """
        terms = self.terms
        factors = np.resize([theta, 1.0 - theta], len(terms))
        weights: Array = np.cumprod(factors).dot(terms)
        return weights


def matrix(rows: Sequence[Mapping[int, float]], columns: int) -> Array:
    """Dense matrix of rows that are given as {column: value}."""
    full = np.zeros((len(rows), columns))
    for row, values in zip(full, rows, strict=True):
        row[list(values)] = list(values.values())
    return full


RK4 = Tableau(
    matrix([{}, {0: 1 / 2}, {1: 1 / 2}, {2: 1.0}, {0: 1 / 6, 1: 1 / 3, 2: 1 / 3, 3: 1 / 6}], 5), 4
)
