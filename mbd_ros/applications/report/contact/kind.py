"""Contact problems in this package and in others: error, creep and penetration by run time."""

import importlib
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from mbd_ros.applications.report.contact import ours
from mbd_ros.applications.report.contact.problems import Problem, Trace, penetration, problems
from mbd_ros.applications.report.items import Item, Outcome, Section, Spec, Table
from mbd_ros.applications.report.peers.contenders import OURS, USELESS, Contender, in_turn
from mbd_ros.applications.report.peers.kind import Group, costs, groups_of, installed
from mbd_ros.applications.report.precision.converged import Record
from mbd_ros.applications.report.precision.text import finished, power, repeatable, shown
from mbd_ros.applications.report.precision.work_precision import diagram

# The section of the page about contact problems.

TITLE = "Contact"
_WANTED = (1e-3, 1e-6, 1e-9)
_CREEPS = (1e-3, 1e-6, 1e-9, 1e-11)  # m/s
_BOX, _FALL = "stuck_box", "dropped_box"
_PICTURES = ("bend", "sphere", "bounce")
_TEXT = (
    "Problems with closed forms, the same in every package: blocks on inclines that stick, slip, "
    "stop and slide back; a block that slides around a bend; spheres that slide until they roll; a"
    " ball that bounces with a restitution of 0.8; a stack with a mass ratio of 1e6 and a table of"
    " four legs, whose errors are those of forces, relative; a box of four contact points that "
    "should stand on an incline, whose error is its speed, and one that falls flat from 0.5 m, "
    "whose error is its penetration at rest.",
    "CPU time of one thread for the integration alone, best of two runs. Costs at equal error are "
    "read from each package's own Pareto front over all its set-ups. A cost with ≤ is that of the "
    "cheapest run, which already is more than 3 times as precise as asked.",
)


def compose(outcomes: Sequence[tuple[str, Mapping[str, Any]]]) -> Section:
    """The section from outcomes by problem."""
    text = [f"{name}: {o['failed']}" for name, o in outcomes if "failed" in o]
    done = {name: outcome for name, outcome in outcomes if "failed" not in outcome}
    if not done:
        return Section(TITLE, ["No contact problem was run.", *text])
    setups = dict.fromkeys(line for outcome in done.values() for line in outcome["setups"])
    groups = {name: groups_of(outcome) for name, outcome in done.items()}
    compared = {(name, done[name]["span"]): found for name, found in groups.items()}
    title = "Contact problems, CPU per simulated second at equal error (x: times that of mbd_ros)"
    tables = [costs(compared, _WANTED, title)]
    if _BOX in done:
        tables.append(_standing(done, groups[_BOX]))
    tables.append(_finest(done, groups))
    text += repeatable([run for outcome in done.values() for run in outcome["runs"]])
    figures = {f"contact_{n}": _figure(n, groups[n]) for n in _PICTURES if n in done}
    wrong = [line for name, outcome in done.items() for line in _wrong(name, outcome)]
    headline = [table.title for table in tables[:-1]]
    return Section(TITLE, [*_TEXT, *setups, *text], tables, figures, wrong, headline=headline)


def _wrong(name: str, outcome: Mapping[str, Any]) -> Iterator[str]:
    """Runs of this package that stopped, and errors that none of its runs reaches."""
    mine = [run for run in outcome["runs"] if run["package"] == OURS]
    for run in mine:
        if "stopped" in run:
            yield f"{name}, {run['setup']}, dt {run['dt']:g} s: {run['stopped']}"
    least = min((run["position"] for run in finished(mine)), default=None)
    if least is not None and least > outcome["demanded"] and not outcome["quick"]:
        yield f"{name}: reaches {shown(least)}, and {shown(outcome['demanded'])} is asked"


