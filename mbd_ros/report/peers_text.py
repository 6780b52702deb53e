"""What the page says about other packages."""

from collections.abc import Mapping, Sequence
from typing import Any

from mbd_ros.report.items import Section, Table
from mbd_ros.report.pareto import Point, cost_at, front
from mbd_ros.report.precision_text import finished, points_of, shown
from mbd_ros.report.work_precision import diagram

OURS = "mbd_ros"
_WANTED = (1.0e-3, 1.0e-6, 1.0e-8)
_WANTED_RATIOS = {  # scene, error -> how many times less CPU than the best peer is demanded
    ("arm7_swing", 1.0e-6): 3.0,
    ("arm7_swing", 1.0e-8): 6.0,
    ("arm7_swing_coupled", 1.0e-6): 5.0,
}
_INSTALL = {"mujoco": "mujoco", "pydrake": "drake"}
_TEXT = (
    "The same robots, initial states and samples in every package, all contenders in one "
    "process, in turn; CPU time of one thread for the integration alone, best of the rounds. "
    "Costs at equal error are read from each package's own Pareto front over all its set-ups, "
    "between two runs by a power law. The reference is our converged motion, checked by a second "
    "method; the finest run of each peer is compared with it below, which on the free arm is a "
    "third check.",
)


def compose(outcomes: Sequence[tuple[str, Mapping[str, Any]]], missing: Sequence[str]) -> Section:
    """The section from outcomes by scene and the peers that are not installed."""
    text = list(_TEXT) if outcomes else ["No scene was compared."]
    for name in missing:
        text.append(f"{name} is not installed: pip install {_INSTALL[name]}")
    ratios: list[Sequence[str]] = []
    finest: list[Sequence[str]] = []
    figures = {}
    for name, outcome in outcomes:
        if "failed" in outcome:
            text.append(f"{name}: {outcome['failed']}")
            continue
        text += [line for line in outcome["setups"] if line not in text]
        groups = _groups(outcome)
        ratios += _ratios(name, groups, not outcome.get("quick"))
        finest += _finest(name, outcome, groups)
        figures[f"peers_{name}"] = _figure(name, outcome, groups[OURS])
    columns = ("scene", "error", "peer", "mbd_ros ms per s", "peer ms per s", "ratio", "demanded")
    tables = [
        Table("CPU time at equal error", columns, ratios),
        Table("Finest runs", ("scene", "package", "set-up", "position", "CPU ms per s"), finest),
    ]
    return Section("Other packages", text, tables, figures, headline=(tables[0].title,))


def ratio(ours: Sequence[Point], theirs: Sequence[Point], error: float) -> float | None:
    """How many times more CPU the others need; None where one of the two does not get there."""
    mine, other = cost_at(ours, error), cost_at(theirs, error)
    return None if mine is None or other is None else other / mine


class _Group:
    """Finished runs of one package and their points."""

    def __init__(self, runs: Sequence[Mapping[str, Any]], agreement: float | None) -> None:
        self.runs, self.points = runs, points_of(runs, agreement)


def _groups(outcome: Mapping[str, Any]) -> dict[str, _Group]:
    done = finished(outcome["runs"])
    packages = dict.fromkeys(run["package"] for run in outcome["runs"])
    return {
        name: _Group([run for run in done if run["package"] == name], outcome["agreement"])
        for name in packages
    }


def _ratios(scene: str, groups: Mapping[str, _Group], is_judged: bool) -> list[Sequence[str]]:
    """Rows of the table; a quick report runs too short to be judged."""
    rows = []
    for error in _WANTED:
        for peer in (name for name in groups if name != OURS):
            ours, theirs = groups[OURS].points, groups[peer].points
            mine, other = cost_at(ours, error), cost_at(theirs, error)
            found = ratio(ours, theirs, error)
            demanded = _WANTED_RATIOS.get((scene, error)) if is_judged else None
            judged = f"{demanded:g}" if demanded else "-"
            if demanded and found is not None:
                judged += ", holds" if found >= demanded else ", does not hold"
            best = min((point.error for point in theirs), default=None)
            rows.append(
                [
                    scene,
                    f"{error:g}",
                    peer,
                    "not reached" if mine is None else f"{mine:.3g}",
                    f"not reached, best {shown(best)}" if other is None else f"{other:.3g}",
                    "-" if found is None else f"{found:.1f}",
                    judged,
                ]
            )
    return rows


def _finest(
    scene: str, outcome: Mapping[str, Any], groups: Mapping[str, _Group]
) -> list[Sequence[str]]:
    check = f"reference: {outcome['check'] or 'no second method'}"
    rows: list[Sequence[str]] = [[scene, check, "agreement", shown(outcome["agreement"]), "-"]]
    for name, group in groups.items():
        best = min(group.runs, key=lambda run: run["configuration"], default=None)
        if best is not None:
            fineness = ", ".join(
                f"{key} {best[key]:g}" for key in ("dt", "accuracy") if key in best
            )
            setup, cost = f"{best['setup']}, {fineness}", 1e3 * best["seconds"]
            rows.append([scene, name, setup, shown(best["configuration"]), f"{cost:.3g}"])
    return rows


def _figure(scene: str, outcome: Mapping[str, Any], ours: _Group) -> Any:
    series: dict[str, list[Point]] = {}
    for run in finished(outcome["runs"]):
        if run["package"] != OURS:
            label = f"{run['package']} {run['setup']}"
            series.setdefault(label, []).extend(points_of([run], outcome["agreement"]))
    best = front(ours.points)
    return diagram(f"{scene}: peers dashed", ours.runs, ours.points, best, series)
