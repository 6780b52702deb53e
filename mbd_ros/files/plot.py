"""Pictures of tables: a panel for each quantity, a curve for each column; writes only."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mbd_ros.errors import DataError
from mbd_ros.files.formats import PICTURES
from mbd_ros.files.table import MAIN, STAMP, TIME, Column, Result, Table
from mbd_ros.files.text_file import replacing

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


class Plot:
    """.png, .svg and .pdf of one table."""

    content = "numbers"
    one_table = True

    def holds(self, column: Column) -> bool:
        """Whether it can be written: what is no number is not drawn."""
        return True

    def read(self, path: Path) -> Result:
        """Refuse to read a picture."""
        raise DataError(f"{path}: a picture, which is only written; results are read from others")

    def write(self, path: Path, result: Result, columns: Sequence[str] | None = None) -> None:
        """Draw a table; see `figure`."""
        ((name, _),) = result.tables.items()
        save(figure(result, table=name, columns=columns), path)

    def figure(
        self, result: Result, table: str = MAIN, columns: Sequence[str] | None = None
    ) -> "Picture":
        """Draw a table and write nothing; see `figure`."""
        return figure(result, table, columns)

    def save(self, picture: Figure, path: Path) -> None:
        """Write what `figure` drew."""
        save(picture, path)


def figure(result: Result, table: str = MAIN, columns: Sequence[str] | None = None) -> "Picture":
    """Curves over time, or over the number of the row.

    Args:
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


class Picture(Figure):
    """A figure that a notebook shows without pyplot."""

    def _repr_png_(self) -> bytes:
        from io import BytesIO

        FigureCanvasAgg(self)
        drawn = BytesIO()
        self.savefig(drawn, format="png", dpi=_DPI)
        return drawn.getvalue()


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


def _panels(table: Table, wanted: Sequence[str] | None) -> dict[str, list[Column]]:
    """Label of the axis -> columns, by quantity and unit."""
    numbers = [
        c for c in table.columns if c.name not in (TIME, STAMP) and c.values.dtype.kind in "fiub"
    ]
    if wanted is not None:
        chosen = []
        for name in wanted:
            matching = [c for c in numbers if name in (c.name, *_words(c)[1:])]
            if not matching:
                table.column(name)  # says which there are
                raise DataError(f"column {name} holds no numbers to draw")
            chosen += matching
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
