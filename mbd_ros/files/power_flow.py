"""Pictures of power that flows from segment to segment: bands as wide as it, over time.

A joint has three bands: what the segment before it gives, what acts in the joint, what the next
segment takes. What comes out of a rigid segment at its far end, and was not made there, came in at
its near end.
"""

from typing import Any, NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.files.plot import Picture
from mbd_ros.files.table import MAIN, TIME, Result, Table

_LANE, _WIDTH, _EDGE = 0.42, 9.0, 1.0  # in
_HIGH = 0.46  # of a lane: half a band of the largest power
_TAKEN, _GIVEN = ".proximal_power", ".distal_power_"
_OUTWARDS, _INWARDS, _MADE, _LOST = "#c4553b", "#3b6fc4", "#2f8f4e", "#8a8a8a"
_MEANING = (
    ("towards the next segment", _OUTWARDS),
    ("towards the one before", _INWARDS),
    ("made in the joint", _MADE),
    ("taken by the joint", _LOST),
)
_MOST = 60  # lanes


class Lane(NamedTuple):
    """One band.

    Attributes:
        text: What it is.
        power: [W], shape (n,): positive outwards, or made.
        colours: Where it is positive, where negative.
        segment: On whose ground it is drawn; empty between two.
    """

    text: str
    power: Array
    colours: tuple[str, str]
    segment: str


def power_flow(result: Result, table: str = MAIN) -> Picture:
    """Bands of power over time.

    Args:
        result: Of inverse dynamics with powers.
        table: Which of its tables.

    Raises:
        DataError: There are no powers of segments, or too many.
    """
    drawn = result[table]
    lanes = lanes_of(drawn)
    largest = max((float(np.abs(lane.power).max(initial=0.0)) for lane in lanes), default=0.0)
    picture = Picture(figsize=(_WIDTH, len(lanes) * _LANE + _EDGE), layout="constrained")
    FigureCanvasAgg(picture)
    axes: Any = picture.subplots()
    time = drawn[TIME]
    for row, lane in enumerate(lanes):
        _draw(axes, time, -float(row), lane, _HIGH / (largest or 1.0))
    axes.set_yticks([-float(row) for row in range(len(lanes))], [lane.text for lane in lanes])
    work = [f"{_work(time, lane.power):+.3g} J" for lane in lanes]
    other: Any = axes.secondary_yaxis("right")
    other.set_yticks([-float(row) for row in range(len(lanes))], work)
    for each in (axes, other):
        each.tick_params(labelsize=7, length=0)
    axes.set_ylim(-len(lanes) + 0.4, 0.6)
    axes.set_xlim(float(time[0]), float(time[-1]))
    axes.set_xlabel(f"time [s]; the widest band is {largest:.4g} W", fontsize=8)
    shown = [axes.fill_between([], [], [], color=colour) for _, colour in _MEANING]
    words = [text for text, _ in _MEANING]
    picture.legend(shown, words, loc="outside upper center", ncols=4, fontsize=7)
    return picture


def lanes_of(table: Table) -> list[Lane]:
    """Bands from the root outwards, limb by limb.

    Raises:
        DataError: There are no powers of segments, or too many.
    """
    taken = [name.removesuffix(_TAKEN) for name in table if name.endswith(_TAKEN)]
    if not taken:
        raise DataError("no column *.proximal_power; accepted: a result of inverse --power")
    before = {}
    for name in table:
        segment, found, following = name.partition(_GIVEN)
        if found:
            before[following] = segment
    lanes: list[Lane] = []
    for root in (name for name in taken if name not in before):
        power = table[root + _TAKEN]
        lanes.append(Lane(f"the world to {root}", power, (_OUTWARDS, _INWARDS), root))
        lanes += _beyond(table, root, before)
    if len(lanes) > _MOST:
        raise DataError(f"{len(lanes)} bands are too many for a picture; accepted: {_MOST}")
    return lanes


def _beyond(table: Table, segment: str, before: dict[str, str]) -> list[Lane]:
    """Bands of all that a segment carries."""
    lanes: list[Lane] = []
    for following in [name for name, parent in before.items() if parent == segment]:
        passed_on = -table[f"{segment}{_GIVEN}{following}"]
        taken = table[following + _TAKEN]
        flow = _OUTWARDS, _INWARDS
        lanes += [
            Lane(f"{segment} to the joint of {following}", passed_on, flow, segment),
            Lane(f"joint of {following}", taken - passed_on, (_MADE, _LOST), ""),
            Lane(f"into {following}", taken, flow, following),
        ]
        lanes += _beyond(table, following, before)
    return lanes


def _draw(axes: Any, time: Array, at: float, lane: Lane, scale: float) -> None:
    if lane.segment:
        axes.axhspan(at - 0.5, at + 0.5, color="#000000", alpha=0.045, lw=0)
    axes.axhline(at, color="#000000", alpha=0.25, lw=0.4)
    wide = np.abs(lane.power) * scale
    for is_there, colour in zip((lane.power >= 0.0, lane.power < 0.0), lane.colours, strict=True):
        half = np.where(is_there, wide, 0.0)
        axes.fill_between(time, at - half, at + half, color=colour, lw=0)


def _work(time: Array, power: Array) -> float:
    """Integral over time, by trapezoids [J]."""
    return float(np.sum(0.5 * (power[1:] + power[:-1]) * np.diff(time)))
