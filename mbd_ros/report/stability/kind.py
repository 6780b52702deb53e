"""Stability: extreme scenes, and thousands of random ones, under every method."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.report.items import Item, Outcome, Section, Spec
from mbd_ros.report.stability.cases import METHODS, WRONG, Case, Verdict, raised
from mbd_ros.report.stability.equations import equations
from mbd_ros.report.stability.extreme_scenes import Extreme, extremes, item_name
from mbd_ros.report.stability.motion import Grid
from mbd_ros.report.stability.page import stability_section
from mbd_ros.report.stability.random_scenes import random_scene
from mbd_ros.report.stability.reference_motion import starting_rate
from mbd_ros.report.stability.scene_text import LoadedScene, SceneText, load, load_file
from mbd_ros.report.stability.verdicts import judge

KIND = "stability"
SCENES, BATCH, QUICK = 2100, 100, 30
_RUNS = 3  # methods that each random scene meets
_FACTORS, _SHARES = (0.1, 0.5, 2.0, 10.0), (0.6, 0.2, 0.1, 0.1)
_TURNS, _LONGEST, _POINTS = 12.0, 0.12, 12  # span: in 1 / rate, and at most [s]; intervals
_USER_FACTORS = (0.1, 1.0, 10.0)
_SECONDS = 0.4  # a random scene


def items(scenes: Sequence[str], quick: bool) -> list[Item]:
    """Extreme and random scenes, or those that a user names at several steps."""
    if scenes:
        return [
            Item(KIND, item_name(f"{i}-{Path(s).stem}-{f:g}"), {"scene": s, "factor": f}, 5.0)
            for i, s in enumerate(scenes)
            for f in _USER_FACTORS
        ]
    rows = [Item(KIND, row.name, {"row": row.name}, row.seconds) for row in extremes(quick)]
    count, batch = (QUICK, QUICK // 2) if quick else (SCENES, BATCH)
    for first in range(0, count, batch):
        spec = {"first": first, "count": batch}
        rows.append(Item(KIND, f"random-{first:04d}", spec, _SECONDS * batch))
    return rows


def run(spec: Spec) -> Outcome:
    """Judge one row of the map, or a batch of random scenes."""
    with np.errstate(all="ignore"):  # what diverges says so itself
        if "first" in spec:
            seeds = range(int(spec["first"]), int(spec["first"]) + int(spec["count"]))
            return {"random": [random_row(seed) for seed in seeds]}
        if "scene" in spec:
            return user_row(str(spec["scene"]), float(spec["factor"]))
        row = next(row for row in extremes(quick=False) if row.name == spec["row"])
        return extreme_row(row)


def section(outcomes: Sequence[tuple[Item, Outcome]]) -> Section:
    """Counts, reasons, the map, and what is wrong."""
    return stability_section(outcomes)


def extreme_row(row: Extreme) -> Outcome:
    """One scene under every method that takes it."""
    facts = {"family": row.family, "label": row.label, "factor": row.factor, "dt": row.dt}
    return {**facts, **_row(row.load, row.grid, partial(_every, row.factor, row.dt))}


def user_row(name: str, factor: float) -> Outcome:
    """The same for a scene of a user."""
    facts = {"family": Path(name).stem, "label": f"{factor:g} x recommended", "factor": factor}
    return {**facts, "dt": 0.0, **_row(partial(load_file, name), None, partial(_every, factor, 0))}


def random_row(seed: int) -> Outcome:
    """One random scene under a few methods, tiers and steps that its seed chooses."""
    text = random_scene(seed)
    found = {"seed": seed, **_row(partial(load, text), None, partial(_some, seed))}
    return {**found, **_kept(text)} if is_wrong(found) else found


def is_wrong(row: Mapping[str, Any]) -> bool:
    """Whether any of the cells of a row is."""
    return any(cell["kind"] == WRONG for cell in row["cells"])


def _kept(text: SceneText) -> Outcome:
    return {"scene": text.scene, "urdf": text.urdf}


def _row(
    read: Callable[[], LoadedScene],
    grid: Grid | None,
    cells: Callable[[Case], list[Outcome]],
) -> Outcome:
    """What a scene comes to: how far its motion is known, and its cells."""
    try:
        loaded = read()
        if not math.isfinite(starting_rate(loaded.scene)):
            verdict = Verdict(WRONG, math.inf, "accelerations at the start are not finite")
            return {"cells": [_cell("equations", verdict)]}
        case = Case(loaded, grid or usual_grid(loaded))
    except Exception as error:  # noqa: BLE001 - every exception is a verdict
        return {"cells": [_cell("equations", raised(error))]}
    known = case.reference
    return {
        "known_until": known.grid.interval * max(0, known.horizon - 1),
        "span": known.grid.span,
        "uncertain": _short(known.uncertain),
        "growth": _short(known.growth),
        "second": known.second,
        "rates": [_short(rate) for rate in known.rates],
        "cells": [_cell("equations", equations(case, case.tiers("rk4"))), *cells(case)],
    }


def usual_grid(loaded: LoadedScene) -> Grid:
    """Some turns of the fastest motion at the start."""
    span = min(_LONGEST, _TURNS / starting_rate(loaded.scene))
    return Grid(span / _POINTS, _POINTS)


def _every(factor: float, dt: float, case: Case) -> list[Outcome]:
    return [
        _cell(method, judge(case, method, factor, dt=dt), factor=factor)
        for method in METHODS
        if method in case.applicable()
    ]


def _some(seed: int, case: Case) -> list[Outcome]:
    rng, cells = np.random.default_rng(seed), []
    for method in map(str, rng.choice(case.applicable(), _RUNS, replace=False)):
        factor = float(rng.choice(_FACTORS, p=_SHARES))
        tier = str(rng.choice(case.tiers(method)))
        cells.append(_cell(method, judge(case, method, factor, tier), factor, tier))
    return cells


def _cell(method: str, verdict: Verdict, factor: float = 0.0, tier: str = "auto") -> Outcome:
    facts = {"method": method, "factor": factor, "tier": tier}
    return {**facts, "kind": verdict.kind, "error": _short(verdict.error), "text": verdict.text}


def _short(value: float) -> float:
    """Three digits: what is beyond is rounding."""
    return float(f"{value:.3g}")
