"""Base parameters and friction from triangles of rows, one triangle a joint."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import SINGULAR, TINY
from mbd_ros.features.identification.factors import triangle_of
from mbd_ros.features.identification.friction import Column, choices

_FLOOR = 1.0e-11  # of the usual torque: deviations below are rounding
_SWEEPS = 4


class Joint(NamedTuple):
    """What least squares sees of a joint.

    Attributes:
        R: Triangle of columns: base parameters, candidates of friction, torque; shape (k, ..).
        rows: How many rows it stands for.
        effective: How many independent ones these are worth.
        columns: The candidates.
        usual: Root mean square of the torque [N·m or N].
    """

    R: Array
    rows: int
    effective: float
    columns: tuple[Column, ...]
    usual: float


class Fit(NamedTuple):
    """Weighted least squares.

    Attributes:
        base: Base parameters, shape (r,).
        friction: Values of the columns of each joint that are taken.
        taken: Places of these columns among the candidates, of each joint.
        deviation: Standard deviation of each joint [N·m or N], shape (m,).
        condition: Condition number of the scaled, weighted columns.
    """

    base: Array
    friction: tuple[Array, ...]
    taken: tuple[tuple[int, ...], ...]
    deviation: Array
    condition: float


def fit(joints: Sequence[Joint], taken: Sequence[tuple[int, ...]], r: int) -> Fit:
    """Iteratively reweighted least squares, one deviation a joint.

    Args:
        joints: The joints.
        taken: Columns of each that are taken.
        r: Number of base parameters.

    Source: M. Gautier, P. Poignet, Control Eng. Practice 9, 2001, 1361 (weights by joint).
    """
    deviation = np.array([max(joint.usual, TINY) for joint in joints])
    for _ in range(_SWEEPS):
        A, b = stacked(joints, taken, r, deviation)
        x, condition = solved(A, b)
        each = list(zip(joints, taken, _each(x, taken, r), strict=True))
        left = [(j, _left(j, own, r, y)) for j, own, y in each]
        deviation = np.array([max(rms, _FLOOR * j.usual, TINY) for j, rms in left])
    parts = tuple(y[r:] for y in _each(x, taken, r))
    return Fit(x[:r], parts, tuple(taken), deviation, condition)


def solved(A: Array, b: Array) -> tuple[Array, float]:
    """Least squares with scaled columns, shortest where columns depend; condition of them."""
    scale = np.linalg.norm(A, axis=0)
    scale[scale == 0.0] = 1.0
    x, _, _, s = np.linalg.lstsq(A / scale, b, rcond=SINGULAR**1.5)
    condition = float(s[0] / s[-1]) if len(s) and s[-1] > 0.0 else np.inf
    return (x.T / scale).T, condition


def select(
    joints: Sequence[Joint], allowed: Sequence[str], r: int, deviation: Array
) -> list[tuple[int, ...]]:
    """Columns of friction, joint by joint, by Schwarz's information criterion.

    Args:
        joints: The joints.
        allowed: Terms that may be taken.
        r: Number of base parameters.
        deviation: Of each joint with many columns taken [N·m or N].

    Source: G. Schwarz, Ann. Stat. 6, 1978, 461.
    """
    price = np.log(sum(joint.effective for joint in joints))
    taken: list[tuple[int, ...]] = [usual_choice(joint, allowed) for joint in joints]
    for _ in range(_SWEEPS):
        before = list(taken)
        for i, joint in enumerate(joints):
            rest = _rest(joints, taken, r, deviation, i)
            weight = _weight(joint, deviation[i])
            none = np.zeros((len(rest), len(joint.columns)))
            others = np.hstack([rest[:, :r], none, rest[:, r:]])
            whole = np.concatenate([others, weight * joint.R])
            left = triangle_of(whole)[r:, r:]
            every = choices(joint.columns, allowed)
            taken[i] = _cheapest(left, joint.columns, every, float(price))
        if taken == before:
            break
    return taken


def _weight(joint: Joint, deviation: float) -> float:
    """Of rows: neighbours that repeat each other count as less."""
    return float(np.sqrt(joint.effective / max(joint.rows, 1)) / deviation)


def usual_choice(joint: Joint, allowed: Sequence[str]) -> tuple[int, ...]:
    """Viscous and dry friction and an offset, to start from."""
    found = {c.term: i for i, c in reversed(list(enumerate(joint.columns))) if c.term in allowed}
    dry = [i for i, c in enumerate(joint.columns) if c.term == "coulomb" and "coulomb" in allowed]
    middle = dry[len(dry) // 2 : len(dry) // 2 + 1]
    return (*middle, *(found[t] for t in ("viscous", "offset") if t in found))


def _cheapest(
    left: Array, columns: Sequence[Column], every: list[tuple[int, ...]], price: float
) -> tuple[int, ...]:
    """Choice of the smallest criterion, none that drives instead of rubbing.

    Args:
        left: Columns of the candidates and the torque, all else eliminated.
        columns: The candidates.
        every: Choices.
        price: Of a column.
    """
    y, best, cheapest = left[:, -1], np.inf, every[0]
    scale = np.linalg.norm(left[:, :-1], axis=0)
    scale[scale == 0.0] = 1.0
    scaled = left[:, :-1] / scale
    signed = np.array([column.term != "offset" for column in columns], dtype=np.bool_)
    for choice in every:
        x, cost = np.zeros(0), price * len(choice)
        if choice:
            x = np.linalg.lstsq(scaled[:, choice], y, rcond=SINGULAR)[0]
        cost += float(np.sum(np.square(y - scaled[:, choice] @ x)))
        if cost < best and (x[signed[list(choice)]] >= 0.0).all():
            best, cheapest = cost, choice
    return cheapest


def _rest(
    joints: Sequence[Joint], taken: Sequence[tuple[int, ...]], r: int, deviation: Array, but: int
) -> Array:
    """Triangle of base parameters and torque of all other joints, their friction eliminated."""
    pieces, friction = [], []
    for i, (joint, own) in enumerate(zip(joints, taken, strict=True)):
        if i == but:
            continue
        R = _weight(joint, deviation[i]) * joint.R
        pieces.append(np.hstack([R[:, :r], R[:, -1:]]))
        friction.append(R[:, [r + k for k in own]])
    if not pieces:
        return np.zeros((0, r + 1))
    n = sum(f.shape[1] for f in friction)
    blocks, at = [], 0
    for piece, f in zip(pieces, friction, strict=True):
        blocks.append(np.hstack([np.zeros((len(f), n)), piece]))
        blocks[-1][:, at : at + f.shape[1]] = f
        at += f.shape[1]
    rest: Array = triangle_of(np.concatenate(blocks))[n:, n:]
    return rest


def stacked(
    joints: Sequence[Joint], taken: Sequence[tuple[int, ...]], r: int, deviation: Array
) -> tuple[Array, Array]:
    """All rows, base parameters first, then the columns taken of each joint; and torques."""
    n, at, blocks, known = sum(map(len, taken)), r, [], []
    for joint, own, sigma in zip(joints, taken, deviation, strict=True):
        block = np.zeros((len(joint.R), r + n))
        block[:, :r] = joint.R[:, :r]
        block[:, at : at + len(own)] = joint.R[:, [r + k for k in own]]
        at += len(own)
        blocks.append(block / sigma)
        known.append(joint.R[:, -1] / sigma)
    return np.concatenate(blocks), np.concatenate(known)


def _each(x: Array, taken: Sequence[tuple[int, ...]], r: int) -> Iterator[Array]:
    """Base parameters and friction of each joint."""
    at = r
    for own in taken:
        yield np.concatenate([x[:r], x[at : at + len(own)]])
        at += len(own)


def _left(joint: Joint, own: tuple[int, ...], r: int, y: Array) -> float:
    """Root mean square of what is left of the torque."""
    left = joint.R[:, -1] - joint.R[:, [*range(r), *(r + k for k in own)]] @ y
    return float(np.linalg.norm(left) / np.sqrt(max(joint.rows, 1)))
