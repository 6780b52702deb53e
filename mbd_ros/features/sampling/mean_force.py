"""Mean force along a coordinate, free energy, and the accuracy of averages.

Constraints s and a fixed coordinate xi have the Jacobian J = (J_s, J_xi), A = J M^-1 J' and the
Hessians H_c. With the multiplier of M a = -grad V + J' lam and the motion W = M^-1 J' A^-1 e_xi,
along which xi alone changes,

    dA/dxi = <w (lam_xi + kT G)> / <w>,   w = (det A_s / det A)^(1/2)
    G = tr(A^-1 K) - tr(A_s^-1 K_s),      K_ca = (M^-1 J_a') . H_c W

Without other constraints these are w = Z^-1/2 and G = grad xi . H grad xi / |grad xi|^4, as in
the sources.
If the constraints s are the limit of stiff springs (Fixman), w = det A^(-1/2) and G = tr(A^-1 K).
Masses are constant here. For a mechanism, whose masses are not, V contains the density that they
give to configurations (`WeightedSpace`).

Sources: E. A. Carter et al., Chem. Phys. Lett. 156, 1989, 472; M. Sprik, G. Ciccotti, J. Chem.
Phys. 109, 1998, 7737; W. K. den Otter, W. J. Briels, ibid. 109, 1998, 4139.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.features.sampling.ensemble import Ensemble, Walkers
from mbd_ros.features.sampling.space import inverse, log_determinant, solve

_STILL = 1.0e-12  # of the total variance, within chains that do not move
_AVERAGED = 60  # coordinates up to which velocities are averaged over and not drawn
_ROUNDED = 1.0e-9  # what differences of Jacobians leave, where samples do not scatter
_NODES = 4  # of the polynomial that is integrated over an interval


def mean_force(level: float, weight: Array, multiplier: Array, correction: Array) -> MeanForce:
    """Compute the mean force from samples, arrays of shape (chains, samples)."""
    force = ratio(weight * (multiplier + correction), weight)
    rounded = _ROUNDED * float(np.abs(multiplier).mean() + np.abs(correction).mean())
    force = force._replace(error=float(np.hypot(force.error, rounded)))
    return MeanForce(level, force, average(multiplier))


class MeanForce(NamedTuple):
    """Mean force at a value of the coordinate.

    Attributes:
        level: Value of the coordinate.
        force: Derivative of the free energy dA/dxi.
        multiplier: Average of the multiplier alone, without weight and correction.
    """

    level: float
    force: Average
    multiplier: Average


def instant(ensemble: Ensemble, at: Walkers, gradient: Array, *, fixman: bool) -> Instant:
    """Evaluate the terms of the mean force at states of an ensemble with a fixed coordinate.

    Args:
        ensemble: Ensemble of a `FixedCoordinateSpace`, without Fixman's potential, which the
            weights contain.
        at: States of the chains.
        gradient: Gradient of the potential energy there, shape (size, chains).
        fixman: Whether the other constraints are the limit of stiff springs.
    """
    (part,), (place,) = ensemble.manifold.parts, at.places
    B = inverse(place.A)
    bending = _bending(ensemble, at)
    pull = np.einsum("aib,ib->ab", place.D, gradient)
    multiplier = solve(place.A, pull - bending)[-1]
    W = np.einsum("aib,ab->ib", place.D, B[:, -1])
    K = np.einsum("cib,aib->cab", part.jacobian_rate(at.q, W), place.D)
    G = np.einsum("acb,cab->b", B, K)
    log_weight = -log_determinant(place.A)
    if not fixman and len(B) > 1:
        A_s = place.A[:-1, :-1]
        G = G - np.einsum("acb,cab->b", inverse(A_s), K[:-1, :-1])
        log_weight = log_weight + log_determinant(A_s)
    return Instant(np.exp(0.5 * log_weight), multiplier, ensemble.kT * G)


def _bending(ensemble: Ensemble, at: Walkers) -> Array:
    """Return v . H_a v of all rows, (m, chains), averaged over velocities if that is cheap."""
    ((part,), (place,)), space = (ensemble.manifold.parts, at.places), ensemble.space
    velocities = [at.v]
    if space.size <= _AVERAGED:
        spread = np.sqrt(ensemble.kT / space.mass)
        unit = np.repeat(np.diag(spread)[:, :, None], at.q.shape[1], axis=2)
        velocities = [part.project(place, v) for v in unit]
    total = np.zeros(place.J.shape[::2])
    for v in velocities:
        total += np.einsum("aib,ib->ab", part.jacobian_rate(at.q, v), v)
    return total


class Instant(NamedTuple):
    """Terms of the mean force at states of chains.

    Attributes:
        weight: Weight w, shape (chains,).
        multiplier: Multiplier lam_xi, perhaps averaged over velocities, shape (chains,).
        correction: Term kT G, shape (chains,).
    """

    weight: Array
    multiplier: Array
    correction: Array


def free_energy(forces: Sequence[MeanForce]) -> Profile:
    """Integrate mean forces, on each interval by a cubic through its neighbours.

    Args:
        forces: Mean forces at values that rise or fall.
    """
    levels = np.array([each.level for each in forces])
    means, errors = (np.array([each.force[i] for each in forces]) for i in (0, 1))
    S = _integrals(levels)
    return Profile(S.dot(means), np.sqrt((S**2).dot(errors**2)))


def _integrals(x: Array) -> Array:
    """Return the matrix that integrates values from the first node to each, shape (n, n)."""
    n = len(x)
    S, size = np.zeros((n, n)), min(_NODES, n)
    for k in range(n - 1):
        first = min(max(k - 1, 0), n - size)
        near = slice(first, first + size)
        middle, half = 0.5 * (x[k] + x[k + 1]), 0.5 * (x[k + 1] - x[k])
        powers = np.arange(size)
        integral = half * (1.0 - (-1.0) ** (powers + 1)) / (powers + 1)
        columns = np.vander((x[near] - middle) / half, size, increasing=True)
        S[k + 1] = S[k]
        S[k + 1, near] += np.linalg.solve(columns.T, integral)
    return S


class Profile(NamedTuple):
    """Free energy at the values of the coordinate, 0 at the first one.

    Attributes:
        energy: Free energies, shape (values,).
        errors: Standard errors of the differences to the first one.
    """

    energy: Array
    errors: Array


def average(x: Array) -> Average:
    """Compute the average of a quantity and its accuracy.

    Source: A. Gelman et al., Bayesian Data Analysis, 3rd ed. 2013, 11.4 and 11.5; A. Vehtari et
    al., Bayesian Analysis 16, 2021, 667; C. J. Geyer, Statist. Sci. 7, 1992, 473 (where sums of
    autocorrelations end).

    Args:
        x: Values, shape (chains, samples), of at least 8 samples.
    """
    halves = _halves(x)
    m, n = halves.shape
    mean = float(x.mean())
    within = float(halves.var(axis=1, ddof=1).mean())
    between = float(halves.mean(axis=1).var(ddof=1))
    total = within * (n - 1) / n + between
    if total <= (8.0 * np.finfo(float).eps * max(abs(mean), 1e-300)) ** 2:
        return Average(mean, 0.0, 0.0, 1.0, float(x.size), 1.0)
    covariance = _autocovariance(halves).mean(axis=0)
    rho = 1.0 - (within - covariance * n / (n - 1)) / total
    time = _summed(rho)
    effective = min(m * n / time, float(m * n) * np.log10(max(m * n, 10)))
    rhat = float(np.sqrt(total / max(within, _STILL * total)))
    return Average(
        mean, float(np.sqrt(total / effective)), float(np.sqrt(total)), time, effective, rhat
    )


def _halves(x: Array) -> Array:
    half = x.shape[1] // 2
    return np.concatenate([x[:, :half], x[:, x.shape[1] - half :]])


def _autocovariance(x: Array) -> Array:
    """Return the autocovariance of each row by all lags, shape of x."""
    n = x.shape[1]
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(x - x.mean(axis=1, keepdims=True), size, axis=1)
    covariance: Array = np.fft.irfft(spectrum * spectrum.conj(), size, axis=1)[:, :n] / n
    return covariance


def _summed(rho: Array) -> float:
    """Return 1 + 2 sum of autocorrelations, as long as sums of pairs are positive and fall."""
    pairs = rho[: len(rho) // 2 * 2].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pairs <= 0.0)
    pairs = pairs[: negative[0]] if len(negative) else pairs
    return float(max(2.0 * np.minimum.accumulate(pairs).sum() - 1.0, 0.05)) if len(pairs) else 1.0


class Average(NamedTuple):
    """Average of a quantity.

    Attributes:
        mean: Mean over all samples of all chains.
        error: Standard error of the mean.
        spread: Standard deviation of the quantity.
        time: Integrated autocorrelation time in samples, 1 for independent samples.
        effective: Number of independent samples with the same standard error.
        rhat: Split R-hat, 1 if halves of chains agree; above 1.01 they do not.
    """

    mean: float
    error: float
    spread: float
    time: float
    effective: float
    rhat: float


def ratio(above: Array, below: Array) -> Average:
    """Return the average of `above` over that of `below`, with the error of both.

    Args:
        above: Values, shape (chains, samples).
        below: Values > 0, shape (chains, samples).
    """
    value = float(above.mean() / below.mean())
    deviation = average((above - value * below) / below.mean())
    return deviation._replace(mean=value)


def histogram(x: Array, edges: Array) -> Histogram:
    """Compute the shares of samples in bins, with their standard errors.

    Args:
        x: Values, shape (chains, samples).
        edges: Edges of the bins, shape (bins + 1,).
    """
    bins = np.searchsorted(edges, x, side="right") - 1
    bins = np.where(x == edges[-1], len(edges) - 2, bins)
    averages = [average((bins == k).astype(float)) for k in range(len(edges) - 1)]
    shares, errors = ([each[i] for each in averages] for i in (0, 1))
    return Histogram(edges, np.array(shares), np.array(errors))


class Histogram(NamedTuple):
    """Shares of samples in bins.

    Attributes:
        edges: Edges of the bins, shape (bins + 1,).
        shares: Shares of all samples, including those outside of the edges, shape (bins,).
        errors: Standard errors of the shares, shape (bins,).
    """

    edges: Array
    shares: Array
    errors: Array
