"""What the page says of stability."""

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbd_ros.report.items import Item, Outcome, Section, Table
from mbd_ros.report.stability.cases import (
    BOUNDED,
    CONVERGED,
    METHODS,
    STOPPED,
    VERDICTS,
    WARNED,
    WRONG,
)
from mbd_ros.report.stability.figures import verdict_map
from mbd_ros.report.stability.verdicts import ASKED

TITLE = "Stability"
_METHODS_TABLE = "Verdicts by method"
_NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?")
_ROW = re.compile(r"row \S+")
_SHOWN = 25  # reasons
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
        wrong=[line for item, outcome in outcomes for line in _wrong(item, outcome)],
        headline=[_METHODS_TABLE, *figures],
    )


def _name(row: Mapping[str, Any]) -> str:
    return f"random scene {row['seed']}" if "seed" in row else f"{row['family']}, {row['label']}"


def _wrong(item: Item, outcome: Outcome) -> list[str]:
    """What is wrong with an item, a line each, and how to see it again."""
    lines = []
    for row in outcome.get("random", (outcome,)):
        spec = {"first": row["seed"], "count": 1} if "seed" in row else dict(item.spec)
        again = f"again: mbd_ros.report.stability.run({spec})"
        for cell in row["cells"]:
            if cell["kind"] == WRONG:
                how = f"{cell['method']}, {cell['factor']:g} x recommended, tier {cell['tier']}"
                lines.append(f"{_name(row)}, {how}: {cell['text']}; {again}")
    return lines


def _text(
    rows: Sequence[Mapping[str, Any]], drawn: Sequence[Mapping[str, Any]], cells: Cells
) -> list[str]:
    kinds = Counter(cell["kind"] for _, cell in cells)
    counts = ", ".join(f"{kinds[kind]} {kind}" for kind in VERDICTS if kinds[kind])
    known = [row for row in (*rows, *drawn) if "span" in row]
    whole = sum(row["known_until"] >= 0.999 * row["span"] for row in known)
    growth = [row["growth"] for row in known if math.isfinite(row["growth"])]
    worst = max(growth, default=1.0)
    return [
        f"{len(rows)} extreme scenes under every method and {len(drawn)} random scenes under "
        f"three methods, tiers and steps each: {counts}.",
        f"{CONVERGED}: within {ASKED:g} of the size of the motion. {BOUNDED}: further off, but "
        "with bounded energy, and shorter steps lead to the reference or the step does not "
        f"resolve the motion. {STOPPED}: an error that names time, joint or row. {WARNED}: "
        "garbage with finite numbers, of which `check` or `simulate` warns. "
        f"{WRONG}: not a number, another exception, or finite but wrong without a warning; any "
        "such cell fails the report.",
        "References: DOP853 with tolerance 1e-9, which Gauss-Legendre of order 6 or DOPRI5 with "
        "tolerance confirms to 1e-4. Cells named `equations` hold the accelerations against "
        "mechanics evaluated apart from the code that made them: Newton-Euler residual, g'' and J "
        "by differences of constraints evaluated from frame placements, complementarity, energy "
        "against the work done.",
        f"Chaos: {whole} of {len(known)} motions are compared to their end; the others only for "
        "as long as a perturbation grows less than 1e3-fold and both references agree. The "
        f"largest growth within what is compared is {worst:.0f}-fold.",
    ]


def _by_method(cells: Cells) -> Table:
    rows = []
    for method in ("equations", *METHODS):
        mine = [cell for _, cell in cells if cell["method"] == method]
        kinds = Counter(cell["kind"] for cell in mine)
        errors = [cell["error"] for cell in mine if cell["kind"] == CONVERGED]
        middle = f"{np.median(errors):.1e}" if errors else ""
        rows.append([method, str(len(mine)), *(str(kinds[kind]) for kind in VERDICTS), middle])
    columns = ["method", "cells", *VERDICTS, "median error where converged"]
    return Table(_METHODS_TABLE, columns, rows)


def _steps(drawn: Sequence[Mapping[str, Any]]) -> Table:
    cells = [cell for row in drawn for cell in row["cells"] if cell["factor"] > 0.0]
    rows = []
    for factor in sorted({cell["factor"] for cell in cells}):
        kinds = Counter(cell["kind"] for cell in cells if cell["factor"] == factor)
        rows.append([f"{factor:g}", *(str(kinds[kind]) for kind in VERDICTS)])
    return Table("Random scenes by step", ["step / recommended", *VERDICTS], rows)


def _reasons(cells: Cells) -> Table:
    """Every reason of a stop, without its numbers, with an example."""
    found: dict[str, list[str]] = {}
    for name, cell in cells:
        if cell["kind"] == STOPPED:
            reason = _ROW.sub("row ..", cell["text"].split("; last finite")[0])
            reason = _NUMBER.sub("..", re.sub(r"^(\w+): \S*scene.yaml\S*", r"\1:", reason))
            found.setdefault(reason, []).append(f"{name}, {cell['method']}")
    ordered = sorted(found.items(), key=lambda pair: (-len(pair[1]), pair[0]))
    rows = [[reason, str(len(where)), where[0]] for reason, where in ordered[:_SHOWN]]
    if rest := ordered[_SHOWN:]:
        rows.append(["others", str(sum(len(where) for _, where in rest)), ""])
    return Table("Why runs stopped", ["reason", "runs", "for example"], rows)
