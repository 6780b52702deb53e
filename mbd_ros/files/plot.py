"""Pictures of tables and of power that flows."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.files.formats import PICTURES
from mbd_ros.files.replacing import replacing
from mbd_ros.files.table import MAIN, STAMP, TIME, Column, Result, Table

# ---- plot -------------------------------------------------------------------------------------
# Pictures of tables: a panel for each quantity, a curve for each column; writes only.


_PANEL, _WIDTH, _EDGE = 1.7, 8.0, 0.6  # in
_DPI = 110  # per in
_CURVES, _POINTS = 12, 4000  # a panel, a curve: more is not to be seen
_LATER = (  # drawn where they are asked for
    *("acceleration", "linear_acceleration", "angular_acceleration"),
    *("command", "energy", "drift"),
    *("gravity", "coriolis", "inertial", "external"),
)
_COMPONENT = re.compile(r"(force|torque|multiplier|.+(?=_q?[xyzw]$))(?:_(.+))?")
_AXES = ("x", "y", "z", "w")
_MOST = 24  # panels


class Picture(Figure):
    """A figure that a notebook shows without pyplot."""

    def _repr_png_(self) -> bytes:
        from io import BytesIO

        FigureCanvasAgg(self)
        drawn = BytesIO()
        self.savefig(drawn, format="png", dpi=_DPI)
        return drawn.getvalue()


class Plot:
    """.png, .svg and .pdf of one table."""

    content = "numbers"
    one_table = True

    def holds(self, column: Column) -> bool:
        """Always; what is no number is not drawn."""
        return True

    def read(self, path: Path) -> Result:
        """Refused.

        Raises:
            DataError: Always.
        """
        raise DataError(f"{path}: a picture, which is only written; results are read from others")

    def write(self, path: Path, result: Result, columns: Sequence[str] | None = None) -> None:
        """Draw a table; see `figure`."""
        ((name, _),) = result.tables.items()
        save(figure(result, table=name, columns=columns), path)


def figure(result: Result, table: str = MAIN, columns: Sequence[str] | None = None) -> "Picture":
    """Curves over time, or over the number of the row.

    Args:
        result: The result.
        table: Which of its tables.
        columns: Columns (`knee.position`), or last words of their names (`effort`); without any,
            all but accelerations, commands, causes, energy and drift, or what else there is.

    Raises:
        DataError: A column that is not there, or nothing to draw.
    """
    drawn = result[table]
    panels = _panels(drawn, columns)
    if not panels:
        raise DataError(f"table {table}: no column of numbers to draw")
    picture = Picture(figsize=(_WIDTH, len(panels) * _PANEL + _EDGE), layout="constrained")
    FigureCanvasAgg(picture)
    grid: Any = picture.subplots(len(panels), 1, sharex=True, squeeze=False)
    time = drawn[TIME] if TIME in drawn else np.arange(drawn.rows)
    every = slice(None, None, max(1, drawn.rows // _POINTS))
    for axes, (title, chosen) in zip(grid[:, 0], panels.items(), strict=True):
        for column in chosen[:_CURVES]:
            axes.plot(time[every], column.values[every].reshape(len(time[every]), -1), lw=1.0)
        axes.set_ylabel(title, fontsize=8, parse_math=False)
        axes.tick_params(labelsize=7)
        axes.grid(visible=True, alpha=0.3)
        names = [_curve(column) for column in chosen[:_CURVES]]
        more = [f"and {len(chosen) - _CURVES} more"] if len(chosen) > _CURVES else []
        if len(axes.lines) == len(names):
            legend = axes.legend(names, fontsize=6, loc="upper right", title="".join(more) or None)
            for text in legend.get_texts():
                text.set_parse_math(False)
    grid[-1, 0].set_xlabel("time [s]" if TIME in drawn else "row", fontsize=8)
    return picture


def save(picture: Figure, path: Path) -> None:
    """Write a figure as the suffix of the path says.

    Raises:
        DataError: A suffix of no picture, or a place that cannot be written to.
    """
    if path.suffix not in PICTURES:
        raise DataError(f"{path}: no suffix of a picture, accepted: {', '.join(PICTURES)}")
    with replacing(path) as file:
        dated = (
            {}
            if path.suffix == ".png"
            else {"Date" if path.suffix == ".svg" else "CreationDate": None}
        )
        picture.savefig(file, format=path.suffix[1:], dpi=_DPI, metadata=dated)


def _panels(table: Table, asked: Sequence[str] | None) -> dict[str, list[Column]]:
    """Label of the axis -> columns, by quantity and unit."""
    numbers = [
        c for c in table.columns if c.name not in (TIME, STAMP) and c.values.dtype.kind in "fiub"
    ]
    if asked is not None:
        chosen = []
        for name in asked:
            found = [c for c in numbers if name in (c.name, *_words(c)[1:])]
            if not found:
                table.column(name)  # says which there are
                raise DataError(f"column {name} holds no numbers to draw")
            chosen += found
    else:
        chosen = [c for c in numbers if not {*c.name.split(".")} & {*_LATER}] or numbers
    panels: dict[str, list[Column]] = {}
    for column in chosen:
        title = _words(column)[2] + (f"\n[{column.unit}]" if column.unit else "")
        panels.setdefault(title, []).append(column)
    return dict(list(panels.items())[:_MOST])


def _words(column: Column) -> tuple[str, str, str]:
    """Part, quantity, and the quantity without its component: force of force_x or force.x."""
    part, _, quantity = column.name.rpartition(".")
    if quantity in _AXES and "." in part:
        part, _, whole = part.rpartition(".")
        return part, f"{whole}_{quantity}", whole
    found = _COMPONENT.fullmatch(quantity)
    return part, quantity, found[1] if found else quantity


def _curve(column: Column) -> str:
    """Part and component: `foot_loop_closure x`."""
    part, quantity, whole = _words(column)
    component = quantity.removeprefix(whole).lstrip("_")
    name = " ".join(filter(None, (part, component))) or column.name
    return f" {name}" if name.startswith("_") else name  # matplotlib hides labels that begin so


# ---- power flow -------------------------------------------------------------------------------
# Pictures of power that flows from segment to segment: bands as wide as it, over time.
#
# A joint has three bands: what the segment before it gives, what acts in the joint, what the next
# segment takes. What comes out of a rigid segment at its far end, and was not made there, came in
# at
# its near end.


_LANE, _POWER_FLOW_WIDTH, _POWER_FLOW_EDGE = 0.42, 9.0, 1.0  # in
_HIGH = 0.46  # of a lane: half a band of the largest power
_TAKEN, _GIVEN = ".proximal_power", ".distal_power_"
_OUTWARDS, _INWARDS, _MADE, _LOST = "#c4553b", "#3b6fc4", "#2f8f4e", "#8a8a8a"
_MEANING = (
    ("towards the next segment", _OUTWARDS),
    ("towards the one before", _INWARDS),
    ("made in the joint", _MADE),
    ("taken by the joint", _LOST),
)
_POWER_FLOW_MOST = 60  # lanes


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
    picture = Picture(
        figsize=(_POWER_FLOW_WIDTH, len(lanes) * _LANE + _POWER_FLOW_EDGE), layout="constrained"
    )
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
    if len(lanes) > _POWER_FLOW_MOST:
        raise DataError(
            f"{len(lanes)} bands are too many for a picture; accepted: {_POWER_FLOW_MOST}"
        )
    return lanes


def _beyond(table: Table, segment: str, before: dict[str, str]) -> list[Lane]:
    """Bands of all that a segment carries."""
    lanes: list[Lane] = []
    for following in [name for name, parent in before.items() if parent == segment]:
        given = -table[f"{segment}{_GIVEN}{following}"]
        taken = table[following + _TAKEN]
        flow = _OUTWARDS, _INWARDS
        lanes += [
            Lane(f"{segment} to the joint of {following}", given, flow, segment),
            Lane(f"joint of {following}", taken - given, (_MADE, _LOST), ""),
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
