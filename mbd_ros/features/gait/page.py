"""A self-contained HTML page of gaits: tables, and pictures of motions, branches and basins."""

import base64
import html
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg

from mbd_ros.core.state import Array
from mbd_ros.features.gait.tables import BASIN, BRANCHES, GAITS, MARKS
from mbd_ros.files.plot import Picture
from mbd_ros.files.table import MAIN, TIME, Result, Table
from mbd_ros.files.text_file import replacing

_WIDTH, _HEIGHT = 8.0, 3.4  # in
_COLOURS = ("tab:blue", "tab:orange", "tab:green", "tab:red", "tab:purple", "tab:brown")
_SYMBOLS = {1: "s", 2: "D", 3: "^"}  # of marks
_STYLE = (
    "body{font:15px sans-serif;max-width:60em;margin:2em auto;padding:0 1em}"
    "table{border-collapse:collapse;font-size:13px}td,th{padding:.2em .7em;text-align:right;"
    "border-bottom:1px solid #ccc}img{max-width:100%}"
)


def write_page(result: Result, path: Path, parameter: str) -> None:
    """Write the page. Names from files are escaped.

    Args:
        result: Result of `run_gait`.
        parameter: Parameter of the continuation; empty without one.
    """
    title = html.escape(f"Gaits of {result.metadata['scene']}")
    lines = [
        "<!doctype html>",
        f'<html lang="en"><head><meta charset="utf-8"><title>{title}</title>',
        '<meta name="viewport" content="width=device-width">',
        f"<style>{_STYLE}</style></head><body><h1>{title}</h1>",
        *_sections(result, parameter),
        "</body></html>",
    ]
    with replacing(path) as file:
        file.write("\n".join(lines).encode())


def _sections(result: Result, parameter: str) -> Iterator[str]:
    yield from _transposed(result[GAITS])
    yield "<h2>The first gait</h2>"
    yield _image(portrait(result[MAIN])._repr_png_(), "positions and velocities over a cycle")
    if BRANCHES in result:
        yield f"<h2>Gaits by {html.escape(parameter)}</h2>"
        yield "<p>Unstable parts are dotted. Squares are folds, diamonds period doublings.</p>"
        yield _image(diagram(result[BRANCHES], parameter)._repr_png_(), "branches")
        yield from _marks(result[BRANCHES], parameter)
    if BASIN in result:
        yield "<h2>Starts</h2>"
        picture = basin(result[BASIN])
        if picture is not None:
            yield _image(picture._repr_png_(), "outcome of each start")
        total, table = result[BASIN].rows, result[BASIN]
        count = int((table["outcome"] > 0).sum())
        yield f"<p>{count} of {total} starts lead to a gait.</p>"


def _transposed(table: Table) -> Iterator[str]:
    """Yield a table with one row per column, so that gaits are side by side."""
    yield "<table>"
    for column in table.columns:
        cells = "".join(f"<td>{html.escape(_text(value))}</td>" for value in column.values)
        yield f"<tr><th>{html.escape(column.label)}</th>{cells}</tr>"
    yield "</table>"


def _text(value: object) -> str:
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def _image(png: bytes, text: str) -> str:
    return f'<img alt="{text}" src="data:image/png;base64,{base64.b64encode(png).decode()}">'


def portrait(samples: Table) -> Picture:
    """Plot joints over time, and velocity over position."""
    picture, (left, right) = _pair()
    names = [name.removesuffix(".position") for name in samples if name.endswith(".position")]
    for name in (name for name in names if f"{name}.velocity" in samples):
        left.plot(samples[TIME], samples[f"{name}.position"], lw=1.2, label=name)
        right.plot(samples[f"{name}.position"], samples[f"{name}.velocity"], lw=1.2)
    left.set_xlabel("time [s]")
    left.set_ylabel("position [rad or m]")
    right.set_xlabel("position")
    right.set_ylabel("velocity")
    left.legend(fontsize=6)
    return picture


def _pair() -> tuple[Picture, Any]:
    picture = Picture(figsize=(_WIDTH, _HEIGHT), layout="constrained")
    FigureCanvasAgg(picture)
    axes: Any = picture.subplots(1, 2)
    for panel in axes:
        panel.grid(visible=True, alpha=0.3)
        panel.tick_params(labelsize=7)
        panel.xaxis.label.set_size(8)
        panel.yaxis.label.set_size(8)
    return picture, axes


def diagram(branches: Table, parameter: str) -> Picture:
    """Plot period and largest multiplier over the parameter, with unstable parts dotted."""
    picture, (left, right) = _pair()
    for number in np.unique(branches["branch"]):
        rows = branches["branch"] == number
        colour = _COLOURS[int(number - 1) % len(_COLOURS)]
        at, cycles = branches["parameter"][rows], branches["cycles"][rows]
        size = np.hypot(branches["multiplier_1.real"], branches["multiplier_1.imaginary"])[rows]
        label = f"branch {number}, {int(cycles[0])} cycle{'s' * bool(cycles[0] > 1)}"
        for axes, values in ((left, branches["period"][rows] / cycles), (right, size)):
            _stretches(axes, at, values, branches["stable"][rows].astype(bool), colour)
            for mark, symbol in _SYMBOLS.items():
                here = branches["mark"][rows] == mark
                axes.plot(at[here], values[here], symbol, ms=5, color=colour)
        left.plot([], [], color=colour, label=label)
    right.axhline(1.0, lw=0.6, color="gray")
    right.set_yscale("log")
    left.set_ylabel("period / cycles [s]")
    right.set_ylabel("largest |multiplier|")
    for axes in (left, right):
        axes.set_xlabel(parameter)
    left.legend(fontsize=6)
    return picture


def _stretches(axes: Any, at: Array, values: Array, stable: Array, colour: str) -> None:
    for chosen, style in ((stable, "-"), (~stable, ":")):
        near = chosen | np.roll(chosen, 1)  # up to where it changes
        near[0] = chosen[0]
        axes.plot(at, np.where(near, values, np.nan), style, color=colour, lw=1.2)


def _marks(table: Table, parameter: str) -> Iterator[str]:
    rows = [i for i, mark in enumerate(table["mark"]) if mark]
    if not rows:
        return
    yield f"<table><tr><th>branch</th><th>bifurcation</th><th>{html.escape(parameter)}</th></tr>"
    for i in rows:
        kind = MARKS[int(table["mark"][i])]
        yield (
            f"<tr><td>{table['branch'][i]}</td><td>{kind}</td>"
            f"<td>{table['parameter'][i]:.12g}</td></tr>"
        )
    yield "</table>"


def basin(starts: Table) -> Picture | None:
    """Plot outcomes on a grid of two joints; return None for other grids."""
    names = [name for name in starts if name not in ("outcome", "cycles")]
    if len(names) != 2:
        return None
    picture, (left, right) = _pair()
    x, y = (starts[name] for name in names)
    for axes, values, title in (
        (left, starts["outcome"], "gait (0 fall, -1 undecided)"),
        (right, starts["cycles"], "cycles until the outcome is known"),
    ):
        points = axes.scatter(x, y, c=values, s=10, marker="s", cmap="viridis")
        picture.colorbar(points, ax=axes, label=title)
        axes.set_xlabel(names[0])
        axes.set_ylabel(names[1])
    return picture
