"""Averages of chains, and how well they are known."""

from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array

_FEWEST = 8  # samples a chain


class Average(NamedTuple):
    """The average of a quantity.

    Attributes:
        mean: Over all samples of all chains.
        error: Standard error of the mean.
        spread: Standard deviation of the quantity.
        time: Samples after which a chain has forgotten a value: the integrated autocorrelation
            time, 1 for independent samples.
        effective: Number of independent samples that would know as much.
        rhat: Split R-hat: 1 where halves of chains agree; above 1.01 they do not.
    """

    mean: float
    error: float
    spread: float
    time: float
    effective: float
    rhat: float


def average(x: Array) -> Average:
    """Average of a quantity.

    Source: A. Gelman et al., Bayesian Data Analysis, 3rd ed. 2013, 11.4 and 11.5; A. Vehtari et
    al., Bayesian Analysis 16, 2021, 667; C. J. Geyer, Statist. Sci. 7, 1992, 473 (where sums of
    autocorrelations end).

    Args:
        x: Values, shape (chains, samples).
    """
    halves = _halves(x)
    m, n = halves.shape
    mean = float(x.mean())
    if n < _FEWEST // 2 or not np.isfinite(halves).all():
        return Average(mean, np.nan, float(x.std()), np.nan, np.nan, np.nan)
    within = float(halves.var(axis=1, ddof=1).mean())
    between = float(halves.mean(axis=1).var(ddof=1))
    total = within * (n - 1) / n + between
    if total <= (8.0 * np.finfo(float).eps * max(abs(mean), 1e-300)) ** 2:
        return Average(mean, 0.0, 0.0, 1.0, float(x.size), 1.0)
    covariance = _autocovariance(halves).mean(axis=0)
    rho = 1.0 - (within - covariance * n / (n - 1)) / total
    time = _summed(rho)
    effective = min(m * n / time, float(m * n) * np.log10(max(m * n, 10)))
    rhat = float(np.sqrt(total / within)) if within > 0.0 else np.inf
    return Average(
        mean, float(np.sqrt(total / effective)), float(np.sqrt(total)), time, effective, rhat
    )


def ratio(above: Array, below: Array) -> Average:
    """The average of `above` over that of `below`, with the error of both.

    Args:
        above: Values, shape (chains, samples).
        below: Values, all > 0.
    """
    value = float(above.mean() / below.mean())
    left = average((above - value * below) / below.mean())
    return left._replace(mean=value)


class Histogram(NamedTuple):
    """Shares of samples in bins.

    Attributes:
        edges: Shape (bins + 1,).
        shares: Of all samples, those outside of the edges included, shape (bins,).
        errors: Their standard errors.
    """

    edges: Array
    shares: Array
    errors: Array


def histogram(x: Array, edges: Array) -> Histogram:
    """Shares of samples in bins, as averages of whether a sample is there.

    Args:
        x: Values, shape (chains, samples).
        edges: Shape (bins + 1,).
    """
    found = np.searchsorted(edges, x, side="right") - 1
    found = np.where(x == edges[-1], len(edges) - 2, found)
    each = [average((found == k).astype(float)) for k in range(len(edges) - 1)]
    shares, errors = ([one[i] for one in each] for i in (0, 1))
    return Histogram(edges, np.array(shares), np.array(errors))


def _halves(x: Array) -> Array:
    half = x.shape[1] // 2
    return np.concatenate([x[:, :half], x[:, x.shape[1] - half :]])


def _autocovariance(x: Array) -> Array:
    """Of each row, by all lags, shape as x."""
    n = x.shape[1]
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(x - x.mean(axis=1, keepdims=True), size, axis=1)
    found: Array = np.fft.irfft(spectrum * spectrum.conj(), size, axis=1)[:, :n] / n
    return found


def _summed(rho: Array) -> float:
    """1 + 2 sum of autocorrelations, ended where sums of pairs cease to be positive and fall."""
    pairs = rho[: len(rho) // 2 * 2].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pairs <= 0.0)
    pairs = pairs[: negative[0]] if len(negative) else pairs
    return float(max(2.0 * np.minimum.accumulate(pairs).sum() - 1.0, 0.05)) if len(pairs) else 1.0
