"""Panels of the pictures of a demo, narrow enough for a phone."""

from collections.abc import Callable
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mbd_ros.core.state import Array

BLUE, BLACK, ORANGE = "#1f5fa8", "#1c2430", "#d1701f"
_POINTS = 1500  # a line: more is not to be seen
_WIDTH, _PANEL, _EDGE = 5.0, 1.35, 0.5  # in: of a picture, of a panel, above and below them
_SIDE, _GAP = 0.62, 0.3  # in: for the numbers of an axis, between panels
_DPI, _OVERVIEW_DPI = 180, 100  # per in
Draw = Callable[[Any, int], None]


def picture(draw: Draw, count: int) -> bytes:
    """PNG of panels below each other, as wide as a phone shows it.

    Args:
        draw: Fills an axis, given the number of its panel.
    """
    figure, grid = _panels(count, 1)
    _fill(grid[:, 0], draw)
    return _png(figure, _DPI)


def overview(draws: list[Draw], count: int) -> bytes:
    """PNG with a column of panels for each of `draws`, side by side."""
    figure, grid = _panels(count, len(draws))
    for column, draw in enumerate(draws):
        _fill(grid[:, column], draw)
    return _png(figure, _OVERVIEW_DPI)


def name(panel: Any, text: str) -> None:
    """Write the name of a panel above it."""
    panel.set_title(text, loc="left", fontsize=9, pad=4)


def line(
    panel: Any, time: Array, values: Array, colour: str, label: str, style: str = "-"
) -> None:
    """Draw values over time [s]."""
    step = max(len(time) // _POINTS, 1)
    panel.plot(time[::step], values[::step], style, color=colour, lw=1.1, label=label)


def _panels(rows: int, columns: int) -> tuple[Figure, Any]:
    """A figure and its axes, shape (rows, columns)."""
    width, height = columns * _WIDTH, rows * _PANEL + 2 * _EDGE
    figure = Figure(figsize=(width, height))
    figure.subplots_adjust(
        left=_SIDE / width,
        right=1.0 - 0.1 / width,
        bottom=_EDGE / height,
        top=1.0 - _EDGE / height,
        wspace=_SIDE / (_WIDTH - _SIDE),
        hspace=_GAP / (_PANEL - _GAP),
    )
    return figure, figure.subplots(rows, columns, sharex=True, squeeze=False)


def _fill(panels: np.ndarray, draw: Draw) -> None:
    for i, panel in enumerate(panels):
        draw(panel, i)
        panel.grid(alpha=0.3)
        panel.tick_params(labelsize=9)
    place = {"loc": "lower right", "bbox_to_anchor": (1.01, 1.12), "frameon": False}
    panels[0].legend(fontsize=9, ncols=3, **place)
    panels[-1].set_xlabel("time [s]", fontsize=9)


def _png(figure: Figure, dpi: int) -> bytes:
    FigureCanvasAgg(figure)
    file = BytesIO()
    figure.savefig(file, format="png", dpi=dpi)
    return file.getvalue()
