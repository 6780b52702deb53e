"""Least squares for base parameters and friction, weighted by the noise of each joint.

The rows of a joint are reduced to one triangular factor, so that memory does not grow with them.
R of [A b] = Q R is all that a least-squares problem of any of its columns needs, and it loses half
as many digits as A'A would.

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
_FLOOR = 1.0e-11  # of the RMS torque: deviations below are rounding
_SWEEPS = 4  # of weights and of choices of friction, at most
_HIGHEST_ORDER = 8  # of the autoregressive process
_SLOW_POWER = 2.0  # times that of white noise at the lowest frequencies: a modelling error
_PER_ORDER = 20  # residuals that a coefficient needs


def fit_parameters(joints: Sequence[Joint], selection: Sequence[tuple[int, ...]], r: int) -> Fit:
    """Solve iteratively reweighted least squares with one standard deviation per joint.

    Args:
        selection: Indices of the selected friction columns of each joint.
        r: Number of base parameters.

    Source: M. Gautier, P. Poignet, Control Eng. Practice 9, 2001, 1361 (weights by joint).
    """
    deviation = np.array([max(joint.rms, TINY) for joint in joints])
    for _ in range(_SWEEPS):
        A, b = stack_rows(joints, selection, r, deviation)
        x, condition = solve_scaled(A, b)
        values = list(zip(joints, selection, _split_by_joint(x, selection, r), strict=True))
        errors = [(j, _rms_residual(j, columns, r, y)) for j, columns, y in values]
        deviation = np.array([max(rms, _FLOOR * j.rms, TINY) for j, rms in errors])
    parts = tuple(y[r:] for y in _split_by_joint(x, selection, r))
    return Fit(x[:r], parts, tuple(selection), deviation, condition)


class Joint(NamedTuple):
    """Rows of one joint in a least-squares problem, reduced to their triangular factor.

    Attributes:
        R: Factor of the columns: base parameters, candidates of friction, torque; shape (k, ..).
        rows: Number of rows that R stands for.
        effective: Number of independent rows that these are worth.
        columns: Candidates of friction.
        rms: Root mean square of the torque [N·m or N].
    """

    R: Array
    rows: int
    effective: float
    columns: tuple[Column, ...]
    rms: float


class Fit(NamedTuple):
    """Result of a weighted least-squares problem.

    Attributes:
        base: Base parameters, shape (r,).
        friction: Values of the selected friction columns of each joint.
        selection: Indices of these columns among the candidates, for each joint.
        deviation: Standard deviation of the residual of each joint [N·m or N], shape (m,).
        condition: Condition number of the scaled, weighted columns.
    """

    base: Array
    friction: tuple[Array, ...]
    selection: tuple[tuple[int, ...], ...]
    deviation: Array
    condition: float


def stack_rows(
    joints: Sequence[Joint], selection: Sequence[tuple[int, ...]], r: int, deviation: Array
) -> tuple[Array, Array]:
    """Return all rows with the base parameters first, then the selected columns; and torques."""
    n, start, blocks, torques = sum(map(len, selection)), r, [], []
    for joint, columns, sigma in zip(joints, selection, deviation, strict=True):
        block = np.zeros((len(joint.R), r + n))
        block[:, :r] = joint.R[:, :r]
        block[:, start : start + len(columns)] = joint.R[:, [r + k for k in columns]]
        start += len(columns)
        blocks.append(block / sigma)
        torques.append(joint.R[:, -1] / sigma)
    return np.concatenate(blocks), np.concatenate(torques)


def solve_scaled(A: Array, b: Array) -> tuple[Array, float]:
    """Solve least squares with scaled columns; also return their condition number.

    Where columns depend on each other, the solution is the shortest one.
    """
    scale = np.linalg.norm(A, axis=0)
    if not (np.isfinite(scale).all() and np.isfinite(b).all()):
        raise SolveError(f"the least-squares problem is not finite: {_SIZES}")
    scale[scale == 0.0] = 1.0
    x, _, _, s = np.linalg.lstsq(A / scale, b, rcond=SINGULAR**1.5)
    condition = float(s[0] / s[-1]) if len(s) and s[-1] > 0.0 else np.inf
    return (x.T / scale).T, condition


def _split_by_joint(x: Array, selection: Sequence[tuple[int, ...]], r: int) -> Iterator[Array]:
    """Yield the base parameters followed by the friction of each joint."""
    start = r
    for columns in selection:
        yield np.concatenate([x[:r], x[start : start + len(columns)]])
        start += len(columns)


def _rms_residual(joint: Joint, columns: tuple[int, ...], r: int, y: Array) -> float:
    """Return the root mean square of the residual torque of a joint."""
    error = joint.R[:, -1] - joint.R[:, [*range(r), *(r + k for k in columns)]] @ y
    return float(np.linalg.norm(error) / np.sqrt(max(joint.rows, 1)))


def select_friction(
    joints: Sequence[Joint], allowed: Sequence[str], r: int, deviation: Array
) -> list[tuple[int, ...]]:
    """Select the friction columns of each joint by Schwarz's information criterion.

    Args:
        allowed: Terms that may be selected.
        r: Number of base parameters.
        deviation: Standard deviation of each joint with many columns selected [N·m or N].

    Source: G. Schwarz, Ann. Stat. 6, 1978, 461.
    """
    price = np.log(sum(joint.effective for joint in joints))
    selection: list[tuple[int, ...]] = [default_columns(joint, allowed) for joint in joints]
    for _ in range(_SWEEPS):
        before = list(selection)
        for i, joint in enumerate(joints):
            others = _eliminate_friction(joints, selection, r, deviation, i)
            weight = _weight(joint, deviation[i])
            zeros = np.zeros((len(others), len(joint.columns)))
            others = np.hstack([others[:, :r], zeros, others[:, r:]])
            rows = np.concatenate([others, weight * joint.R])
            reduced = triangular_factor(rows)[r:, r:]
            options = choices(joint.columns, allowed)
            selection[i] = _cheapest(reduced, joint.columns, options, float(price))
        if selection == before:
            break
    return selection


def default_columns(joint: Joint, allowed: Sequence[str]) -> tuple[int, ...]:
    """Return the initial selection: viscous and dry friction and an offset, as far as allowed."""
    first = {c.term: i for i, c in reversed(list(enumerate(joint.columns))) if c.term in allowed}
    dry = [i for i, c in enumerate(joint.columns) if c.term == "coulomb" and "coulomb" in allowed]
    middle = dry[len(dry) // 2 : len(dry) // 2 + 1]
    return (*middle, *(first[t] for t in ("viscous", "offset") if t in first))


def _eliminate_friction(
    joints: Sequence[Joint],
    selection: Sequence[tuple[int, ...]],
    r: int,
    deviation: Array,
    excluded: int,
) -> Array:
    """Return the factor of base parameters and torque of all joints but one.

    The friction of these joints is eliminated.
    """
    pieces, friction = [], []
    for i, (joint, columns) in enumerate(zip(joints, selection, strict=True)):
        if i == excluded:
            continue
        R = _weight(joint, deviation[i]) * joint.R
        pieces.append(np.hstack([R[:, :r], R[:, -1:]]))
        friction.append(R[:, [r + k for k in columns]])
    if not pieces:
        return np.zeros((0, r + 1))
    n = sum(f.shape[1] for f in friction)
    blocks, start = [], 0
    for piece, f in zip(pieces, friction, strict=True):
        blocks.append(np.hstack([np.zeros((len(f), n)), piece]))
        blocks[-1][:, start : start + f.shape[1]] = f
        start += f.shape[1]
    factor: Array = triangular_factor(np.concatenate(blocks))[n:, n:]
    return factor


def _weight(joint: Joint, deviation: float) -> float:
    """Return the weight of the rows of a joint; correlated rows count as fewer."""
    return float(np.sqrt(joint.effective / max(joint.rows, 1)) / deviation)


def triangular_factor(rows: Array) -> Array:
    """Return R of rows = Q R, shape (min(n, m), m)."""
    R: Array = np.asarray(np.linalg.qr(rows, mode="r"))
    return R


def _cheapest(
    reduced: Array, columns: Sequence[Column], options: list[tuple[int, ...]], price: float
) -> tuple[int, ...]:
    """Return the selection with the smallest criterion among those that dissipate energy.

    Args:
        reduced: Columns of the candidates and the torque, all others eliminated.
        options: Selections that are compared.
        price: Cost of one column.
    """
    y, best, cheapest = reduced[:, -1], np.inf, options[0]
    scale = np.linalg.norm(reduced[:, :-1], axis=0)
    scale[scale == 0.0] = 1.0
    scaled = reduced[:, :-1] / scale
    signed = np.array([column.term != "offset" for column in columns], dtype=np.bool_)
    for choice in options:
        x, cost = np.zeros(0), price * len(choice)
        if choice:
            x = np.linalg.lstsq(scaled[:, choice], y, rcond=SINGULAR)[0]
        cost += float(np.sum(np.square(y - scaled[:, choice] @ x)))
        if cost < best and (x[signed[list(choice)]] >= 0.0).all():
            best, cheapest = cost, choice
    return cheapest


def estimate_noise(residuals: Array, correlation: Array) -> Noise:
    """Return filtered white noise, or an autoregressive process if residuals are slower.

    Args:
        residuals: Residuals of one row, shape (n,).
        correlation: Autocorrelation of filtered white noise, starting with 1, shape (k,).
    """
    share = float(1.0 / (1.0 + 2.0 * np.sum(np.square(correlation[1:]))))
    power = float(residuals @ residuals) / max(len(residuals), 1)
    white = Noise(correlation, np.zeros(0), float(np.sqrt(power)), share)
    process = _autoregressive_noise(residuals)
    slow = process.innovation / (1.0 - float(process.coefficients.sum()))
    level = power * max(float(1.0 + 2.0 * correlation[1:].sum()), 0.0)
    return process if slow**2 > _SLOW_POWER * level else white


class Noise(NamedTuple):
    """Correlated residuals of a row.

    White noise is correlated after a filter, as the taps of the filter say. Residuals with more
    power at low frequencies, where the model is incomplete, are modelled as an autoregressive
    process.

    Source: P. J. Brockwell, R. A. Davis, Time Series, 1991, chapter 8 (Yule-Walker).

    Attributes:
        correlation: Autocorrelation by distance in rows, starting with 1, shape (k,); empty for
            an autoregressive process.
        coefficients: c_k of e_t = sum c_k e_(t-k) + w_t, shape (p,).
        innovation: Standard deviation of w, or of the residuals if they are filtered white noise.
        share: Number of independent residuals per residual, where a variance is estimated.
    """

    correlation: Array
    coefficients: Array
    innovation: float
    share: float


def _autoregressive_noise(residuals: Array) -> Noise:
    """Fit an autoregressive process; Akaike's criterion determines its order."""
    n, empty = len(residuals), np.zeros(0)
    highest = min(_HIGHEST_ORDER, n // _PER_ORDER)
    power = float(residuals @ residuals) / max(n, 1)
    if highest == 0 or power == 0.0:
        return Noise(empty, empty, float(np.sqrt(power)), 1.0)
    c = np.array([residuals[: n - k] @ residuals[k:] for k in range(highest + 1)]) / n
    best, chosen, variance, cheapest = np.zeros(0), np.zeros(0), c[0], n * np.log(c[0])
    spread = variance
    for k in range(1, highest + 1):  # Levinson's recursion
        reflection = (c[k] - best @ c[1:k][::-1]) / spread
        best = np.r_[best - reflection * best[::-1], reflection]
        spread = max(spread * (1.0 - reflection**2), np.finfo(np.float64).tiny)
        cost = n * np.log(spread) + 2.0 * k
        if cost < cheapest:
            chosen, variance, cheapest = best, spread, cost
    return Noise(empty, chosen, float(np.sqrt(variance)), _share(chosen))


def _share(coefficients: Array) -> float:
    """Return 1 / (1 + 2 sum rho^2) of a process: independent rows per row for a variance."""
    impulse = np.zeros(2048)
    impulse[0] = 1.0
    response = autoregressive_filter(impulse[:, None], coefficients)[:, 0]
    spectrum = np.square(np.abs(np.fft.rfft(response, 2 * len(response))))
    rho = np.fft.irfft(spectrum)[: len(response)]
    rho /= rho[0]
    return float(1.0 / (1.0 + 2.0 * np.sum(np.square(rho[1:]))))


def autoregressive_filter(values: Array, coefficients: Array) -> Array:
    """Return columns filtered by 1 / (1 - sum c_k z^-k), shape (n, m)."""
    if not len(coefficients):
        return values
    filtered, p = values.copy(), len(coefficients)
    reversed_coefficients = coefficients[::-1]
    for t in range(1, len(filtered)):
        order = min(p, t)
        filtered[t] += reversed_coefficients[p - order :] @ filtered[t - order : t]
    return filtered


class CovarianceSum:
    """Accumulates the covariance of weighted least-squares estimates from blocks of rows.

    With the correlation C of residuals, estimates by A = sum X' W X have the covariance
    A^-1 (sum X' W C W X) A^-1.

    Source: H. White, Econometrica 48, 1980, 817 (covariance of weighted estimates).

    Args:
        noise: Noise of the residuals of each row.
        selection: Indices of the selected friction columns of each row.
        r: Number of base parameters.
    """

    def __init__(
        self, noise: Sequence[Noise], selection: Sequence[tuple[int, ...]], r: int
    ) -> None:
        self._noise = noise
        self._selection = selection
        self._r = r
        self._sums = [np.zeros((r + len(columns), r + len(columns))) for columns in selection]
        self._independent_rows = [0.0 for _ in selection]
        self._products = [np.zeros((r + len(columns), r + len(columns))) for columns in selection]

    def add(self, X: Array, F: Sequence[Array], mask: NDArray[np.bool_]) -> None:
        """Add consecutive rows of base parameters and candidates; `mask` tells which count."""
        for i, (noise, columns) in enumerate(zip(self._noise, self._selection, strict=True)):
            rows = np.where(mask[:, i, None], np.hstack([X[:, i], F[i][:, columns]]), 0.0)
            self._sums[i] += noise.innovation**2 * _correlated_product(rows, noise)
            self._products[i] += rows.T @ rows
            self._independent_rows[i] += noise.share * float(mask[:, i].sum())

    def covariance(self, fit: Fit) -> Array:
        """Return the covariance of base parameters and friction, shape (r + f, r + f)."""
        r, n = self._r, sum(map(len, self._selection))
        A, S, start = np.zeros((r + n, r + n)), np.zeros((r + n, r + n)), r
        if not (np.square(np.square(fit.deviation)) > 0.0).all():
            raise SolveError(
                "a joint has no deviation: its torques are all 0, or it always rests beside its "
                "largest velocity; leave this joint out, or mend its columns"
            )
        for columns, sigma, product, sums in zip(
            self._selection, fit.deviation, self._products, self._sums, strict=True
        ):
            places = np.r_[np.arange(r), start + np.arange(len(columns))]
            A[np.ix_(places, places)] += product / sigma**2
            S[np.ix_(places, places)] += sums / sigma**4
            start += len(columns)
        if not np.isfinite(A).all():
            raise SolveError(f"the covariance of the estimates is not finite: {_SIZES}")
        scale = np.sqrt(np.maximum(np.diag(A), np.finfo(np.float64).tiny))
        inverse = np.linalg.pinv(A / np.outer(scale, scale), hermitian=True) / np.outer(
            scale, scale
        )
        count = sum(self._independent_rows)
        covariance: Array = inverse @ S @ inverse * (count / max(count - r - n, 1.0))
        return covariance


def _correlated_product(rows: Array, noise: Noise) -> Array:
    """Return X' C X of consecutive rows X, for noise of unit power."""
    if not len(noise.correlation):
        filtered = autoregressive_filter(rows[::-1], noise.coefficients)
        return np.asarray(filtered.T @ filtered)
    product = rows.T @ rows
    for k, rho in enumerate(noise.correlation[1 : len(rows)], 1):
        across = rho * rows[:-k].T @ rows[k:]
        product += across + across.T
    return np.asarray(product)


def weighted_rows(
    joints: Sequence[Joint], fit: Fit, r: int, least: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return rows and torques over their deviations, weighted by their independent samples.

    Args:
        r: Number of base parameters.
        least: Lower bounds of the deviations [N·m or N], shape (m,).

    Returns:
        A, b, and which friction values must not be negative, shape (f,).
    """
    weight = np.array([np.sqrt(max(j.effective, 1.0) / max(j.rows, 1)) for j in joints])
    A, b = stack_rows(joints, fit.selection, r, np.maximum(fit.deviation, least) / weight)
    pairs = zip(joints, fit.selection, strict=True)
    signed = [joint.columns[k].term != "offset" for joint, columns in pairs for k in columns]
    return A, b, np.array(signed, dtype=np.bool_)


class TriangularFactor:
    """Triangular factor R of rows that arrive in pieces.

    Args:
        columns: Number of columns of a row.

    Attributes:
        R: Factor of the rows added so far, shape (k, columns), k at most `columns`.
        rows: Number of rows added so far.
    """

    def __init__(self, columns: int) -> None:
        self.R = np.zeros((0, columns))
        self.rows = 0
        self._pieces: list[Array] = []
        self._waiting = 0

    def add(self, rows: Array) -> None:
        """Add rows, shape (n, columns)."""
        self._pieces.append(rows)
        self._waiting += len(rows)
        self.rows += len(rows)
        if self._waiting > 8 * rows.shape[1]:
            self.close()

    def close(self) -> TriangularFactor:
        """Factorize the rows that wait, and return this object."""
        if self._waiting:
            self.R = triangular_factor(np.concatenate([self.R, *self._pieces]))
            self._pieces = []
            self._waiting = 0
        return self
