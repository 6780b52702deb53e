"""Recorded motions through low-passes: without lag, and as the live node filters."""

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
    """A motion without noise.

    Attributes:
        position: [rad or m], shape (n, m).
        velocity: [rad/s or m/s], same shape.
        acceleration: [rad/s^2 or m/s^2], same shape.
        cutoff: Half-power frequency of each joint's low-pass [Hz], shape (m,); inf where there is
            nothing to smooth.
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
    """Low-pass a whole recording and differentiate it, without lag.

    The acceleration is the derivative of the measured velocity or, without one, the second
    derivative of the position. Beyond a gap the recording begins anew.

    Args:
        stamps: Sample times [ns], increasing, may be irregular, shape (n,).
        position: [rad or m], shape (n, m).
        velocity: [rad/s or m/s], shape (n, m); a column with a NaN is not used. None: not
            measured.
        cutoff: Half-power frequency for all joints [Hz], > 0. None: for each joint the one that
            its spectrum asks for, see `cutoff`.

    Raises:
        DataError: Too few samples in a row, or a cut-off out of its range.
    """
    measured = np.zeros(position.shape[1], dtype=np.bool_)
    if velocity is not None:
        measured = ~np.isnan(velocity).any(axis=0)
    moving = position if velocity is None else np.hstack([position, velocity])
    chosen = chosen_cutoffs(stamps, moving, measured, cutoff)
    found = tuple(np.empty_like(position) for _ in range(3))
    for rows, *smooth in smoothed(Windows(stamps, chosen), moving, measured, chosen):
        for whole, values in zip(found, smooth, strict=True):
            whole[rows] = values
    return ZeroPhase(*found, stated(stamps, chosen))


def chosen_cutoffs(
    stamps: Stamps, moving: Rows, measured: NDArray[np.bool_], cutoff: float | None
) -> Array:
    """Cut-off of each joint [Hz], shape (m,), see `zero_phase` and `smoothed`."""
    if cutoff is not None and not (np.isfinite(cutoff) and cutoff > 0):
        raise DataError(f"cutoff {cutoff} Hz must be finite and > 0")
    parts = parts_of(stamps)
    if cutoff is None:
        return _chosen(stamps, parts, moving, measured)
    return np.full(len(measured), cutoff)


class Rows(Protocol):
    """Numbers by rows, in memory or in a file."""

    def __getitem__(self, rows: slice, /) -> Array:
        """Some rows, shape (n, m)."""
        ...


def _chosen(
    stamps: Stamps, parts: Sequence[slice], moving: Rows, measured: NDArray[np.bool_]
) -> Array:
    """Cut-off of every joint, from its measured velocity or from its position."""
    cut = [piece for part in parts for piece in _pieces(part)]
    longest = max(piece.stop - piece.start for piece in cut)
    whole = [piece for piece in cut if 2 * (piece.stop - piece.start) > longest]
    taken = whole[:: -(-len(whole) // _PIECES)]
    times, signals = [times_of(stamps, piece) for piece in taken], [moving[p] for p in taken]
    chosen, m = np.full(len(measured), np.inf), len(measured)
    for order, mine in ((0, ~measured), (1, measured)):
        if mine.any():
            columns = np.flatnonzero(mine) + order * m
            pieces = [values[:, columns] for values in signals]
            chosen[mine] = cutoffs(list(zip(times, pieces, strict=True)), order)
    return chosen


def _pieces(part: slice) -> Iterator[slice]:
    """Pieces of about the same length, of at most `_PIECE` samples."""
    count = -(-(part.stop - part.start) // _PIECE)
    edges = np.linspace(part.start, part.stop, count + 1).astype(np.intp).tolist()
    return (slice(*pair) for pair in itertools.pairwise(edges))


def smoothed(
    windows: Windows, moving: Rows, measured: NDArray[np.bool_], cutoff: Array
) -> Iterator[tuple[slice, Array, Array, Array]]:
    """Rows, and position, velocity and acceleration of these, window by window.

    Args:
        windows: Of all stamps and the cut-offs.
        moving: Positions and, where any is measured, velocities of m joints, side by side.
        measured: Joints whose velocity is used, shape (m,).
        cutoff: That of `chosen_cutoffs`.
    """
    m = len(cutoff)
    derived, given = np.flatnonzero(~measured), np.flatnonzero(measured)
    chosen = np.concatenate([derived, given, m + given])
    ours = np.arange(len(derived))
    theirs = len(derived) + np.arange(len(given))
    for window in windows:
        rows = window.core.stop - window.core.start
        smooth, rate, push = found = np.empty((3, rows, m))
        wanted = [(k, ours, found[k], derived) for k in range(3) if len(ours)]
        if len(given):
            rates = theirs + len(given)
            wanted += [(0, theirs, smooth, given)]
            wanted += [(0, rates, rate, given), (1, rates, push, given)]
        window.low_pass.put(moving[window.wide], chosen, cutoff[chosen % m], wanted, window.own)
        yield window.core, smooth, rate, push


def stated(stamps: Stamps, chosen: Array) -> Array:
    """Cut-offs for people: inf where nothing is smoothed."""
    highest = HIGHEST / (usual_step(stamps) * NANOSECOND)
    return np.where(chosen < highest, chosen, np.inf)


def low_passed(windows: Windows, values: Rows, cutoff: Array) -> Iterator[tuple[Array, float]]:
    """Signals of the joints through the low-pass of their motion, in pieces.

    Args:
        windows: Of all stamps and the cut-offs.
        values: One a joint, shape (n, m), or what gives some rows of them.
        cutoff: That of the result of `zero_phase`.

    Yields:
        Signals of one or several joints at times that are a step apart, and the step [s].
    """
    every = np.arange(len(cutoff))
    for window in windows:
        wide, own = values[window.wide], window.own
        yield from (found[1:] for found in window.low_pass.spread(wide, every, cutoff, own))


def observe(estimator: TorqueEstimator, motion: Motion, dropped: Counter[str]) -> Observations:
    """Pass a motion through the causal filters.

    Args:
        estimator: With the filters.
        motion: The motion, NaN where a joint is absent.
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
    """Samples of a block: all at once, else in smaller blocks, at last one by one."""
    stamps, position = motion.stamps[block], motion.position[block]
    velocity = np.full_like(position, np.nan)
    if motion.velocity is not None:
        velocity = motion.velocity[block]
    found = estimator.observe_all(stamps, position, velocity)
    if found is not None:
        return [found]
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
    """Poses and twists of the free bodies, a pair a sample."""
    unknown = np.full((len(motion.stamps), TWIST), np.nan)
    poses = np.stack([body.pose for body in motion.bodies], axis=1)[block]
    twists = [unknown if body.twist is None else body.twist for body in motion.bodies]
    return list(zip(poses, np.stack(twists, axis=1)[block], strict=True))


def causal_line(filters: CausalDifferentiator, cutoff: float) -> str:
    """How far causal derivatives lag behind the motion."""
    return (
        f"causal derivatives at {cutoff:g} Hz lag by {filters.delay:.4f} s and settle within "
        f"{filters.settling_time:.4f} s"
    )
