"""The map of verdicts, and energy and violations over long runs, as pictures."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from mbd_ros.applications.report.stability.cases import (
    BOUNDED,
    COLUMNS,
    CONVERGED,
    STOPPED,
    UNKNOWN,
    VERDICTS,
    WARNED,
    WRONG,
)
from mbd_ros.applications.report.stability.row_labels import row_label

# Colours of Okabe and Ito, which colour-blind people tell apart; the symbols do without them.
_COLORS = {
    CONVERGED: "#009E73",
    BOUNDED: "#56B4E9",
    STOPPED: "#DDDDDD",
    WARNED: "#E69F00",
    UNKNOWN: "#FFFFFF",
    WRONG: "#000000",
}
_SYMBOLS = {CONVERGED: "", BOUNDED: "~", STOPPED: "■", WARNED: "!", UNKNOWN: "?", WRONG: "X"}
_LINES = {
    "rattle": "#0072B2",
    "gauss_legendre": "#D55E00",
    "generalized_alpha": "#CC79A7",
    "rk4": "#009E73",
    "dopri5": "#000000",
}
_DASHES = {"rattle": "-", "gauss_legendre": "--", "generalized_alpha": "-.", "rk4": ":"}
_LEAST = 1.0e-17  # shown instead of zero
_ROW_HEIGHT = 0.2  # inches
_SIZE = 7.5  # pt


def verdict_map(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Scenes over methods; a number is the power of ten of the error.

    Args:
        rows: Outcomes of extreme scenes.
    """
    height = _ROW_HEIGHT * len(rows) + 1.6
    figure = Figure(figsize=(8.0, height), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    shade = np.full((len(rows), len(COLUMNS)), np.nan)
    for i, row in enumerate(rows):
        for cell in row["cells"]:
            k = COLUMNS.index(cell["method"])
            shade[i, k] = VERDICTS.index(cell["kind"])
            color = "white" if cell["kind"] == WRONG else "black"
            axes.text(k, i, _symbol(cell), ha="center", va="center", fontsize=_SIZE, color=color)
    colors = ListedColormap([_COLORS[kind] for kind in VERDICTS])
    axes.imshow(shade, cmap=colors, vmin=-0.5, vmax=len(VERDICTS) - 0.5, aspect="auto")
    names = [_label(rows, i) for i in range(len(rows))]
    axes.set_yticks(range(len(rows)), names, fontsize=_SIZE, parse_math=False)
    names = [name.replace("_", "\n") for name in COLUMNS]
    axes.set_xticks(range(len(COLUMNS)), names, fontsize=_SIZE)
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    _separate(axes, rows)
    shown = [Patch(fc=_COLORS[k], ec="gray", label=f"{_SYMBOLS[k]} {k}".strip()) for k in VERDICTS]
    figure.legend(handles=shown, loc="outside lower center", ncols=len(shown), fontsize=_SIZE)
    return figure


def _symbol(cell: Mapping[str, Any]) -> str:
    symbol, error = _SYMBOLS[cell["kind"]], float(cell["error"])
    if cell["kind"] not in (CONVERGED, BOUNDED) or not 0.0 < error < math.inf:
        return symbol
    return f"{symbol} {math.ceil(math.log10(error))}".strip()


def _label(rows: Sequence[Mapping[str, Any]], i: int) -> str:
    row = rows[i]
    is_first = i == 0 or rows[i - 1]["family"] != row["family"]
    return f"{row['family']}: {row_label(row)}" if is_first else row_label(row)


def _separate(axes: Any, rows: Sequence[Mapping[str, Any]]) -> None:
    """A line between families, and white ones between cells."""
    axes.set_xticks(np.arange(-0.5, len(COLUMNS)), minor=True)
    axes.set_yticks(np.arange(-0.5, len(rows)), minor=True)
    axes.grid(which="minor", color="white", lw=0.6)
    axes.tick_params(which="minor", length=0)
    for i in range(1, len(rows)):
        if rows[i]["family"] != rows[i - 1]["family"]:
            axes.axhline(i - 0.5, color="black", lw=0.8)


def long_run_plot(title: str, runs: Sequence[Mapping[str, Any]]) -> Figure:
    """Energy error and constraint violation over time, one line a method.

    Args:
        title: Above the picture.
        runs: Outcomes of long runs of one scene.
    """
    has_rows = any(max(run["series"]["open"], default=0.0) > 0.0 for run in runs)
    figure = Figure(figsize=(8.0, 5.4 if has_rows else 3.2), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2 if has_rows else 1, sharex=True, squeeze=False)[:, 0]
    for run in runs:
        series, name = run["series"], run["method"]
        style = {"color": _LINES[name], "ls": _DASHES.get(name, "-"), "lw": 1.0}
        times = np.array(series["t"]) / 3600.0
        energy = np.abs(series["energy"]) / run.get("swing", 1.0)
        panels[0].semilogy(times, np.maximum(energy, _LEAST), label=name, **style)
        if has_rows:
            panels[1].semilogy(times, np.maximum(series["open"], _LEAST), **style)
    panels[0].set_ylabel("|energy error| / largest kinetic energy")
    if has_rows:
        panels[1].set_ylabel("largest |g| [m or rad]")
    panels[-1].set_xlabel("simulated time [h]")
    panels[0].set_title(f"{title}: {max(run['steps'] for run in runs):.0e} steps")
    for axes in panels:
        axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=len(runs), fontsize=8)
    return figure
