"""The section of the page about work and precision."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbd_ros.applications.report.items import Section, Table
from mbd_ros.applications.report.precision.converged import WANTED, Choice, of_record, snippet
from mbd_ros.applications.report.precision.work_precision import Point, cheapest, diagram, front

_TEXT = (
    "Every way to integrate a scene against its converged motion. The cheapest choice for an "
    "error is the cheapest run that was made and is as precise; its lines for a scene file stand "
    "below the scene. Formulation and stabilization are named where they are not those that the "
    "scene has by itself; what needs no stabilization is known to do without it over the compared "
    "time only. A dash: no run was that precise. Errors grow with the span of simulated time, "
    "which stands beside the scene. A motion that no second method computed again is an unchecked "
    "reference: no choice is offered for it.",
    "In the plots a line is the front of one integrator, all its orders together, as the scene "
    "has it by itself. Other runs are dots; on the Pareto front of all, symbols without a line.",
    "Position errors are in the measure of the published reference where there is one, otherwise "
    "the largest difference of a joint [rad or m] at the samples; energy in J; multipliers are "
    "those of the equations at the state that was reached, relative to the largest one. Time is "
    "CPU time of one thread per simulated second for the integration alone, without building, "
    "assembling and output: best of up to three runs, with the median above it as spread; "
    "long runs are made once.",
    "Every formulation meets every stabilization with rk4; the other integrators take one of the "
    "two as the scene has it by itself, and those ladders have every other rung. RATTLE, SHAKE "
    "and generalized-alpha keep the rows themselves. `compiled` is the scene as it is by itself "
    "in native code, where it can be compiled, without the time that takes. A ladder ends at "
    "rounding or where the next "
    "run would take too many evaluations; what was left out or stopped is in report.json.",
    "The converged motion is that of DOP853 at its smallest tolerance; a second method computes "
    "it again (agreement: the largest difference of the two), the published solution is a third, "
    "and where there are rows RATTLE, which never reads the drift of a constraint, must come "
    "nearer with every smaller step. Errors below the agreement count as the agreement.",
)
UNCHECKED = "unchecked reference"
_HEADLINE = "Cheapest choices, CPU per simulated second"
_COLUMNS = (
    "position",
    "CPU ms per s",
    "integrator",
    "step",
    "formulation",
    "stabilization",
    "spread",
    "velocity",
    "energy",
    "violation",
    "multipliers",
)


def compose(scenes: Mapping[str, Mapping[str, Any]]) -> Section:
    """The section from all runs by scene."""
    tables, figures, snippets, wrong = [_choices(scenes)], {}, {}, []
    for name, entry in scenes.items():
        known = entry.get("reference", {})
        wrong += [f"{name}: {line}" for line in known.get("wrong", ())]
        done = finished(entry["runs"])
        if not done:
            continue
        if not is_checked(entry) and entry.get("own"):
            wrong.append(f"{name}: {UNCHECKED}")
        points = points_of(done, known.get("agreement"))
        doubt = "" if is_checked(entry) else f", {UNCHECKED}"
        tables.append(_table(f"{name}: Pareto front{doubt}", done, points))
        title = f"{name}: {entry['times'][-1]:g} s{doubt}"
        figures[f"precision_{name}"] = diagram(title, done, points)
        if is_checked(entry):
            snippets |= _snippets(name, done, points)
    tables.append(_references(scenes))
    text = [*_TEXT, *repeatable([run for entry in scenes.values() for run in entry["runs"]])]
    return Section("Error against run time", text, tables, figures, wrong, snippets, (_HEADLINE,))


def is_checked(entry: Mapping[str, Any]) -> bool:
    """Whether a second method agrees with the motion against which runs are measured."""
    return entry.get("reference", {}).get("agreement") is not None


def finished(runs: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Those that have an error and a time."""
    return [run for run in runs if "seconds" in run]


def repeatable(runs: Sequence[Mapping[str, Any]]) -> list[str]:
    """How far times may be off, as a paragraph; none without runs."""
    spreads = [run["spread"] for run in finished(runs) if run["spread"] is not None]
    if not spreads:
        return []
    share = float(np.percentile(spreads, 99))
    return [
        f"Spread: of the {len(spreads)} runs that were made more than once, the repeats of 99 of "
        f"100 runs agree within {share:.0%}. As much may lie between "
        "the times of two reports on one machine; errors are the same to the last digit."
    ]


