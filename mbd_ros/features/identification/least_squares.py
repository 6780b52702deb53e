"""Base parameters and friction from triangles of rows, weighted by their noise.

Many rows are kept as one triangle a joint, so that memory does not grow with them: R of
[A b] = Q R has all that a least-squares problem of any of its columns needs, and loses half the
digits that A'A would.

Source: A. Bjorck, Numerical Methods for Least Squares Problems, 1996, section 2.4.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import SINGULAR, TINY
from mbd_ros.errors import SolveError
from mbd_ros.features.identification.regressor import Column, choices

_SIZES = "sizes of motion and efforts are too far apart"
_FLOOR = 1.0e-11  # of the usual torque: deviations below are rounding
_SWEEPS = 4  # of weights and of choices of friction, at most
_HIGHEST_ORDER = 8  # of the process
_SLOW_POWER = 2.0  # times that of white noise at the lowest frequencies: the model lacks something
_PER_ORDER = 20  # residuals that a coefficient needs


def fit(joints: Sequence[Joint], taken: Sequence[tuple[int, ...]], r: int) -> Fit:
    """Iteratively reweighted least squares, one deviation a joint.

    Args:
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


class Joint(NamedTuple):
    """What least squares sees of a joint.

    Attributes:
        R: Triangle of columns: base parameters, candidates of friction, torque; shape (k, ..).
        rows: How many rows it stands for.
        effective: How many independent ones these are worth.
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


def solved(A: Array, b: Array) -> tuple[Array, float]:
    """Least squares with scaled columns, shortest where columns depend; condition of them."""
    scale = np.linalg.norm(A, axis=0)
    if not (np.isfinite(scale).all() and np.isfinite(b).all()):
        raise SolveError(f"least squares are not finite: {_SIZES}")
    scale[scale == 0.0] = 1.0
    x, _, _, s = np.linalg.lstsq(A / scale, b, rcond=SINGULAR**1.5)
    condition = float(s[0] / s[-1]) if len(s) and s[-1] > 0.0 else np.inf
    return (x.T / scale).T, condition


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


def select(
    joints: Sequence[Joint], allowed: Sequence[str], r: int, deviation: Array
) -> list[tuple[int, ...]]:
    """Columns of friction, joint by joint, by Schwarz's information criterion.

    Args:
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


def usual_choice(joint: Joint, allowed: Sequence[str]) -> tuple[int, ...]:
    """Viscous and dry friction and an offset, to start from."""
    found = {c.term: i for i, c in reversed(list(enumerate(joint.columns))) if c.term in allowed}
    dry = [i for i, c in enumerate(joint.columns) if c.term == "coulomb" and "coulomb" in allowed]
    middle = dry[len(dry) // 2 : len(dry) // 2 + 1]
    return (*middle, *(found[t] for t in ("viscous", "offset") if t in found))


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


def _weight(joint: Joint, deviation: float) -> float:
    """Of rows: neighbours that repeat each other count as less."""
    return float(np.sqrt(joint.effective / max(joint.rows, 1)) / deviation)


def triangle_of(rows: Array) -> Array:
    """R of rows = Q R, shape (min(n, m), m)."""
    R: Array = np.asarray(np.linalg.qr(rows, mode="r"))
    return R


def _cheapest(
    left: Array, columns: Sequence[Column], every: list[tuple[int, ...]], price: float
) -> tuple[int, ...]:
    """Choice of the smallest criterion, none that drives instead of rubbing.

    Args:
        left: Columns of the candidates and the torque, all else eliminated.
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
    return process if slow**2 > _SLOW_POWER * level else white


class Noise(NamedTuple):
    """Residuals of a row that repeat their neighbours.

    White noise is correlated behind a filter, as its taps say. Residuals with more at low
    frequencies, where the model lacks something, are taken for an autoregressive process.

    Source: P. J. Brockwell, R. A. Davis, Time Series, 1991, chapter 8 (Yule-Walker).

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


def _process(left: Array) -> Noise:
    """Autoregressive process, its order by Akaike's criterion."""
    n, none = len(left), np.zeros(0)
    most = min(_HIGHEST_ORDER, n // _PER_ORDER)
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


class Spread:
    """Covariance of estimates from weighted rows that come in blocks.

    With the correlation C of residuals, estimates by A = sum X' W X have the covariance
    A^-1 (sum X' W C W X) A^-1.

    Source: H. White, Econometrica 48, 1980, 817 (covariance of weighted estimates).

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
        if not (np.square(np.square(fit.deviation)) > 0.0).all():
            raise SolveError(
                "a joint has no deviation: its torques are all 0, or it always rests beside its "
                "largest velocity; leave this joint out, or mend its columns"
            )
        for own, sigma, plain, sums in zip(
            self._taken, fit.deviation, self._plain, self._sums, strict=True
        ):
            places = np.r_[np.arange(r), at + np.arange(len(own))]
            A[np.ix_(places, places)] += plain / sigma**2
            S[np.ix_(places, places)] += sums / sigma**4
            at += len(own)
        if not np.isfinite(A).all():
            raise SolveError(f"deviations of the estimates are not finite: {_SIZES}")
        scale = np.sqrt(np.maximum(np.diag(A), np.finfo(np.float64).tiny))
        inverse = np.linalg.pinv(A / np.outer(scale, scale), hermitian=True) / np.outer(
            scale, scale
        )
        worth = sum(self._worth)
        covariance: Array = inverse @ S @ inverse * (worth / max(worth - r - n, 1.0))
        return covariance


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


def rows_by_worth(
    joints: Sequence[Joint], fit: Fit, r: int, least: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Rows and torques over their deviations, weighed by what they are worth.

    Args:
        joints: The joints of a fit.
        r: Number of base parameters.
        least: Deviations that rows have at least [N·m or N], shape (m,).

    Returns:
        A, b, and which friction is not negative, shape (f,).
    """
    worth = np.array([np.sqrt(max(j.effective, 1.0) / max(j.rows, 1)) for j in joints])
    A, b = stacked(joints, fit.taken, r, np.maximum(fit.deviation, least) / worth)
    pairs = zip(joints, fit.taken, strict=True)
    signed = [joint.columns[k].term != "offset" for joint, own in pairs for k in own]
    return A, b, np.array(signed, dtype=np.bool_)


class Triangle:
    """Upper triangle R of rows that come in pieces.

    Args:
        columns: How many a row has.

    Attributes:
        R: Shape (k, columns), k at most `columns`.
        rows: How many rows came.
    """

    def __init__(self, columns: int) -> None:
        self.R, self.rows = np.zeros((0, columns)), 0
        self._pieces: list[Array] = []
        self._waiting = 0

    def add(self, rows: Array) -> None:
        """Take rows, shape (n, columns)."""
        self._pieces.append(rows)
        self._waiting += len(rows)
        self.rows += len(rows)
        if self._waiting > 8 * rows.shape[1]:
            self.close()

    def close(self) -> Triangle:
        """Fold in rows that wait; returns itself."""
        if self._waiting:
            self.R = triangle_of(np.concatenate([self.R, *self._pieces]))
            self._pieces, self._waiting = [], 0
        return self
