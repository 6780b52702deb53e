"""Cells of a recording for cut-offs, those of a low one made of those of a higher one."""

import math
from collections.abc import Sequence
from typing import NamedTuple

CELLS = 8  # polynomial pieces a period of a cut-off at least
FLATTEST = 0.01  # periods of a cut-off in the recording: a cubic is all that is left by then
_LEVELS = 3  # octaves of cut-offs for which samples are looked at once
_MORE = 1.05  # times the cells that there have to be
_ROUNDING = 1.0e-9  # of an octave


class Grid(NamedTuple):
    """Cells of a recording for a cut-off.

    Attributes:
        cells: Of the highest cut-off that is looked at together with this one.
        unit: Of these, as many as there are in one of the lowest.
        level: This one has cells 2^level times as wide.
        is_fine: Whether these are narrower than they have to be, so that equations are stiffer.
    """

    cells: int
    unit: int
    level: int
    is_fine: bool


def grids_of(cutoffs: Sequence[float], span: float) -> dict[float, Grid]:
    """Those of cut-offs from the highest on [Hz], in a recording of so many seconds."""
    found: dict[float, Grid] = {}
    periods = {f: max(f * span, FLATTEST) for f in cutoffs}
    while periods:
        top = max(periods.values())
        levels = {f: int(math.log2(top / n) + _ROUNDING) for f, n in periods.items()}
        own = {f: level for f, level in levels.items() if level <= _LEVELS}
        unit = 2 ** max(own.values())
        cells = math.ceil(top * CELLS / unit) * unit
        for f, level in own.items():
            is_fine = cells >> level > _MORE * CELLS * periods[f] + 1.0
            found[f] = Grid(cells, unit, level, is_fine)
        periods = {f: n for f, n in periods.items() if f not in own}
    return found