def _standing(done: Mapping[str, Mapping[str, Any]], groups: Mapping[str, Group]) -> Table:
    """The cheapest step of a standing box by creep, and how deep the same set-up rests."""
    falls = {_key(run): run for run in finished(done.get(_FALL, {}).get("runs", ()))}
    rows = []
    for creep in _CREEPS:
        for package, group in groups.items():
            good = [run for run in group.runs if run["position"] <= creep and "dt" in run]
            good = [run for run in good if "tolerance" not in str(run.get("integrator"))]
            best = min(good, key=lambda run: run["seconds"], default=None)
            if best is None:
                rows.append([power(creep), package, *("-",) * 6])
                continue
            fall = falls.get(_key(best), {}).get("position")
            step = f"{1e6 * best['seconds'] * best['dt']:.3g}"
            cells = [f"{best['dt']:g}", step, f"{1e3 * best['seconds']:.3g}"]
            depths = [shown(best["penetration"]), shown(fall)]
            rows.append([power(creep), package, best["setup"], *cells, *depths])
    columns = ("creep [m/s]", "package", "set-up", "dt [s]", "µs a step", "CPU ms per s")
    return Table("A box on four points", (*columns, "depth [m]", "after a fall [m]"), rows)


def _key(run: Mapping[str, Any]) -> tuple[str, str, float]:
    return run["package"], run["setup"], run["dt"]


def _finest(
    done: Mapping[str, Mapping[str, Any]], groups: Mapping[str, Mapping[str, Group]]
) -> Table:
    rows = []
    for name, found in groups.items():
        for package, group in found.items():
            best = min(group.runs, key=lambda run: run["position"], default=None)
            if best is None:
                rows.append([name, package, "-", "-", "-", "-"])
                continue
            fineness = f"{best['setup']}, dt {best['dt']:g} s"
            error = f"{shown(best['position'])} {done[name]['unit']}"
            cost = f"{1e3 * best['seconds']:.3g}"
            rows.append([name, package, fineness, error, shown(best["penetration"]), cost])
    columns = ("problem", "package", "set-up", "error", "depth [m]", "CPU ms per s")
    return Table("Finest runs of contact problems", columns, rows)


def _figure(name: str, groups: Mapping[str, Group]) -> Any:
    mine = groups[OURS]
    peers = {n: group.points for n, group in groups.items() if n != OURS and group.runs}
    return diagram(f"{name}, mbd_ros and peers", mine.runs, mine.points, peers)


KIND = "contact"
_PEERS = {
    "mujoco": "mbd_ros.applications.report.contact.mujoco_contacts",
    "pydrake": "mbd_ros.applications.report.contact.drake_contacts",
}
_SECONDS, _SECONDS_QUICK = 25.0, 8.0


def items(scenes: Sequence[str], quick: bool) -> list[Item]:
    """One item a problem; none for the scenes of a user, which have no closed form."""
    if scenes:
        return []
    seconds = _SECONDS_QUICK if quick else _SECONDS
    peers = [name for name in installed() if name in _PEERS]
    return [
        Item(KIND, p.name, {"problem": p.name, "peers": peers, "quick": quick}, seconds, True)
        for p in problems(quick)
    ]


def run(spec: Spec) -> Outcome:
    """All contenders on one problem, in turn."""
    problem = next(p for p in problems(quick=False) if p.name == spec["problem"])
    missing = [name for name in spec["peers"] if name not in installed()]
    if missing:
        return {"failed": f"not installed on this worker: {', '.join(missing)}"}
    contenders: list[Contender[Trace]] = list(ours.runs(problem, spec["quick"]))
    setups = [ours.SETUP]
    for name in spec["peers"]:
        module: Any = importlib.import_module(_PEERS[name])
        contenders += module.runs(problem, spec["quick"])
        setups.append(module.SETUP)

    def judge(trace: Trace) -> Record:
        return judged(problem, trace)

    records = in_turn(contenders, problem.times, judge, 2)
    facts = {"span": problem.times[-1], "unit": problem.unit, "demanded": problem.demanded}
    return {"runs": records, "setups": setups, "quick": spec["quick"], "agreement": 0.0, **facts}


def judged(problem: Problem, trace: Trace) -> Record:
    """Error and penetration of a run; `stopped` where they say nothing."""
    error, depth = problem.error(trace), penetration(problem, trace)
    if not error < USELESS or not math.isfinite(depth):
        return {"stopped": "far off"}
    return {"position": error, "configuration": error, "penetration": depth}


def section(outcomes: Sequence[tuple[Item, Outcome]]) -> Section:
    """Costs at equal error, the box at rest, and what did not reach what is asked."""
    return compose([(item.name, outcome) for item, outcome in outcomes])