def points_of(runs: Sequence[Mapping[str, Any]], agreement: float | None) -> list[Point]:
    """Cost [ms per simulated s] and position error, not below what the reference is good for."""
    floor = max(agreement or 0.0, 1e-16)
    return [Point(1e3 * run["seconds"], max(run["position"], floor)) for run in runs]


def _choices(scenes: Mapping[str, Mapping[str, Any]]) -> Table:
    """The cheapest choice for an error, and its cost."""
    rows = []
    for name, entry in scenes.items():
        runs, span = finished(entry["runs"]), f"{entry['times'][-1]:g} s"
        if not runs and _failure(entry):
            rows.append([name, span, "stopped, see References", *[""] * (len(WANTED) - 1)])
            continue
        if not is_checked(entry):
            rows.append([name, span, f"{UNCHECKED}, see References", *[""] * (len(WANTED) - 1)])
            continue
        points = points_of(runs, entry.get("reference", {}).get("agreement"))
        best = [cheapest(points, error) for error in WANTED]
        rows.append([name, span, *("-" if i is None else _priced(runs[i]) for i in best)])
    return Table(_HEADLINE, ["scene", "span", *(f"error {power(e)}" for e in WANTED)], rows)


def _priced(run: Mapping[str, Any]) -> str:
    return f"{1e3 * run['seconds']:.3g} ms: {brief(of_record(run))}"


def brief(choice: Choice) -> str:
    """A choice without the defaults of its scene."""
    tolerance = choice.integrator.get("tolerance")
    kind = (choice.stabilization or {}).get("type", "projection")
    fineness = f"dt {choice.dt:g} s" if tolerance is None else f"tolerance {power(tolerance)}"
    words = [choice.method, fineness, *([] if choice.solver == "plain" else [choice.solver])]
    words += {"projection": [], "none": ["no stabilization"]}.get(kind, [kind])
    return ", ".join(words)


def _snippets(
    name: str, runs: Sequence[Mapping[str, Any]], points: Sequence[Point]
) -> dict[str, str]:
    """The cheapest choices as lines of a scene, those that are the same once."""
    errors: dict[str, list[str]] = {}
    for error in WANTED:
        best = cheapest(points, error)
        if best is not None:
            errors.setdefault(snippet(of_record(runs[best])), []).append(power(error))
    return {f"{name}, error {' and '.join(e)}": lines for lines, e in errors.items()}


def power(value: float) -> str:
    """A power of ten without leading zeros: 1e-6."""
    digits, _, exponent = f"{value:.0e}".partition("e")
    return f"{digits}e{int(exponent)}"


def _references(scenes: Mapping[str, Mapping[str, Any]]) -> Table:
    columns = ["scene", "reference", "second method", "agreement", "published", "drift check"]
    rows = [_reference(name, entry) for name, entry in scenes.items()]
    return Table("References", columns, rows)


def _reference(name: str, entry: Mapping[str, Any]) -> list[str]:
    if failed := _failure(entry):
        return [name, f"stopped: {failed}", "", "", "", ""]
    known = entry.get("reference", {})
    errors = [shown(known.get(key)) for key in ("agreement", "published")]
    drift_check = known.get("rattle") or "-"
    return [name, known.get("method", "-"), known.get("check") or "none", *errors, drift_check]


def _failure(entry: Mapping[str, Any]) -> str:
    return str(entry.get("reference", {}).get("failed") or entry.get("failed") or "")


def _table(title: str, runs: Sequence[Mapping[str, Any]], points: Sequence[Point]) -> Table:
    rows = [_row(runs[i]) for i in front(points)]
    return Table(title, _COLUMNS, rows)


def _row(run: Mapping[str, Any]) -> list[str]:
    choice = of_record(run)
    return [
        f"{run['position']:.2e}",
        f"{1e3 * run['seconds']:.3g}",
        choice.method,
        choice.fineness,
        choice.solver,
        (choice.stabilization or {}).get("type", "-"),
        "-" if run["spread"] is None else f"{100 * run['spread']:.0f} %",
        *(shown(run.get(key)) for key in ("velocity", "energy", "drift", "multipliers")),
    ]


def shown(value: float | None) -> str:
    """An error as text."""
    return "-" if value is None else f"{value:.1e}"
