"""Sampling rate, gaps and windows of long recordings, whose stamps are read piece by piece."""

import bisect
import itertools
from collections.abc import Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import DataError
from mbd_ros.methods.signals.smoothing_spline import FEWEST, PERIODS, LowPass, Stretch

_GAP = 0.5  # s without a sample, and as many usual steps as below: nothing leads across
_GAP_STEPS = 20
_WINDOW = 100_000  # samples that are smoothed at once, those around them not counted
_BESIDE = 200  # samples around them at least: a spline through samples forgets in fewer
_SLOWEST = 0.01  # periods of a cut-off in a recording, the least that a low-pass knows
_TELLING, _BLOCKS = 1 << 20, 16  # stamps that tell the usual step of more, in so many blocks


class Stamps(Protocol):
    """Sample times [ns], increasing, in memory or in a file."""

    def __len__(self) -> int: ...

    def __getitem__(self, rows: slice, /) -> NDArray[np.int64]:
        """Return consecutive stamps."""
        ...


class Window:
    """Rows that are smoothed at once.

    Args:
        core: Rows of the result.
        wide: Rows that the result depends on.
        low_pass: Low-pass filter of `wide`.

    Attributes:
        core_in_wide: Rows of the result, relative to `wide`.
    """

    def __init__(self, core: slice, wide: slice, low_pass: LowPass) -> None:
        self.core = core
        self.wide = wide
        self.core_in_wide = slice(core.start - wide.start, core.stop - wide.start)
        self.low_pass = low_pass


class Windows:
    """All rows in windows, each with the neighbouring rows that the filters need.

    Args:
        stamps: Stamps of all rows [ns].
        cutoff: Cutoff frequencies [Hz].
    """

    def __init__(self, stamps: Stamps, cutoff: Array) -> None:
        self._stamps = stamps
        self._cutoff = cutoff
        self._only = list[Window]()

    def __iter__(self) -> Iterator[Window]:
        """Yield the windows; a single window is stored and yielded again next time."""
        if self._only:
            yield from self._only
            return
        for k, window in enumerate(_windows(self._stamps, self._cutoff)):
            self._only = [] if k else [window]
            yield window


def times_of(stamps: Stamps, rows: slice) -> Array:
    """Return the times since the first stamp [s]."""
    times: Array = (stamps[rows] - stamps[0:1]) * NANOSECOND
    return times


def usual_step(stamps: Stamps) -> float:
    """Return the median of the steps [ns], from evenly spaced blocks if there are many."""
    steps = [np.diff(stamps[rows]) for rows in _telling(slice(0, len(stamps)))]
    every = np.concatenate(steps)
    return float(np.median(every)) if len(every) else 0.0


def _telling(part: slice) -> list[slice]:
    """Return rows that determine the rate of a part, including its first and last."""
    count = part.stop - part.start
    if count <= _TELLING:
        return [part]
    size = _TELLING // _BLOCKS
    starts = np.linspace(part.start, part.stop - size, _BLOCKS).astype(np.intp).tolist()
    return [slice(start, start + size) for start in starts]


def _windows(stamps: Stamps, cutoff: Array) -> Iterator[Window]:
    lowest = float(cutoff.min(initial=np.inf))
    for part in parts_of(stamps):
        stretch = Stretch.of(*(times_of(stamps, rows) for rows in _telling(part)))
        beside = PERIODS / max(lowest, _SLOWEST / (stretch.end - stretch.begin))
        beside = max(beside, _BESIDE / stretch.rate)
        size = max(_WINDOW, int(2.0 * beside * stretch.rate))
        count = -(-(part.stop - part.start) // size)
        edges = np.linspace(part.start, part.stop, count + 1).astype(np.intp).tolist()

        def at(row: int) -> float:
            return float(times_of(stamps, slice(row, row + 1))[0])

        for begin, end in itertools.pairwise(edges):
            rows = range(part.start, part.stop)
            first = bisect.bisect_left(rows, at(begin) - beside, key=at)
            last = bisect.bisect_right(rows, at(end - 1) + beside, key=at)
            wide = slice(part.start + first, part.start + last)
            low_pass = LowPass(times_of(stamps, wide), cutoff, stretch)
            yield Window(slice(begin, end), wide, low_pass)


def parts_of(stamps: Stamps) -> list[slice]:
    """Return the parts of a recording between its gaps.

    Raises:
        DataError: A part is too short.
    """
    usual, n = usual_step(stamps), len(stamps)
    gap = max(_GAP / NANOSECOND, _GAP_STEPS * usual)
    ends = [0]
    for begin in range(0, n - 1, _TELLING):
        steps = np.diff(stamps[begin : begin + _TELLING + 1])
        ends += (np.flatnonzero(steps > gap) + begin + 1).tolist()
    parts = [slice(*pair) for pair in itertools.pairwise([*ends, n])]
    for part in parts:
        count = part.stop - part.start
        if count < FEWEST and len(parts) == 1:
            raise DataError(
                f"zero-phase derivatives need at least {FEWEST} samples, there are {count}"
            )
        if count < FEWEST:
            raise DataError(
                f"zero-phase derivatives need at least {FEWEST} samples in a row, from "
                f"{stamps[part][0] * NANOSECOND:.9g} s there are {count} between gaps of more "
                f"than {gap * NANOSECOND:.3g} s: cut them off, or choose --derivatives causal"
            )
    return parts
