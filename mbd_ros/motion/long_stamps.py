"""What stamps tell, a piece of them at a time: the rate, the gaps, windows without gaps."""

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
        """Some that follow each other."""
        ...


class Window:
    """Rows that are smoothed at once.

    Args:
        core: Those to find.
        wide: Those to look at.
        low_pass: Of `wide`.
    """

    def __init__(self, core: slice, wide: slice, low_pass: LowPass) -> None:
        self.core, self.wide = core, wide
        self.own = slice(core.start - wide.start, core.stop - wide.start)  # of `wide`
        self.low_pass = low_pass


class Windows:
    """All rows, piece by piece, with those around them that cut-offs need.

    Args:
        stamps: Of all rows [ns].
        cutoff: Cut-offs [Hz].
    """

    def __init__(self, stamps: Stamps, cutoff: Array) -> None:
        self._given, self._kept = (stamps, cutoff), list[Window]()

    def __iter__(self) -> Iterator[Window]:
        """The windows; where there is but one, it is the same again."""
        if self._kept:
            yield from self._kept
            return
        for k, window in enumerate(_windows(*self._given)):
            self._kept = [] if k else [window]
            yield window


def times_of(stamps: Stamps, rows: slice) -> Array:
    """Times since the first of all stamps [s]."""
    times: Array = (stamps[rows] - stamps[0:1]) * NANOSECOND
    return times


def usual_step(stamps: Stamps) -> float:
    """Median of the steps [ns], of evenly spread blocks where there are many; 0 without any."""
    steps = [np.diff(stamps[rows]) for rows in _telling(slice(0, len(stamps)))]
    every = np.concatenate(steps)
    return float(np.median(every)) if len(every) else 0.0


def _telling(part: slice) -> list[slice]:
    """Rows that tell the rate of a part, its first and its last among them."""
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
    """Stretches without gaps.

    Raises:
        DataError: One of them is too short.
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
