"""The section of the page about stability.

Its pictures are the map of verdicts, and energy and violations over long runs.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from mbd_ros.applications.report.items import Item, Outcome, Section, Table
from mbd_ros.applications.report.stability.verdicts import (
    ASKED,
    BOUNDED,
    COARSE,
    COLUMNS,
    CONVERGED,
    FITTING,
    LATEST,
    STOPPED,
    UNKNOWN,
    VERDICTS,
    WARNED,
    WRONG,
    is_another,
)

_WHOLE = 0.999  # of the span
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
# The meaning of cells, numbers and labels of the map, a sentence each.
_CELLS = (
    f"{CONVERGED}: within {ASKED:g} of the size of the motion, at every time after the start that "
    "can be compared.",
    f"{BOUNDED}: further off, but with bounded energy; shorter steps lead to the reference, or "
    "`check` or `simulate` warns of the step, or the step of an implicit method does not resolve "
    f"the motion (rate times step above {COARSE:g}); in the last two no shorter step is tried.",
    f"{STOPPED}: an error that names time, joint, link or row.",
    f"{WARNED}: garbage with finite numbers, of which `check` or `simulate` warns.",
    f"{UNKNOWN}: bounded energy and no warning, but no time after the start at which the motion "
    "is known, or all shorter steps fail and both they and the reference stop.",
    f"{WRONG}: not a number, another exception, finite but wrong without a warning, off while no "
    "shorter step leads to the reference, or a scene of this package that cannot be built or "
    "whose reference stops; any such cell fails the report.",
)
MEANINGS = (
    " ".join(_CELLS),
    "A number in the map is the power of ten of the largest error, rounded up and relative to the "
    "size of the motion: -4 is an error up to 1e-4, ~ -1 one up to 0.1 that is bounded. A cell "
    "without a number has an error of zero or none that can be told; an empty place is a method "
    "that does not take the scene.",
    f"Steps: the motion lasts at least {FITTING} steps, but no step makes it last longer than "
    f"{LATEST:g} s. What is run is the nearest step that meets the times of the comparison; a "
    "label of a step adds the multiples that were run where one is more than 20 % off. Where "
    "nothing has a rate no step is recommended. Methods that choose their steps are run once a "
    "scene: where several rows differ by the step, in that of the recommended one.",
    "References: DOP853 with tolerance 1e-9, which Gauss-Legendre of order 6 or DOPRI5 with "
    "tolerance confirms to 1e-4. Where a scene stands far away or passes gimbal lock, they "
    "come from other equations: the same scene at the origin in another tier, and Euler's "
    "equations in body axes. Cells named `equations` hold the accelerations against "
    "mechanics evaluated apart from the code that made them: Newton-Euler residual, g'' and J "
    "by differences of constraints evaluated from frame placements, complementarity, energy "
    "against the work done.",
)
TITLE = "Stability"
_METHODS_TABLE = "Verdicts by method"
_NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?")
_ROW = re.compile(r"row \S+")
_SCENE = re.compile(r"^(\w+): (\S*scene\.yaml\S*|scene:)")
_SHOWN = 25  # reasons
_SHORT, _TELLING = 0.1, 50  # multiple of the recommended step; runs that tell of a whole
Cells = Sequence[tuple[str, Mapping[str, Any]]]  # name of the row, cell


def stability_section(outcomes: Sequence[tuple[Item, Outcome]]) -> Section:
    """Counts, reasons, the map, and what is wrong."""
    rows = [outcome for _, outcome in outcomes if "random" not in outcome]
    drawn = [row for _, outcome in outcomes for row in outcome.get("random", ())]
    if not rows and not drawn:
        return Section(TITLE, ["No scene was run."])
    every = [(_name(row), row) for row in (*rows, *drawn)]
    cells = [(name, cell) for name, row in every for cell in row["cells"]]
    tables = [_by_method(cells), _reasons(cells), *([_steps(drawn)] if drawn else [])]
    figures = {"stability_map": verdict_map(rows)} if rows else {}
    return Section(
        title=TITLE,
        text=_text(rows, drawn, cells),
        tables=tables,
        figures=figures,
        wrong=[
            *(line for item, outcome in outcomes for line in _wrong(item, outcome)),
            *_mostly_stopped([c for i, o in outcomes if "scene" not in i.spec for c in _cells(o)]),
        ],
        headline=[_METHODS_TABLE, *figures],
    )


def _name(row: Mapping[str, Any]) -> str:
    return f"random scene {row['seed']}" if "seed" in row else f"{row['family']}, {row_label(row)}"


def _by_method(cells: Cells) -> Table:
    rows = []
    for method in COLUMNS:
        mine = [cell for _, cell in cells if cell["method"] == method]
        kinds = Counter(cell["kind"] for cell in mine)
        errors = [cell["error"] for cell in mine if cell["kind"] == CONVERGED]
        middle = f"{np.median(errors):.1e}" if errors else ""
        rows.append([method, str(len(mine)), *(str(kinds[kind]) for kind in VERDICTS), middle])
    columns = ["method", "cells", *VERDICTS, "median error where converged"]
    return Table(_METHODS_TABLE, columns, rows)


def _reasons(cells: Cells) -> Table:
    """Every reason of a stop, without its numbers, with an example."""
    cells_by_reason: dict[str, list[str]] = {}
    for name, cell in cells:
        if cell["kind"] == STOPPED:
            reason = _ROW.sub("row ..", cell["text"].split("; last finite")[0])
            reason = _NUMBER.sub("..", _SCENE.sub(r"\1:", reason))
            cells_by_reason.setdefault(reason, []).append(f"{name}, {cell['method']}")
    ordered = sorted(cells_by_reason.items(), key=lambda pair: (-len(pair[1]), pair[0]))
    rows = [[reason, str(len(where)), where[0]] for reason, where in ordered[:_SHOWN]]
    if rest := ordered[_SHOWN:]:
        rows.append(["others", str(sum(len(where) for _, where in rest)), ""])
    return Table("Why runs stopped", ["reason", "runs", "for example"], rows)


def _steps(drawn: Sequence[Mapping[str, Any]]) -> Table:
    cells = [cell for row in drawn for cell in row["cells"] if cell["factor"] > 0.0]
    rows = []
    for factor in sorted({cell["factor"] for cell in cells}):
        mine = [cell for cell in cells if cell["factor"] == factor]
        kinds = Counter(cell["kind"] for cell in mine)
        ran = f"{min(c['ran'] for c in mine):.2g} to {max(c['ran'] for c in mine):.2g}"
        rows.append([f"{factor:g}", ran, *(str(kinds[kind]) for kind in VERDICTS)])
    columns = ["step / recommended", "was run at", *VERDICTS]
    return Table("Random scenes by step", columns, rows)


def _text(
    rows: Sequence[Mapping[str, Any]], drawn: Sequence[Mapping[str, Any]], cells: Cells
) -> list[str]:
    kinds = Counter(cell["kind"] for _, cell in cells)
    counts = ", ".join(f"{kinds[kind]} {kind}" for kind in VERDICTS if kinds[kind])
    known = [row for row in (*rows, *drawn) if "span" in row]
    complete = sum(row["known_until"] >= 0.999 * row["span"] for row in known)
    growth = [row["growth"] for row in known if math.isfinite(row["growth"])]
    worst = max(growth, default=1.0)
    return [
        f"{len(rows)} extreme scenes under every method and {len(drawn)} random scenes under "
        f"three methods and tiers and one multiple of the recommended step each: {counts}.",
        *MEANINGS,
        f"Chaos: {complete} of {len(known)} motions are compared to their end; the others only "
        "for as long as a perturbation grows less than 1e3-fold and both references agree, a time "
        "that their labels name. The largest growth within what is compared is "
        f"{worst:.0f}-fold.",
    ]


def _wrong(item: Item, outcome: Outcome) -> list[str]:
    """Faults of an item, a line each, and how to reproduce them."""
    lines = []
    for row in outcome.get("random", (outcome,)):
        spec = {"first": row["seed"], "count": 1} if "seed" in row else dict(item.spec)
        again = f"again: mbd_ros.applications.report.stability.run({spec})"
        for cell in row["cells"]:
            if cell["kind"] == WRONG:
                step = f"dt = {cell['dt']:g} s"
                step += f", {cell['ran']:g} x recommended" if cell["ran"] else ""
                how = f"{cell['method']}, {step if cell['dt'] else 'own steps'}"
                how = f"{how}, tier {cell['tier']}"
                lines.append(f"{_name(row)}, {how}: {cell['text']}; {again}")
    return lines


def _mostly_stopped(cells: Sequence[Mapping[str, Any]]) -> list[str]:
    """Stops with a reason, each right by itself, so many that nothing works."""
    short = [cell for cell in cells if 0.0 < cell["factor"] <= _SHORT]
    stops = sum(cell["kind"] == STOPPED for cell in short)
    if len(short) < _TELLING or 2 * stops <= len(short):
        return []
    return [f"{stops} of {len(short)} runs stop, at {_SHORT:g} x the recommended step or less"]


def _cells(outcome: Outcome) -> list[Mapping[str, Any]]:
    return [cell for row in outcome.get("random", (outcome,)) for cell in row["cells"]]


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


def row_label(row: Mapping[str, Any]) -> str:
    """Label, with the steps that were run where others were asked for, and the compared time.

    Args:
        row: Outcome of an extreme scene, or of one of a user.
    """
    label = str(row["label"])
    if "x recommended" in label:
        label += _other_steps(row)
    if "span" in row and row["known_until"] < _WHOLE * row["span"]:
        label += f" (compared to {row['known_until']:.3g} of {row['span']:.3g} s)"
    return label


def _other_steps(row: Mapping[str, Any]) -> str:
    ran = [cell["ran"] for cell in row["cells"] if is_another(row["factor"], cell["ran"])]
    if not ran:
        return ""
    least, most = (f"{end(ran):.3g}" for end in (min, max))
    return f" ({least if least == most else f'{least} to {most}'} x)"
