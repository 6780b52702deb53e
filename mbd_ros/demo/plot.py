"""Pictures of a demo, narrow enough for a phone."""

from collections.abc import Callable
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mbd_ros.core.state import Array
from mbd_ros.demo.numbers import DemoNumbers

_POINTS = 1500  # a line: more is not to be seen
_WIDTH, _PANEL, _EDGE = 5.0, 1.35, 0.5  # in: of a picture, of a panel, above and below them
_SIDE, _GAP = 0.62, 0.3  # in: for the numbers of an axis, between panels
_DPI, _OVERVIEW_DPI = 180, 100  # per in
_MEASURED, _WANTED, _ESTIMATE = "#1f5fa8", "#1c2430", "#d1701f"
Draw = Callable[[Any, DemoNumbers, int], None]


def pictures(numbers: DemoNumbers) -> dict[str, bytes]:
    """PNG by title, each as wide as a phone shows it."""
    kinds: list[tuple[str, Draw]] = [
        ("Motion and reference", _draw_motion),
        ("Tracking error", _draw_errors),
        ("Torques", _draw_torques),
    ]
    made = {title: _picture(numbers, draw, len(numbers.joints)) for title, draw in kinds}
    if numbers.signals.forces is not None:
        rows = len(numbers.signals.forces.names)
        made["Coupling and loop forces"] = _picture(numbers, _draw_forces, rows)
    return made


def overview(numbers: DemoNumbers) -> bytes:
    """One PNG with motion, error and torques of every joint side by side."""
    figure, grid = _panels(len(numbers.joints), 3)
    for column, draw in enumerate((_draw_motion, _draw_errors, _draw_torques)):
        _fill(grid[:, column], numbers, draw)
    return _png(figure, _OVERVIEW_DPI)


def _picture(numbers: DemoNumbers, draw: Draw, count: int) -> bytes:
    figure, grid = _panels(count, 1)
    _fill(grid[:, 0], numbers, draw)
    return _png(figure, _DPI)


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


def _fill(panels: np.ndarray, numbers: DemoNumbers, draw: Draw) -> None:
    for i, panel in enumerate(panels):
        draw(panel, numbers, i)
        panel.grid(alpha=0.3)
        panel.tick_params(labelsize=9)
    place = {"loc": "lower right", "bbox_to_anchor": (1.01, 1.12), "frameon": False}
    panels[0].legend(fontsize=9, ncols=3, **place)
    panels[-1].set_xlabel("time [s]", fontsize=9)


def _draw_motion(panel: Any, numbers: DemoNumbers, i: int) -> None:
    states = numbers.signals.states
    column = states.columns(numbers.joints)[i]
    _line(panel, states.time, states.position[:, column], _MEASURED, "measured")
    reference = numbers.reference_at(states.time)[:, i]
    _line(panel, states.time, reference, _WANTED, "reference", "--")
    _name(panel, f"{numbers.joints[i]} [rad]")


def _draw_errors(panel: Any, numbers: DemoNumbers, i: int) -> None:
    loop = numbers.signals.loop
    _line(panel, loop.time, 1e3 * loop.position[:, i], _MEASURED, "error")
    _name(panel, f"{numbers.joints[i]} [mrad]")


def _draw_torques(panel: Any, numbers: DemoNumbers, i: int) -> None:
    time = numbers.time
    _line(panel, time, numbers.commands[:, i], _MEASURED, "command")
    _line(panel, time, numbers.estimates[:, i], _ESTIMATE, "estimate")
    rest = numbers.estimates[:, i] - numbers.disturbance[:, i]
    _line(panel, time, rest, _WANTED, "estimate less disturbance", "--")
    _name(panel, f"{numbers.joints[i]} [N·m]")


def _draw_forces(panel: Any, numbers: DemoNumbers, i: int) -> None:
    forces, estimated = numbers.signals.forces, numbers.signals.coupling
    assert forces is not None
    row = numbers.rows[i]
    _line(panel, forces.time, forces.effort[:, i], _MEASURED, "simulated")
    if estimated is not None and row.name in estimated.names:
        (column,) = estimated.columns([row.name])
        _line(panel, estimated.time, estimated.effort[:, column], _ESTIMATE, "estimated", "--")
    _name(panel, f"{row.name} [{row.unit}]")


def _name(panel: Any, text: str) -> None:
    panel.set_title(text, loc="left", fontsize=9, pad=4)


def _line(
    panel: Any, time: Array, values: Array, colour: str, label: str, style: str = "-"
) -> None:
    step = max(len(time) // _POINTS, 1)
    panel.plot(time[::step], values[::step], style, color=colour, lw=1.1, label=label)


def _png(figure: Figure, dpi: int) -> bytes:
    FigureCanvasAgg(figure)
    file = BytesIO()
    figure.savefig(file, format="png", dpi=dpi)
    return file.getvalue()
