"""Motions without lag: every signal of a joint passes the same low-pass, forwards and back."""

import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import DataError
from mbd_ros.jobs.inverse.cutoff import cutoffs
from mbd_ros.jobs.inverse.low_pass import FEWEST, HIGHEST, PERIODS, LowPassed, Stretch, rate_of

_GAP = 0.5  # s without a sample, and as many usual steps as below: nothing leads across
_GAP_STEPS = 20
_PIECE, _PIECES = 25_000, 4  # samples that the cut-off is chosen from
_WINDOW = 200_000  # samples that are smoothed at once, those around them not counted
_BESIDE = 200  # samples around them at least: a spline through samples forgets in fewer
_SLOWEST = 0.01  # periods of a cut-off in a recording, the least that a low-pass knows


class Rows(Protocol):
    """Numbers by rows, in memory or in a file."""

    def __getitem__(self, rows: slice, /) -> Array:
        """Some rows, shape (n, m)."""
        ...


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
    chosen = chosen_cutoffs(stamps, position, velocity, measured, cutoff)
    found = tuple(np.empty_like(position) for _ in range(3))
    for rows, *smooth in smoothed(stamps, position, velocity, measured, chosen):
        for whole, values in zip(found, smooth, strict=True):
            whole[rows] = values
    return ZeroPhase(*found, stated(stamps, chosen))


def chosen_cutoffs(
    stamps: NDArray[np.int64],
    position: Rows,
    velocity: Rows | None,
    measured: NDArray[np.bool_],
    cutoff: float | None,
) -> Array:
    """Cut-off of each joint [Hz], shape (m,), see `zero_phase`."""
    if cutoff is not None and not (np.isfinite(cutoff) and cutoff > 0):
        raise DataError(f"cutoff {cutoff} Hz must be finite and > 0")
    parts, times = _parts(stamps), (stamps - stamps[0]) * NANOSECOND
    if cutoff is None:
        return _chosen(times, parts, position, velocity, measured)
    return np.full(len(measured), cutoff)


def stated(stamps: NDArray[np.int64], chosen: Array) -> Array:
    """Cut-offs for people: inf where nothing is smoothed."""
    highest = HIGHEST * rate_of((stamps - stamps[0]) * NANOSECOND)
    return np.where(chosen < highest, chosen, np.inf)


def smoothed(
    stamps: NDArray[np.int64],
    position: Rows,
    velocity: Rows | None,
    measured: NDArray[np.bool_],
    cutoff: Array,
) -> Iterator[tuple[slice, Array, Array, Array]]:
    """Rows, and position, velocity and acceleration of these, window by window.

    Args:
        stamps: Of all rows [ns], shape (n,).
        position: All rows, shape (n, m), or what gives some of them.
        velocity: The same; None where nothing is measured.
        measured: Joints whose velocity is used, shape (m,).
        cutoff: That of `chosen_cutoffs`.
    """
    for core, wide, times, stretch in _windows(stamps, cutoff):
        own = slice(core.start - wide.start, core.stop - wide.start)
        placed, moving = position[wide], None if velocity is None else velocity[wide]
        smooth, rate, push = (np.empty((core.stop - core.start, len(cutoff))) for _ in range(3))
        for f in np.unique(cutoff):
            derived, given = (np.flatnonzero((cutoff == f) & m) for m in (~measured, measured))
            columns = [placed[:, derived], placed[:, given]]
            if moving is not None:
                columns.append(moving[:, given])
            passed = LowPassed(times, np.hstack(columns), f, stretch)
            ours, theirs, rates = _places(len(derived), len(given))
            if derived.size:
                for order, found in enumerate((smooth, rate, push)):
                    found[:, derived] = passed.derivative(order, ours)[own]
            if given.size:
                smooth[:, given] = passed.derivative(0, theirs)[own]
                rate[:, given] = passed.derivative(0, rates)[own]
                push[:, given] = passed.derivative(1, rates)[own]
        yield core, smooth, rate, push


def _places(derived: int, given: int) -> tuple[slice, slice, slice]:
    """Columns of positions to derive, of positions beside velocities, and of these."""
    return slice(0, derived), slice(derived, derived + given), slice(derived + given, None)


