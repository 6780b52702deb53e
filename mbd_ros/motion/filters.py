"""Low-pass filters for recorded motions: without lag, or causal as in the live node."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.kinematics.poses import TWIST
from mbd_ros.core.state import NANOSECOND, Array, Motion
from mbd_ros.errors import DataError
from mbd_ros.jobs.progress import progress
from mbd_ros.methods.inverse_dynamics.torque_estimator import (
    Observation,
    Observations,
    TorqueEstimator,
    concatenate_observations,
)
from mbd_ros.methods.signals.differentiation import CausalDifferentiator
from mbd_ros.methods.signals.smoothing_spline import HIGHEST
from mbd_ros.motion.cutoff import cutoffs
from mbd_ros.motion.long_stamps import Stamps, Windows, parts_of, times_of, usual_step

_PIECE, _PIECES = 25_000, 4  # samples that the cut-off is chosen from
_BLOCK, _FEW = 16_384, 256  # samples that are filtered at once, at most and at least


class ZeroPhase(NamedTuple):
    """A motion after a filter without lag.

    Attributes:
        position: Positions [rad or m], shape (n, m).
        velocity: Velocities [rad/s or m/s], shape (n, m).
        acceleration: Accelerations [rad/s^2 or m/s^2], shape (n, m).
        cutoff: Half-power frequency of the low-pass filter of each joint [Hz], shape (m,); inf
            where nothing is smoothed.
    """

    position: Array
    velocity: Array
    acceleration: Array
    cutoff: Array


def zero_phase(
    stamps: NDArray[np.int64],
    position: Array,
    velocity: Array | None = None,
    *,
    cutoff: float | None = None,
) -> ZeroPhase:
    """Filter a recording by a low-pass without lag, and differentiate it.

    The acceleration is the derivative of the measured velocity or, without one, the second
    derivative of the position. Parts of the recording between gaps are filtered separately.

    Args:
        stamps: Sample times [ns], increasing, may be irregular, shape (n,).
        position: Positions [rad or m], shape (n, m).
        velocity: Measured velocities [rad/s or m/s], shape (n, m), or None; a column with a NaN is
            not used.
        cutoff: Half-power frequency for all joints [Hz], > 0; by default it is chosen for each
            joint from its spectrum, see `mbd_ros.motion.cutoff`.

    Raises:
        DataError: There are too few consecutive samples, or the cutoff is out of its range.
    """
    measured = np.zeros(position.shape[1], dtype=np.bool_)
    if velocity is not None:
        measured = ~np.isnan(velocity).any(axis=0)
    moving = position if velocity is None else np.hstack([position, velocity])
    chosen = chosen_cutoffs(stamps, moving, measured, cutoff)
    fields = tuple(np.empty_like(position) for _ in range(3))
    for rows, *smooth in smoothed(Windows(stamps, chosen), moving, measured, chosen):
        for field, values in zip(fields, smooth, strict=True):
            field[rows] = values
    return ZeroPhase(*fields, stated(stamps, chosen))


def chosen_cutoffs(
    stamps: Stamps, moving: Rows, measured: NDArray[np.bool_], cutoff: float | None
) -> Array:
    """Return the cutoff of each joint [Hz], shape (m,), see `zero_phase` and `smoothed`."""
    if cutoff is not None and not (np.isfinite(cutoff) and cutoff > 0):
        raise DataError(f"cutoff {cutoff} Hz must be finite and > 0")
    parts = parts_of(stamps)
    if cutoff is None:
        return _chosen(stamps, parts, moving, measured)
    return np.full(len(measured), cutoff)


class Rows(Protocol):
    """Rows of numbers, in memory or in a file."""

    def __getitem__(self, rows: slice, /) -> Array:
        """Return some rows, shape (n, m)."""
        ...


def _chosen(
    stamps: Stamps, parts: Sequence[slice], moving: Rows, measured: NDArray[np.bool_]
) -> Array:
    """Return the cutoff of every joint, from its measured velocity or its position."""
    all_pieces = [piece for part in parts for piece in _pieces(part)]
    longest = max(piece.stop - piece.start for piece in all_pieces)
    long_pieces = [piece for piece in all_pieces if 2 * (piece.stop - piece.start) > longest]
    selected = long_pieces[:: -(-len(long_pieces) // _PIECES)]
    times = [times_of(stamps, piece) for piece in selected]
    signals = [moving[piece] for piece in selected]
    chosen, m = np.full(len(measured), np.inf), len(measured)
    for order, mine in ((0, ~measured), (1, measured)):
        if mine.any():
            columns = np.flatnonzero(mine) + order * m
            pieces = [values[:, columns] for values in signals]
            chosen[mine] = cutoffs(list(zip(times, pieces, strict=True)), order)
    return chosen


def _pieces(part: slice) -> Iterator[slice]:
    """Return pieces of about the same length, of at most `_PIECE` samples."""
    count = -(-(part.stop - part.start) // _PIECE)
    edges = np.linspace(part.start, part.stop, count + 1).astype(np.intp).tolist()
    return (slice(*pair) for pair in itertools.pairwise(edges))


def smoothed(
    windows: Windows, moving: Rows, measured: NDArray[np.bool_], cutoff: Array
) -> Iterator[tuple[slice, Array, Array, Array]]:
    """Yield rows, and their position, velocity and acceleration, window by window.

    Args:
        windows: Windows of all stamps and cutoffs.
        moving: Positions of m joints and, if any is measured, their velocities, side by side.
        measured: Joints whose velocity is used, shape (m,).
        cutoff: Result of `chosen_cutoffs`.
    """
    m = len(cutoff)
    unmeasured, with_velocity = np.flatnonzero(~measured), np.flatnonzero(measured)
    columns = np.concatenate([unmeasured, with_velocity, m + with_velocity])
    first = np.arange(len(unmeasured))
    second = len(unmeasured) + np.arange(len(with_velocity))
    for window in windows:
        rows = window.core.stop - window.core.start
        fields = np.empty((3, rows, m))
        position, velocity, acceleration = fields
        outputs = [(k, first, fields[k], unmeasured) for k in range(3) if len(first)]
        if len(with_velocity):
            rates = second + len(with_velocity)
            outputs += [(0, second, position, with_velocity)]
            outputs += [(0, rates, velocity, with_velocity)]
            outputs += [(1, rates, acceleration, with_velocity)]
        window.low_pass.put(
            moving[window.wide], columns, cutoff[columns % m], outputs, window.core_in_wide
        )
        yield window.core, position, velocity, acceleration


def stated(stamps: Stamps, chosen: Array) -> Array:
    """Return the cutoffs to report: inf where nothing is smoothed."""
    highest = HIGHEST / (usual_step(stamps) * NANOSECOND)
    return np.where(chosen < highest, chosen, np.inf)


def low_passed(windows: Windows, values: Rows, cutoff: Array) -> Iterator[tuple[Array, float]]:
    """Filter signals of the joints by the low-pass of their motion, in pieces.

    Args:
        windows: Windows of all stamps and cutoffs.
        values: One signal per joint, shape (n, m).
        cutoff: Cutoffs of the result of `zero_phase`.

    Yields:
        Signals of one or several joints at times that are a step apart, and the step [s].
    """
    every = np.arange(len(cutoff))
    for window in windows:
        pieces = window.low_pass.spread(values[window.wide], every, cutoff, window.core_in_wide)
        yield from (piece[1:] for piece in pieces)


def observe(estimator: TorqueEstimator, motion: Motion, dropped: Counter[str]) -> Observations:
    """Filter a motion by the causal filters of an estimator.

    Args:
        estimator: The estimator.
        motion: The motion, NaN where a joint is missing.
        dropped: Counts the samples that cannot be used, by reason.
    """
    blocks = _blocks(0, len(motion.stamps), _BLOCK)
    parts = []
    for block in progress(blocks, len(blocks), "filtering"):
        parts += _observed(estimator, motion, block, dropped)
    if not parts:
        none = np.zeros((0, 0))
        return Observations(np.zeros(0, np.int64), none, none, none, none)
    return concatenate_observations(parts)


def _blocks(begin: int, end: int, size: int) -> list[slice]:
    return [slice(i, min(i + size, end)) for i in range(begin, end, size)]


def _observed(
    estimator: TorqueEstimator, motion: Motion, block: slice, dropped: Counter[str]
) -> list[Observations]:
    """Return the samples of a block: at once, or in smaller blocks, or one by one."""
    stamps, position = motion.stamps[block], motion.position[block]
    velocity = np.full_like(position, np.nan)
    if motion.velocity is not None:
        velocity = motion.velocity[block]
    observations = estimator.observe_all(stamps, position, velocity)
    if observations is not None:
        return [observations]
    if len(stamps) > _FEW and not motion.bodies:
        smaller = _blocks(block.start, block.stop, max(len(stamps) // 8, _FEW))
        each = [_observed(estimator, motion, part, dropped) for part in smaller]
        return [part for parts in each for part in parts]
    bodies = _body_rows(motion, block) if motion.bodies else [None] * len(stamps)
    observed = []
    rows = zip(stamps.tolist(), position, velocity, np.isfinite(position), bodies, strict=True)
    for row in rows:
        x = estimator.observe(*row)
        if isinstance(x, Observation):
            observed.append(x)
        else:
            dropped[x.value] += 1
    if not observed:
        return []
    used, *fields = (np.array(column) for column in zip(*observed, strict=True))
    return [Observations(used, *fields)]


def _body_rows(motion: Motion, block: slice) -> list[tuple[Array, Array]]:
    """Return poses and twists of the free bodies, one pair per sample."""
    unknown = np.full((len(motion.stamps), TWIST), np.nan)
    poses = np.stack([body.pose for body in motion.bodies], axis=1)[block]
    twists = [unknown if body.twist is None else body.twist for body in motion.bodies]
    return list(zip(poses, np.stack(twists, axis=1)[block], strict=True))


def causal_line(filters: CausalDifferentiator, cutoff: float) -> str:
    """Return a remark on the lag of causal derivatives."""
    return (
        f"causal derivatives at {cutoff:g} Hz lag by {filters.delay:.4f} s and settle within "
        f"{filters.settling_time:.4f} s"
    )
