"""Residuals that repeat their neighbours: what rows are worth, and how far estimates scatter.

White noise is correlated behind a filter, as its taps say. Residuals with more at low frequencies,
where the model lacks something, are taken for an autoregressive process. With the correlation C of
residuals, estimates by A = sum X' W X have the covariance A^-1 (sum X' W C W X) A^-1.

Source: P. J. Brockwell, R. A. Davis, Time Series, 1991, chapter 8 (Yule-Walker); H. White,
Econometrica 48, 1980, 817 (covariance of weighted estimates).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.features.identification.least_squares import Fit

_ORDER = 8  # of the process, at most
_MORE = (
    2.0  # times the power of white noise at the lowest frequencies: a model that lacks something
)
_PER_ORDER = 20  # residuals that a coefficient needs


class Noise(NamedTuple):
    """Residuals of a row.

    Attributes:
        correlation: Of residuals so many rows apart, 1 first, shape (k,); empty for a process.
        coefficients: e_t = sum c_k e_(t-k) + w_t, shape (p,).
        innovation: Standard deviation of w, or that of the residuals.
        share: Independent residuals for each, for a variance.
    """

    correlation: Array
    coefficients: Array
    innovation: float
    share: float


def noise_of(left: Array, correlation: Array) -> Noise:
    """Noise behind a filter, or the process of residuals that are more than that.

    Args:
        left: Residuals, shape (n,).
        correlation: Of white noise behind the filter, 1 first, shape (k,).
    """
    share = float(1.0 / (1.0 + 2.0 * np.sum(np.square(correlation[1:]))))
    power = float(left @ left) / max(len(left), 1)
    white = Noise(correlation, np.zeros(0), float(np.sqrt(power)), share)
    process = _process(left)
    slow = process.innovation / (1.0 - float(process.coefficients.sum()))
    level = power * max(float(1.0 + 2.0 * correlation[1:].sum()), 0.0)
    return process if slow**2 > _MORE * level else white


def _process(left: Array) -> Noise:
    """Autoregressive process, its order by Akaike's criterion."""
    n, none = len(left), np.zeros(0)
    most = min(_ORDER, n // _PER_ORDER)
    power = float(left @ left) / max(n, 1)
    if most == 0 or power == 0.0:
        return Noise(none, none, float(np.sqrt(power)), 1.0)
    c = np.array([left[: n - k] @ left[k:] for k in range(most + 1)]) / n
    best, chosen, variance, cheapest = np.zeros(0), np.zeros(0), c[0], n * np.log(c[0])
    spread = variance
    for k in range(1, most + 1):  # Levinson's recursion
        reflection = (c[k] - best @ c[1:k][::-1]) / spread
        best = np.r_[best - reflection * best[::-1], reflection]
        spread = max(spread * (1.0 - reflection**2), np.finfo(np.float64).tiny)
        cost = n * np.log(spread) + 2.0 * k
        if cost < cheapest:
            chosen, variance, cheapest = best, spread, cost
    return Noise(none, chosen, float(np.sqrt(variance)), _share(chosen))


def _share(coefficients: Array) -> float:
    """1 / (1 + 2 sum rho^2) of a process: rows that a row is worth where a variance is asked."""
    impulse = np.zeros(2048)
    impulse[0] = 1.0
    response = coloured(impulse[:, None], coefficients)[:, 0]
    spectrum = np.square(np.abs(np.fft.rfft(response, 2 * len(response))))
    rho = np.fft.irfft(spectrum)[: len(response)]
    rho /= rho[0]
    return float(1.0 / (1.0 + 2.0 * np.sum(np.square(rho[1:]))))


def coloured(values: Array, coefficients: Array) -> Array:
    """Columns through 1 / (1 - sum c_k z^-k), shape (n, m)."""
    if not len(coefficients):
        return values
    found, p = values.copy(), len(coefficients)
    turned = coefficients[::-1]
    for t in range(1, len(found)):
        some = min(p, t)
        found[t] += turned[p - some :] @ found[t - some : t]
    return found


def _spread(rows: Array, noise: Noise) -> Array:
    """X' C X of rows X that follow each other, without the power of the noise."""
    if not len(noise.correlation):
        turned = coloured(rows[::-1], noise.coefficients)
        return np.asarray(turned.T @ turned)
    found = rows.T @ rows
    for k, rho in enumerate(noise.correlation[1 : len(rows)], 1):
        across = rho * rows[:-k].T @ rows[k:]
        found += across + across.T
    return np.asarray(found)


class Spread:
    """Covariance of estimates from weighted rows that come in blocks.

    Args:
        noise: Of the residuals of each row.
        taken: Columns of friction that are taken of each.
        r: Number of base parameters.
    """

    def __init__(self, noise: Sequence[Noise], taken: Sequence[tuple[int, ...]], r: int) -> None:
        self._noise, self._taken, self._r = noise, taken, r
        self._sums = [np.zeros((r + len(own), r + len(own))) for own in taken]
        self._worth = [0.0 for _ in taken]  # independent rows
        self._plain = [np.zeros((r + len(own), r + len(own))) for own in taken]

    def add(self, X: Array, F: Sequence[Array], kept: NDArray[np.bool_]) -> None:
        """Take rows that follow each other: columns of base parameters and candidates."""
        for i, (noise, own) in enumerate(zip(self._noise, self._taken, strict=True)):
            rows = np.where(kept[:, i, None], np.hstack([X[:, i], F[i][:, own]]), 0.0)
            self._sums[i] += noise.innovation**2 * _spread(rows, noise)
            self._plain[i] += rows.T @ rows
            self._worth[i] += noise.share * float(kept[:, i].sum())

    def covariance(self, fit: Fit) -> Array:
        """Of base parameters, then friction of each row, shape (r + f, r + f)."""
        r, n = self._r, sum(map(len, self._taken))
        A, S, at = np.zeros((r + n, r + n)), np.zeros((r + n, r + n)), r
        for own, sigma, plain, sums in zip(
            self._taken, fit.deviation, self._plain, self._sums, strict=True
        ):
            places = np.r_[np.arange(r), at + np.arange(len(own))]
            A[np.ix_(places, places)] += plain / sigma**2
            S[np.ix_(places, places)] += sums / sigma**4
            at += len(own)
        scale = np.sqrt(np.maximum(np.diag(A), np.finfo(np.float64).tiny))
        inverse = np.linalg.pinv(A / np.outer(scale, scale), hermitian=True) / np.outer(
            scale, scale
        )
        worth = sum(self._worth)
        covariance: Array = inverse @ S @ inverse * (worth / max(worth - r - n, 1.0))
        return covariance
