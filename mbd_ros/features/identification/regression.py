"""From blocks of rows to base parameters and friction: delay, choice of friction, weights."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import TINY
from mbd_ros.features.identification.least_squares import (
    Fit,
    Joint,
    Noise,
    Spread,
    Triangle,
    fit,
    noise_of,
    select,
    usual_choice,
)
from mbd_ros.features.identification.problem import Block
from mbd_ros.features.identification.regressor import Column

Blocks = Callable[[Array], Iterable[Block]]  # of delays
_REWEIGHTINGS = 3  # at most
_OUTLIER = 3.0  # standard deviations: larger residuals weigh less (Huber)
_NORMAL = 1.4826  # standard deviation over median of the size, of normal numbers
_DELAYS = 41  # tried at once
_USUAL_SHARE = 0.5  # of the rows that the filter keeps, before their residuals are known


def learn(
    blocks: Blocks,
    columns: Sequence[tuple[Column, ...]],
    r: int,
    allowed: Sequence[str],
    search: Search,
    correlation: Array,
) -> Learned:
    """Iterate: fit, choose friction, weigh rows down that no choice explains.

    Args:
        blocks: Gives the rows, for delays of the efforts [s], as often as asked.
        columns: Candidates of friction of each row.
        r: Number of base parameters.
        allowed: Terms of friction that may be taken.
        search: For the delay of efforts.
        correlation: Of white noise behind the filter, 1 first, shape (k,).

    Source: P. J. Huber, Robust Statistics, 1981, section 7.8 (weights).
    """
    delay = delay_of(blocks, columns, r, allowed, search, correlation)
    at = np.array([delay])
    found = first_fit(blocks, columns, r, allowed, delay)
    for _ in range(_REWEIGHTINGS):
        left = residuals(blocks(at), found)
        noise = [noise_of(each, correlation) for each in left]
        weights = _Weights(found, _limits(left))
        joints = _joints(_triangles(blocks(at), columns, weights), columns, r, 0, noise)
        taken = select(joints, allowed, r, found.deviation)
        is_same = tuple(taken) == found.taken
        found = fit(joints, taken, r)
        if is_same:
            break
    left = residuals(blocks(at), found)
    noise = [noise_of(each, correlation) for each in left]
    sums = Spread(noise, found.taken, r)
    for block in _weighted(blocks(at), weights):
        sums.add(block.X, block.F, block.kept)
    covariance = sums.covariance(found)
    return Learned(found, joints, covariance, delay, noise)


class Search(NamedTuple):
    """Which delays are looked for.

    Attributes:
        reach: Longest one [s]; 0 for none.
        least: Shortest one that counts, half a step of the recording [s].
    """

    reach: float
    least: float


class Learned(NamedTuple):
    """What rows say.

    Attributes:
        fit: Base parameters and friction.
        joints: Triangles that they are from.
        covariance: Of base parameters, then friction, shape (r + f, r + f).
        delay: Of efforts against motion [s].
        noise: Of the residuals of each row.
    """

    fit: Fit
    joints: list[Joint]
    covariance: Array
    delay: float
    noise: list[Noise]


def delay_of(
    blocks: Blocks,
    columns: Sequence[tuple[Column, ...]],
    r: int,
    allowed: Sequence[str],
    search: Search,
    correlation: Array,
) -> float:
    """Delay of efforts against the motion [s], 0 where it does not count; as for `learn`."""
    if search.reach <= 0.0:
        return 0.0
    found = first_fit(blocks, columns, r, allowed, 0.0)
    noise = [noise_of(e, correlation) for e in residuals(blocks(np.zeros(1)), found)]
    delay = find_delay(blocks, columns, r, allowed, search.reach, noise)
    return delay if abs(delay) > search.least else 0.0


def first_fit(
    blocks: Blocks,
    columns: Sequence[tuple[Column, ...]],
    r: int,
    allowed: Sequence[str],
    delay: float,
) -> Fit:
    """Fit with the usual friction of joints."""
    joints = _joints(_triangles(blocks(np.array([delay])), columns, None), columns, r)
    return fit(joints, [usual_choice(joint, allowed) for joint in joints], r)


def _joints(
    triangles: Sequence[Triangle],
    columns: Sequence[tuple[Column, ...]],
    r: int,
    torque: int = 0,
    noise: Sequence[Noise] = (),
) -> list[Joint]:
    """Triangles with one of their torques each."""
    joints = []
    for i, (triangle, own) in enumerate(zip(triangles, columns, strict=True)):
        R, rows = triangle.R, triangle.rows
        y = R[:, r + len(own) + torque]
        share = noise[i].share if noise else _USUAL_SHARE
        usual = float(np.linalg.norm(y) / np.sqrt(max(rows, 1)))
        whole = np.column_stack([R[:, : r + len(own)], y])
        joints.append(Joint(whole, rows, share * rows, own, usual))
    return joints


def _triangles(
    blocks: Iterable[Block], columns: Sequence[tuple[Column, ...]], weights: _Weights | None
) -> list[Triangle]:
    """Triangle of each row: base parameters, candidates, torques."""
    triangles: list[Triangle] = []
    for block in _weighted(blocks, weights):
        r, delays = block.X.shape[2], block.Y.shape[2]
        triangles = triangles or [Triangle(r + len(own) + delays) for own in columns]
        for i, triangle in enumerate(triangles):
            rows = np.hstack([block.X[:, i], block.F[i], block.Y[:, i]])
            triangle.add(rows[block.kept[:, i]])
    return [triangle.close() for triangle in triangles]


class _Weights(NamedTuple):
    """How rows are weighed.

    Attributes:
        found: What they are compared with.
        limits: Residuals beyond which rows weigh less [N·m or N], shape (m,).
    """

    found: Fit
    limits: Array


def _weighted(blocks: Iterable[Block], weights: _Weights | None) -> Iterator[Block]:
    """Rows times the root of their weight."""
    for block in blocks:
        if weights is None:
            yield block
            continue
        size = np.maximum(np.abs(residual(block, weights.found)), TINY)
        root = np.sqrt(np.minimum(np.maximum(weights.limits, TINY) / size, 1.0))
        F = [root[:, i, None] * own for i, own in enumerate(block.F)]
        yield Block(
            root[:, :, None] * block.X, F, root[:, :, None] * block.Y, block.kept, block.known
        )


def residual(block: Block, found: Fit) -> Array:
    """What a fit leaves of the torques, the first delay, shape (n, m)."""
    left = block.Y[:, :, 0] - block.X @ found.base
    for i, (own, values) in enumerate(zip(found.taken, found.friction, strict=True)):
        left[:, i] -= block.F[i][:, own] @ values
    return np.asarray(left)


def residuals(blocks: Iterable[Block], found: Fit) -> list[Array]:
    """What a fit leaves of the torque of each row, those that count."""
    every: list[list[Array]] = [[] for _ in found.taken]
    for block in blocks:
        left = residual(block, found)
        for i, own in enumerate(every):
            own.append(left[block.kept[:, i], i])
    return [np.concatenate(own) for own in every]


def find_delay(
    blocks: Blocks,
    columns: Sequence[tuple[Column, ...]],
    r: int,
    allowed: Sequence[str],
    reach: float,
    noise: Sequence[Noise],
) -> float:
    """Delay of efforts against the motion with the smallest residual, 0 if that is no better.

    Args:
        blocks: Gives the rows, for delays of the efforts [s].
        columns: Candidates of friction of each row.
        r: Number of base parameters.
        allowed: Terms of friction that may be taken.
        reach: Longest delay that is looked for [s].
        noise: Of the residuals without a delay.
    """
    tried, middle = np.linspace(-reach, reach, _DELAYS), _DELAYS // 2
    triangles = _triangles(blocks(tried), columns, None)
    plain = _joints(triangles, columns, r, middle, noise)
    taken = [usual_choice(joint, allowed) for joint in plain]
    weights, costs = fit(plain, taken, r).deviation, np.zeros(_DELAYS)
    for k in range(_DELAYS):
        shifted = _joints(triangles, columns, r, k)
        found = fit(shifted, taken, r).deviation / weights
        costs[k] = sum(j.rows * d**2 for j, d in zip(shifted, found, strict=True))
    return _least(tried, costs, sum(joint.effective for joint in plain))


def _least(tried: Array, costs: Array, effective: float) -> float:
    """Vertex of the parabola through the smallest cost, 0 where that is not worth a parameter."""
    best, middle = int(np.argmin(costs)), len(tried) // 2
    gain = effective * np.log(costs[middle] / costs[best]) if costs[best] > 0.0 else 0.0
    if gain <= np.log(max(effective, 2.0)) or best in (0, len(tried) - 1):
        return 0.0
    before, here, after = costs[best - 1 : best + 2]
    bend = before - 2.0 * here + after
    shift = 0.5 * (before - after) / bend if bend > 0.0 else 0.0
    return float(tried[best] + shift * (tried[1] - tried[0]))


def _limits(left: Sequence[Array]) -> Array:
    """Residuals beyond which rows weigh less, by the median of each row."""
    sizes = [float(np.median(np.abs(own))) if len(own) else np.inf for own in left]
    return _OUTLIER * _NORMAL * np.array(sizes)
