"""Stability: extreme scenes, and thousands of random ones, under every method."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.applications.report.items import Item, Outcome, Section, Spec
from mbd_ros.applications.report.stability.contact import (
    ContactRow,
    contact_methods,
    contact_rows,
    judge_contact,
)
from mbd_ros.applications.report.stability.page import stability_section
from mbd_ros.applications.report.stability.reference_motion import (
    FINE,
    LEAST_RATE,
    Grid,
    Known,
    first,
    starting_rate,
)
from mbd_ros.applications.report.stability.scene_text import (
    LoadedScene,
    SceneText,
    load,
    load_file,
)
from mbd_ros.applications.report.stability.scenes import Extreme, extremes, item_name, random_scene
from mbd_ros.applications.report.stability.verdicts import (
    CLOSED,
    CONVERGED,
    EQUATIONS,
    STOPPED,
    WRONG,
    Case,
    Verdict,
    applicable,
    asked_step,
    chooses_steps,
    is_named,
    judge,
    longest_step,
    raised,
    room,
    step_on,
    tiers,
)
from mbd_ros.core.state import State
from mbd_ros.methods.projection.assembly import assemble
from mbd_ros.scene.built_scene import Scene

# Whether a scene obeys mechanics along its reference motion, of any origin.

_BALANCED = 1.0e-5  # of the energies that change hands
_FINER = 8
_QUADRATURE = 10.0  # how many times its estimate an error of the work may be
_STATES = 3


def equations(case: Case, tiers: list[str], stops: str | None = None) -> Verdict:
    """Equations of motion, rows and energy along the reference motion, in some tiers.

    Args:
        stops: As that of `unexpected`.
    """
    verdict = _equations(case, tiers)
    reason = case.reference.reason
    if verdict.kind == CONVERGED and reason:
        verdict = Verdict(STOPPED, math.inf, f"the reference stops: {reason}")
    if verdict.kind == STOPPED and not is_named(case, verdict.text):
        return Verdict(WRONG, math.inf, f"stopped without saying where: {verdict.text}")
    return unexpected(verdict, stops)


def unexpected(verdict: Verdict, stops: str | None) -> Verdict:
    """Judge a stop: wrong in a scene of this package that must not stop.

    Args:
        stops: Text of the expected stop, empty if none is; None for a scene of a user.
    """
    if verdict.kind != STOPPED or stops is None or (stops and stops in verdict.text):
        return verdict
    return Verdict(WRONG, verdict.error, f"must not stop: {verdict.text}")


def _equations(case: Case, tiers: list[str]) -> Verdict:
    try:
        for x in case.reference.states:
            if not case.oracle.violation(x) <= CLOSED * (1.0 + float(np.abs(x.q).max())):
                open_by = case.oracle.violation(x)
                return Verdict(WRONG, math.inf, f"constraints {open_by:.3g} open at {x.t:.6g} s")
        for tier in tiers:
            found = _complaints(case, tier)
            if found:
                return Verdict(WRONG, math.inf, f"tier {tier}: {'; '.join(found)}")
        if not _is_finite_beyond(case):
            t = case.reference.fine[-1].t
            return Verdict(WRONG, math.inf, f"accelerations beyond t = {t:.6g} s are not finite")
        lost, allowed = imbalance(case)
        if not lost <= allowed:  # a stop or friction may begin between two points
            lost, allowed = imbalance(case, _FINER)
    except Exception as error:  # noqa: BLE001 - every exception is a verdict
        return raised(error)
    if not lost <= allowed:
        text = f"energy changes by {lost:.3g} J more than work explains, {allowed:.2g} J allowed"
        return Verdict(WRONG, math.inf, text)
    return Verdict(CONVERGED, lost / case.swing)


def _complaints(case: Case, tier: str) -> list[str]:
    states = case.reference.states
    system = case.scene.system(solver={"type": tier})
    for x in states[:: max(1, len(states) // _STATES)]:
        found = case.oracle.complaints(system, assemble(system, system.reduce(x)))
        if found:
            return found
    return []


def _is_finite_beyond(case: Case) -> bool:
    """Whether there are accelerations where the reference would go next."""
    x, ahead = case.reference.fine[-1], case.reference.grid.interval
    q = pin.integrate(case.scene.robot.model, x.q, ahead * x.v)
    system = case.scene.system()
    a = system.evaluate(State(x.t + ahead, q, x.v)).a
    return bool(np.isfinite(a).all())


def imbalance(case: Case, finer: int = 1) -> tuple[float, float]:
    """Change of energy without its reason [J], and how much the quadrature may err [J].

    Args:
        finer: How many times as many points as those of the reference.
    """
    grid, fine = case.reference.grid, case.reference.fine
    if finer > 1:
        fine = first(
            case.scene, Grid(grid.interval / FINE / finer, FINE * finer * grid.count)
        ).states
    count = (len(fine) - 1) // 4 * 4
    if count == 0:
        return 0.0, 0.0
    system, step = case.scene.system(), grid.interval / FINE / finer
    power = [case.oracle.power(system, system.reduce(x)) for x in fine[: count + 1]]
    work, rough = _simpson(power, step), _simpson(power[::2], 2.0 * step)
    before, after = (sum(case.oracle.energy(x)) for x in (fine[0], fine[count]))
    size = case.swing + step * float(np.abs(power).sum())
    return abs(after - before - work), _BALANCED * size + _QUADRATURE * abs(work - rough)


def _simpson(values: list[float], step: float) -> float:
    """Integral over an even number of intervals."""
    inner = 4.0 * sum(values[1:-1:2]) + 2.0 * sum(values[2:-1:2])
    return step / 3.0 * (values[0] + inner + values[-1])


# The methods, tiers and steps of the runs of a scene, and the times of the comparison.

_RUNS = 3  # methods that each random scene meets
_FACTORS, _SHARES = (0.1, 0.5, 2.0, 10.0), (0.65, 0.2, 0.1, 0.05)
_TURNS, _LONGEST, _POINTS = 12.0, 0.12, 12  # span: in 1 / rate, and at most [s]; intervals


class Run(NamedTuple):
    """Method, tier and step of a run.

    Attributes:
        method: Key of `METHODS`.
        factor: Step in multiples of the longest one that `check` does not warn of.
        dt: Step instead of the factor [s], if > 0.
    """

    method: str
    factor: float
    tier: str
    dt: float


def usual_grid(loaded: LoadedScene) -> Grid:
    """Some turns of the fastest motion at the start."""
    span = min(_LONGEST, _TURNS / starting_rate(loaded.scene))
    return Grid(span / _POINTS, _POINTS)


def every_method(factor: float, dt: float, repeats: bool, scene: Scene) -> list[Run]:
    """A run a method.

    Args:
        factor: Step in multiples of the recommended one.
        dt: Step instead of the factor [s], if > 0.
        repeats: Whether other rows have the runs of methods that choose their steps.
    """
    return [
        Run(method, factor, "plain", dt)
        for method in applicable(scene)
        if not (repeats and chooses_steps(method))
    ]


def some_methods(seed: int, scene: Scene) -> list[Run]:
    """Runs with methods and tiers that a seed chooses, and one multiple of the recommended step.

    All take one multiple: a long step makes a long motion, for which short steps take long.
    """
    rng, runs = np.random.default_rng(seed), []
    factor = float(rng.choice(_FACTORS, p=_SHARES))
    for method in map(str, rng.choice(applicable(scene), _RUNS, replace=False)):
        runs.append(Run(method, factor, str(rng.choice(tiers(scene, method))), 0.0))
    return runs


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
    for start in range(0, count, batch):
        spec = {"first": start, "count": batch}
        rows.append(Item(KIND, f"random-{start:04d}", spec, _SECONDS * batch))
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
    return {**found, **_conserved(text)} if is_wrong(found) else found


def is_wrong(row: Mapping[str, Any]) -> bool:
    """Whether any of the cells of a row is."""
    return any(cell["kind"] == WRONG for cell in row["cells"])


def _conserved(text: SceneText) -> Outcome:
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
