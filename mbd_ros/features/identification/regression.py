"""Weighted regression of base parameters and friction, with the delay of the efforts.

The rows of the regressor come in blocks from `problem`; `least_squares` solves them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import TINY
from mbd_ros.features.identification.least_squares import (
    CovarianceSum,
    Fit,
    Joint,
    Noise,
    TriangularFactor,
    default_columns,
    estimate_noise,
    fit_parameters,
    select_friction,
)
from mbd_ros.features.identification.problem import Block
from mbd_ros.features.identification.regressor import Column

Blocks = Callable[[Array], Iterable[Block]]  # takes delays of the efforts
_REWEIGHTINGS = 3  # at most
_OUTLIER = 3.0  # standard deviations: larger residuals weigh less (Huber)
_NORMAL = 1.4826  # standard deviation of normal numbers over the median of their size
_DELAYS = 41  # number of delays that are compared
_DEFAULT_SHARE = 0.5  # independent rows per row, assumed until residuals are known


def regress(
    blocks: Blocks,
    columns: Sequence[tuple[Column, ...]],
    r: int,
    allowed: Sequence[str],
    search: DelaySearch,
    correlation: Array,
) -> Regression:
    """Fit base parameters and friction by robust, iteratively reweighted least squares.

    Each iteration fits the parameters, selects the friction terms of each joint, and reduces the
    weight of rows that no selection explains.

    Args:
        blocks: Returns the rows for delays of the efforts [s]; it is called several times.
        columns: Candidates of friction of each row.
        r: Number of base parameters.
        allowed: Terms of friction that may be selected.
        search: Range of delays of the efforts.
        correlation: Autocorrelation of filtered white noise, starting with 1, shape (k,).

    Source: P. J. Huber, Robust Statistics, 1981, section 7.8 (weights).
    """
    delay = estimate_delay(blocks, columns, r, allowed, search, correlation)
    delays = np.array([delay])
    fit = fit_default_friction(blocks, columns, r, allowed, delay)
    for _ in range(_REWEIGHTINGS):
        errors = residuals(blocks(delays), fit)
        noise = [estimate_noise(row_errors, correlation) for row_errors in errors]
        weights = _Weights(fit, _huber_limits(errors))
        joints = _joints(_factors(blocks(delays), columns, weights), columns, r, 0, noise)
        selection = select_friction(joints, allowed, r, fit.deviation)
        is_same = tuple(selection) == fit.selection
        fit = fit_parameters(joints, selection, r)
        if is_same:
            break
    noise = [estimate_noise(each, correlation) for each in residuals(blocks(delays), fit)]
    sums = CovarianceSum(noise, fit.selection, r)
    for block in _weighted(blocks(delays), weights):
        sums.add(block.X, block.F, block.mask)
    return Regression(fit, joints, sums.covariance(fit), delay, noise)


class DelaySearch(NamedTuple):
    """Range in which the delay of efforts against the motion is searched.

    Attributes:
        reach: Longest delay [s]; 0 switches the search off.
        least: Shortest delay that counts, half a sampling step of the recording [s].
    """

    reach: float
    least: float


class Regression(NamedTuple):
    """Result of `regress`.

    Attributes:
        fit: Base parameters and friction.
        joints: Triangular factors of the weighted rows.
        covariance: Covariance of the base parameters, followed by friction, shape (r + f, r + f).
        delay: Delay of efforts against motion [s].
        noise: Noise of the residuals of each row.
    """

    fit: Fit
    joints: list[Joint]
    covariance: Array
    delay: float
    noise: list[Noise]


def estimate_delay(
    blocks: Blocks,
    columns: Sequence[tuple[Column, ...]],
    r: int,
    allowed: Sequence[str],
    search: DelaySearch,
    correlation: Array,
) -> float:
    """Return the delay of efforts against the motion [s], or 0 where it is negligible.

    The arguments are those of `regress`.
    """
    if search.reach <= 0.0:
        return 0.0
    fit = fit_default_friction(blocks, columns, r, allowed, 0.0)
    noise = [estimate_noise(e, correlation) for e in residuals(blocks(np.zeros(1)), fit)]
    delay = search_delay(blocks, columns, r, allowed, search.reach, noise)
    return delay if abs(delay) > search.least else 0.0


def fit_default_friction(
    blocks: Blocks,
    columns: Sequence[tuple[Column, ...]],
    r: int,
    allowed: Sequence[str],
    delay: float,
) -> Fit:
    """Fit the base parameters together with the default friction terms of all joints."""
    joints = _joints(_factors(blocks(np.array([delay])), columns, None), columns, r)
    return fit_parameters(joints, [default_columns(joint, allowed) for joint in joints], r)


def _joints(
    factors: Sequence[TriangularFactor],
    columns: Sequence[tuple[Column, ...]],
    r: int,
    torque: int = 0,
    noise: Sequence[Noise] = (),
) -> list[Joint]:
    """Return the factors reduced to one of their torques each.

    Args:
        torque: Index of that torque, one per delay.
    """
    joints = []
    for i, (factor, candidates) in enumerate(zip(factors, columns, strict=True)):
        R, rows = factor.R, factor.rows
        y = R[:, r + len(candidates) + torque]
        share = noise[i].share if noise else _DEFAULT_SHARE
        rms = float(np.linalg.norm(y) / np.sqrt(max(rows, 1)))
        reduced = np.column_stack([R[:, : r + len(candidates)], y])
        joints.append(Joint(reduced, rows, share * rows, candidates, rms))
    return joints


def _factors(
    blocks: Iterable[Block], columns: Sequence[tuple[Column, ...]], weights: _Weights | None
) -> list[TriangularFactor]:
    """Return the factor of each row: base parameters, candidates of friction, torques."""
    factors: list[TriangularFactor] = []
    for block in _weighted(blocks, weights):
        r, delays = block.X.shape[2], block.Y.shape[2]
        factors = factors or [TriangularFactor(r + len(c) + delays) for c in columns]
        for i, factor in enumerate(factors):
            rows = np.hstack([block.X[:, i], block.F[i], block.Y[:, i]])
            factor.add(rows[block.mask[:, i]])
    return [factor.close() for factor in factors]


class _Weights(NamedTuple):
    """Huber weights of rows.

    Attributes:
        fit: Fit whose residuals determine the weights.
        limits: Residuals beyond which rows weigh less [N·m or N], shape (m,).
    """

    fit: Fit
    limits: Array


def _weighted(blocks: Iterable[Block], weights: _Weights | None) -> Iterator[Block]:
    """Yield the rows multiplied by the square roots of their weights."""
    for block in blocks:
        if weights is None:
            yield block
            continue
        size = np.maximum(np.abs(residual(block, weights.fit)), TINY)
        root = np.sqrt(np.minimum(np.maximum(weights.limits, TINY) / size, 1.0))
        F = [root[:, i, None] * candidates for i, candidates in enumerate(block.F)]
        yield Block(
            root[:, :, None] * block.X, F, root[:, :, None] * block.Y, block.mask, block.known
        )


def residual(block: Block, fit: Fit) -> Array:
    """Return measured minus fitted torques for the first delay of a block, shape (n, m)."""
    error = block.Y[:, :, 0] - block.X @ fit.base
    for i, (selected, values) in enumerate(zip(fit.selection, fit.friction, strict=True)):
        error[:, i] -= block.F[i][:, selected] @ values
    return np.asarray(error)


def residuals(blocks: Iterable[Block], fit: Fit) -> list[Array]:
    """Return the residuals of the valid rows, one array per row of the regressor."""
    errors: list[list[Array]] = [[] for _ in fit.selection]
    for block in blocks:
        error = residual(block, fit)
        for i, row_errors in enumerate(errors):
            row_errors.append(error[block.mask[:, i], i])
    return [np.concatenate(row_errors) for row_errors in errors]


def search_delay(
    blocks: Blocks,
    columns: Sequence[tuple[Column, ...]],
    r: int,
    allowed: Sequence[str],
    reach: float,
    noise: Sequence[Noise],
) -> float:
    """Return the delay of the efforts with the smallest residual, or 0 if none is better.

    Args:
        blocks: Returns the rows for delays of the efforts [s].
        columns: Candidates of friction of each row.
        r: Number of base parameters.
        allowed: Terms of friction that may be selected.
        reach: Longest delay of the search [s].
        noise: Noise of the residuals without a delay.
    """
    delays, middle = np.linspace(-reach, reach, _DELAYS), _DELAYS // 2
    factors = _factors(blocks(delays), columns, None)
    undelayed = _joints(factors, columns, r, middle, noise)
    selection = [default_columns(joint, allowed) for joint in undelayed]
    weights, costs = fit_parameters(undelayed, selection, r).deviation, np.zeros(_DELAYS)
    for k in range(_DELAYS):
        shifted = _joints(factors, columns, r, k)
        deviations = fit_parameters(shifted, selection, r).deviation / weights
        costs[k] = sum(j.rows * d**2 for j, d in zip(shifted, deviations, strict=True))
    return _minimum(delays, costs, sum(joint.effective for joint in undelayed))


def _minimum(delays: Array, costs: Array, effective: float) -> float:
    """Return the vertex of the parabola through the smallest cost.

    The result is 0 where the gain is not worth one parameter by Schwarz's criterion.
    """
    best, middle = int(np.argmin(costs)), len(delays) // 2
    gain = effective * np.log(costs[middle] / costs[best]) if costs[best] > 0.0 else 0.0
    if gain <= np.log(max(effective, 2.0)) or best in (0, len(delays) - 1):
        return 0.0
    before, here, after = costs[best - 1 : best + 2]
    curvature = before - 2.0 * here + after
    shift = 0.5 * (before - after) / curvature if curvature > 0.0 else 0.0
    return float(delays[best] + shift * (delays[1] - delays[0]))


def _huber_limits(errors: Sequence[Array]) -> Array:
    """Return the residuals beyond which rows weigh less, by the median of each row."""
    sizes = [float(np.median(np.abs(e))) if len(e) else np.inf for e in errors]
    return _OUTLIER * _NORMAL * np.array(sizes)