def low_passed(stamps: NDArray[np.int64], values: Rows, cutoff: Array) -> Iterator[Array]:
    """Signals of the joints through the low-pass of their motion, window by window.

    Args:
        stamps: Those of `zero_phase`.
        values: One a joint, shape (n, m), or what gives some rows of them.
        cutoff: That of the result of `zero_phase`.
    """
    for core, wide, times, stretch in _windows(stamps, cutoff):
        own = slice(core.start - wide.start, core.stop - wide.start)
        signals = values[wide]
        passed = np.empty((core.stop - core.start, len(cutoff)))
        for f in np.unique(cutoff):
            at = np.flatnonzero(cutoff == f)
            passed[:, at] = LowPassed(times, signals[:, at], f, stretch).derivative(0)[own]
        yield passed


def _windows(
    stamps: NDArray[np.int64], cutoff: Array
) -> Iterator[tuple[slice, slice, Array, Stretch]]:
    """Rows to find, rows around them to look at, the times of these [s], and their stretch."""
    lowest = float(cutoff.min(initial=np.inf))
    for part in _parts(stamps):
        times = (stamps[part] - stamps[0]) * NANOSECOND
        stretch = Stretch.of(times)
        beside = PERIODS / max(lowest, _SLOWEST / (times[-1] - times[0]))
        beside = max(beside, _BESIDE / stretch.rate)
        size = max(_WINDOW, int(2.0 * beside * stretch.rate))
        edges = np.linspace(0, len(times), -(-len(times) // size) + 1).astype(np.intp).tolist()
        for begin, end in itertools.pairwise(edges):
            first = int(np.searchsorted(times, times[begin] - beside))
            last = int(np.searchsorted(times, times[end - 1] + beside, side="right"))
            core, wide = (
                slice(part.start + i, part.start + j) for i, j in ((begin, end), (first, last))
            )
            yield core, wide, times[first:last], stretch


def _parts(stamps: NDArray[np.int64]) -> list[slice]:
    """Stretches without gaps."""
    steps = np.diff(stamps)
    usual = float(np.median(steps)) if len(steps) else 0.0
    gap = max(_GAP / NANOSECOND, _GAP_STEPS * usual)
    ends = [0, *(np.flatnonzero(steps > gap) + 1).tolist(), len(stamps)]
    parts = [slice(*pair) for pair in itertools.pairwise(ends)]
    for part in parts:
        count = part.stop - part.start
        if count < FEWEST and len(parts) == 1:
            raise DataError(
                f"zero-phase derivatives need at least {FEWEST} samples, there are {count}"
            )
        if count < FEWEST:
            raise DataError(
                f"zero-phase derivatives need at least {FEWEST} samples in a row, from "
                f"{stamps[part.start] * NANOSECOND:.9g} s there are {count} between gaps of more "
                f"than {gap * NANOSECOND:.3g} s: cut them off, or choose --derivatives causal"
            )
    return parts


def _chosen(
    times: Array,
    parts: Sequence[slice],
    position: Rows,
    velocity: Rows | None,
    measured: NDArray[np.bool_],
) -> Array:
    """Cut-off of every joint, from its measured velocity or from its position."""
    cut = [piece for part in parts for piece in _pieces(part)]
    longest = max(piece.stop - piece.start for piece in cut)
    whole = [piece for piece in cut if 2 * (piece.stop - piece.start) > longest]
    every = -(-len(whole) // _PIECES)
    chosen = np.full(len(measured), np.inf)
    for order, signals, mine in ((0, position, ~measured), (1, velocity, measured)):
        if signals is not None and mine.any():
            taken = [(times[p], signals[p][:, mine]) for p in whole[::every]]
            chosen[mine] = cutoffs(taken, order)
    return chosen


def _pieces(part: slice) -> Iterator[slice]:
    """Pieces of about the same length, of at most `_PIECE` samples."""
    count = -(-(part.stop - part.start) // _PIECE)
    edges = np.linspace(part.start, part.stop, count + 1).astype(np.intp).tolist()
    return (slice(*pair) for pair in itertools.pairwise(edges))
