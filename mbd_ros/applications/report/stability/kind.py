"""Stability: extreme scenes, and thousands of random ones, under every method."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.applications.report.items import Item, Outcome, Section, Spec
from mbd_ros.applications.report.stability.cases import (
    EQUATIONS,
    WRONG,
    Case,
    Verdict,
    chooses_steps,
    longest_step,
    raised,
    tiers,
)
from mbd_ros.applications.report.stability.contact_rows import ContactRow, contact_rows
from mbd_ros.applications.report.stability.contact_verdicts import contact_methods, judge_contact
from mbd_ros.applications.report.stability.equations import equations, unexpected
from mbd_ros.applications.report.stability.extreme_scenes import Extreme, extremes, item_name
from mbd_ros.applications.report.stability.motion import Grid
from mbd_ros.applications.report.stability.other_formulations import Known
from mbd_ros.applications.report.stability.page import stability_section
from mbd_ros.applications.report.stability.random_scenes import random_scene
from mbd_ros.applications.report.stability.reference_motion import LEAST_RATE, starting_rate
from mbd_ros.applications.report.stability.runs import Run, every_method, some_methods, usual_grid
from mbd_ros.applications.report.stability.scene_text import (
    LoadedScene,
    SceneText,
    load,
    load_file,
)
from mbd_ros.applications.report.stability.steps import asked_step, room
from mbd_ros.applications.report.stability.verdicts import judge, step_on
from mbd_ros.scene.built_scene import Scene

KIND = "stability"
SCENES, BATCH, QUICK = 2000, 100, 30
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
    rows += [
        Item(KIND, row.name, {"contact": row.name}, row.seconds) for row in contact_rows(quick)
    ]
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
        if "contact" in spec:
            found = next(row for row in contact_rows(quick=False) if row.name == spec["contact"])
            return contact_row(found)
        row = next(row for row in extremes(quick=False) if row.name == spec["row"])
        return extreme_row(row)


def section(outcomes: Sequence[tuple[Item, Outcome]]) -> Section:
    """Counts, reasons, the map, and what is wrong."""
    return stability_section(outcomes)


def extreme_row(row: Extreme) -> Outcome:
    """One scene under every method that takes it."""
    facts = {"family": row.family, "label": row.label, "factor": row.factor, "dt": row.dt}
    plan = partial(every_method, row.factor, row.dt, row.repeats)
    return {**facts, **_row(row.load, row.grid, plan, row.stops, row.known)}


def contact_row(row: ContactRow) -> Outcome:
    """One contact problem under every method that takes it."""
    cells = [
        _cell(method, judge_contact(row.problem, method, row.dt), dt=row.dt)
        for method in contact_methods(row.problem)
    ]
    return {"family": row.family, "label": row.label, "factor": 0.0, "dt": row.dt, "cells": cells}


def user_row(name: str, factor: float) -> Outcome:
    """The same for a scene of a user."""
    facts = {"family": Path(name).stem, "label": f"{factor:g} x recommended", "factor": factor}
    plan = partial(every_method, factor, 0.0, factor != 1.0)
    return {**facts, "dt": 0.0, **_row(partial(load_file, name), None, plan, None)}


def random_row(seed: int) -> Outcome:
    """One random scene under a few methods and tiers, at a step that its seed chooses."""
    text = random_scene(seed)
    found = {"seed": seed, **_row(partial(load, text), None, partial(some_methods, seed), "")}
    return {**found, **_kept(text)} if is_wrong(found) else found


def is_wrong(row: Mapping[str, Any]) -> bool:
    """Whether any of the cells of a row is."""
    return any(cell["kind"] == WRONG for cell in row["cells"])


def _kept(text: SceneText) -> Outcome:
    return {"scene": text.scene, "urdf": text.urdf}


def _row(
    read: Callable[[], LoadedScene],
    grid: Grid | None,
    plan: Callable[[Scene], list[Run]],
    stops: str | None,
    known: Known | None = None,
) -> Outcome:
    """The row of a scene: how far its motion is known, and its cells.

    Args:
        read: Reads the scene.
        grid: Times of the comparison; None for the usual ones.
        plan: The runs of a scene.
        stops: Text of the expected stop of a scene of this package, empty if it must not stop;
            None for a scene of a user, which may stop.
        known: Gives the motion by other equations than those of the scene.
    """
    try:
        loaded = read()
        rate = starting_rate(loaded.scene)
        if not math.isfinite(rate):
            verdict = Verdict(WRONG, math.inf, "accelerations at the start are not finite")
            return {"cells": [_cell(EQUATIONS, verdict)]}
        runs = plan(loaded.scene)
        steps = [asked_step(r.method, rate, r.factor, r.dt) for r in runs if rate > LEAST_RATE]
        longest = max(steps, default=0.0)
        case = Case(loaded, room(grid or usual_grid(loaded), longest), known)
    except Exception as error:  # noqa: BLE001 - every exception is a verdict
        return {"cells": [_cell(EQUATIONS, unexpected(raised(error), stops))]}
    known = case.reference
    verdict = equations(case, tiers(loaded.scene, "rk4"), stops)
    return {
        "known_until": known.grid.interval * max(0, known.horizon - 1),
        "span": known.grid.span,
        "uncertain": _short(known.uncertain),
        "growth": _short(known.growth),
        "second": known.second,
        "rates": [_short(rate) for rate in known.rates],
        "cells": [_cell(EQUATIONS, verdict), *(_judged(case, run) for run in runs)],
    }


def _judged(case: Case, run: Run) -> Outcome:
    """The cell of a run."""
    verdict = judge(case, run.method, run.factor, run.tier, run.dt)
    if chooses_steps(run.method):
        return _cell(run.method, verdict, tier=run.tier)
    dt, rate = step_on(case, run.method, run.factor, run.dt), case.reference.rates[0]
    if rate <= LEAST_RATE:
        return _cell(run.method, verdict, tier=run.tier, dt=_short(dt))
    ran = dt / longest_step(run.method, rate)
    return _cell(run.method, verdict, run.factor, run.tier, _short(ran), _short(dt))


def _cell(
    method: str,
    verdict: Verdict,
    factor: float = 0.0,
    tier: str = "plain",
    ran: float = 0.0,
    dt: float = 0.0,
) -> Outcome:
    """The stored cell: `factor` is the demand, `ran` and `dt` are those of the run."""
    facts = {"method": method, "factor": factor, "ran": ran, "dt": dt, "tier": tier}
    return {**facts, "kind": verdict.kind, "error": _short(verdict.error), "text": verdict.text}


def _short(value: float) -> float:
    """Three digits: all others are rounding."""
    return float(f"{value:.3g}")
