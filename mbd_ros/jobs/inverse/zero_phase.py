"""Motions without lag: every signal of a joint passes the same low-pass, forwards and back."""

import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import DataError
from mbd_ros.jobs.inverse.cutoff import cutoffs
from mbd_ros.jobs.inverse.low_pass import FEWEST, HIGHEST, LowPassed, low_pass, rate_of

_GAP = 0.5  # s without a sample, and as many usual steps as below: nothing leads across
_GAP_STEPS = 20
_TELLING = 32  # samples from which on a spectrum has bands enough to show noise
_PIECE, _PIECES = 25_000, 4  # samples that the cut-off is chosen from


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
    if cutoff is not None and not (np.isfinite(cutoff) and cutoff > 0):
        raise DataError(f"cutoff {cutoff} Hz must be finite and > 0")
    parts = _parts(stamps)
    times = (stamps - stamps[0]) * NANOSECOND
    measured = np.zeros(position.shape[1], dtype=np.bool_)
    if velocity is not None:
        measured = ~np.isnan(velocity).any(axis=0)
    if cutoff is None:
        chosen = _chosen(times, parts, position, velocity, measured)
    else:
        chosen = np.full(len(measured), cutoff)
    smooth, rate, push = (np.empty_like(position) for _ in range(3))
    for part in parts:
        for f in np.unique(chosen):
            derived, given = (np.flatnonzero((chosen == f) & m) for m in (~measured, measured))
            columns = [position[part, derived], position[part, given]]
            if velocity is not None:
                columns.append(velocity[part, given])
            passed = LowPassed(times[part], np.hstack(columns), f)
            own, theirs, rates = _places(len(derived), len(given))
            for at, order, found in ((derived, 0, smooth), (derived, 1, rate), (derived, 2, push)):
                if at.size:
                    found[part, at] = passed.derivative(order, own)
            if given.size:
                smooth[part, given] = passed.derivative(0, theirs)
                rate[part, given] = passed.derivative(0, rates)
                push[part, given] = passed.derivative(1, rates)
    highest = HIGHEST * rate_of(times)
    return ZeroPhase(smooth, rate, push, np.where(chosen < highest, chosen, np.inf))


def _places(derived: int, given: int) -> tuple[slice, slice, slice]:
    """Columns of positions to derive, of positions beside velocities, and of these."""
    return slice(0, derived), slice(derived, derived + given), slice(derived + given, None)


def low_passed(stamps: NDArray[np.int64], values: Array, cutoff: Array) -> Array:
    """Signals of the joints through the low-pass of their motion.

    Args:
        stamps: Those of `zero_phase`.
        values: One a joint, shape (n, m).
        cutoff: That of the result of `zero_phase`.
    """
    times, passed = (stamps - stamps[0]) * NANOSECOND, np.empty_like(values)
    for part in _parts(stamps):
        for f in np.unique(cutoff):
            at = part, np.flatnonzero(cutoff == f)
            (passed[at],) = low_pass(times[part], values[at], f, (0,))
    return passed


def cutoff_lines(cutoff: Array, names: Sequence[str], chosen: bool, samples: int) -> Iterator[str]:
    """Lines about the low-pass of each joint.

    Args:
        cutoff: That of the result of `zero_phase`.
        names: Of the joints.
        chosen: Whether the recording asked for it, not the user.
        samples: Number of them.
    """
    source = "from the noise of the recording" if chosen else "as asked for"
    smoothed = np.flatnonzero(np.isfinite(cutoff))
    if smoothed.size:
        low, high = (pick(smoothed, key=cutoff.__getitem__) for pick in (min, max))
        span = f"{cutoff[low]:.3g} Hz"
        if cutoff[high] > cutoff[low]:
            span += f" ({names[low]}) to {cutoff[high]:.3g} Hz ({names[high]})"
        yield f"zero-phase derivatives: low-pass of half power at {span}, {source}"
    sharp = [name for name, f in zip(names, cutoff, strict=True) if np.isinf(f)]
    if sharp:
        why = "no noise is found" if chosen else "the sampling rate is too low for that cut-off"
        if chosen and samples < _TELLING:
            why = f"{samples} samples are too few to tell noise from motion (--cutoff smooths)"
        yield f"zero-phase derivatives: not smoothed, since {why}: {', '.join(sharp)}"


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
    position: Array,
    velocity: Array | None,
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
