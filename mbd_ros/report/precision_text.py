"""What the page says about work and precision."""

from collections.abc import Mapping, Sequence
from typing import Any

from mbd_ros.report.choices import of_record, snippet
from mbd_ros.report.items import Section, Table
from mbd_ros.report.pareto import Point, cheapest, cost_at, front
from mbd_ros.report.work_precision import diagram

WANTED = (1.0e-3, 1.0e-6, 1.0e-9)
_TEXT = (
    "Every way to integrate a scene against its converged motion. Position errors are in the "
    "measure of the published reference where there is one, otherwise the largest difference of "
    "a joint [rad or m] at the samples; energy in J; multipliers are those of the equations at "
    "the state that was reached, relative to the largest one. Time is CPU time of one thread per "
    "simulated second for the integration alone, without building, assembling and output: best "
    "of two or three runs, with the median above it as spread.",
    "Every formulation meets every stabilization with rk4; the other integrators take one of the "
    "two as the scene has it by itself, and those ladders have every other rung. RATTLE, SHAKE "
    "and generalized-alpha keep the rows themselves. A ladder ends at rounding or where the next "
    "run would take too many evaluations; what was left out or stopped is in report.json.",
    "The converged motion is that of DOP853 at its smallest tolerance; a second method computes "
    "it again (agreement: the largest difference of the two), the published solution is a third, "
    "and where there are rows RATTLE, which never reads the drift of a constraint, must come "
    "nearer with every smaller step. Errors below the agreement count as the agreement.",
)
_COLUMNS = (
    "position",
    "CPU ms per s",
    "spread",
    "formulation",
    "stabilization",
    "integrator",
    "step",
    "velocity",
    "energy",
    "drift",
    "multipliers",
)


def compose(scenes: Mapping[str, Mapping[str, Any]]) -> Section:
    """The section from all runs by scene."""
    tables, figures, snippets, wrong = [_summary(scenes)], {}, {}, []
    for name, entry in scenes.items():
        known = entry.get("reference", {})
        wrong += [f"{name}: {line}" for line in known.get("wrong", ())]
        done = finished(entry["runs"])
        if not done:
            continue
        points = points_of(done, known.get("agreement"))
        tables.append(_table(name, done, points))
        title = f"{name}: {entry['times'][-1]:g} s"
        figures[f"precision_{name}"] = diagram(title, done, points, front(points))
        for error in WANTED:
            best = cheapest(points, error)
            if best is not None:
                snippets[f"{name}, error {error:g}"] = snippet(of_record(done[best]))
    return Section(
        "Error against run time", _TEXT, tables, figures, wrong, snippets, ("Cheapest choices",)
    )


def finished(runs: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Those that have an error and a time."""
    return [run for run in runs if "seconds" in run]


def points_of(runs: Sequence[Mapping[str, Any]], agreement: float | None) -> list[Point]:
    """Cost [ms per simulated s] and position error, not below what the reference is good for."""
    floor = max(agreement or 0.0, 1e-16)
    return [Point(1e3 * run["seconds"], max(run["position"], floor)) for run in runs]


def _summary(scenes: Mapping[str, Mapping[str, Any]]) -> Table:
    columns = ["scene", "reference", "agreement", "published", "drift check"]
    columns += [f"ms per s at {error:g}" for error in WANTED]
    rows = [_summary_row(name, entry) for name, entry in scenes.items()]
    return Table("Cheapest choices", columns, rows)


def _summary_row(name: str, entry: Mapping[str, Any]) -> list[str]:
    known = entry.get("reference", {})
    failed = known.get("failed") or entry.get("failed")
    if failed:
        return [name, f"stopped: {failed}", *[""] * (3 + len(WANTED))]
    points = points_of(finished(entry["runs"]), known.get("agreement"))
    costs = [cost_at(points, error) for error in WANTED]
    method = f"{known.get('method', '')} / {known.get('check') or 'no second method'}"
    return [
        name,
        method,
        shown(known.get("agreement")),
        shown(known.get("published")),
        known.get("rattle", ""),
        *("-" if cost is None else f"{cost:.3g}" for cost in costs),
    ]


def _table(name: str, runs: Sequence[Mapping[str, Any]], points: Sequence[Point]) -> Table:
    rows = [_row(runs[i]) for i in front(points)]
    return Table(f"{name}: Pareto front", _COLUMNS, rows)


def _row(run: Mapping[str, Any]) -> list[str]:
    choice = of_record(run)
    return [
        f"{run['position']:.2e}",
        f"{1e3 * run['seconds']:.3g}",
        f"{100 * run['spread']:.0f} %",
        choice.solver,
        (choice.stabilization or {}).get("type", "-"),
        choice.method,
        choice.fineness,
        *(shown(run.get(key)) for key in ("velocity", "energy", "drift", "multipliers")),
    ]


def shown(value: float | None) -> str:
    """An error as text."""
    return "-" if value is None else f"{value:.1e}"
