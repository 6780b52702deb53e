"""Other packages on the same scenes: ratios of CPU time at equal error, and their section."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from mbd_ros.applications.report.items import Item, Outcome, Section, Spec, Table
from mbd_ros.applications.report.peers.contenders import NATIVE, OURS, Contender, Ours, compete
from mbd_ros.applications.report.peers.translation import common_ground, task_of
from mbd_ros.applications.report.precision.converged import (
    COMPILED,
    Choice,
    compiles,
    motion_of,
    stabilizations,
)
from mbd_ros.applications.report.precision.text import (
    UNCHECKED,
    finished,
    points_of,
    power,
    repeatable,
    shown,
)
from mbd_ros.applications.report.precision.work_precision import Point, cost_at, diagram, front
from mbd_ros.applications.report.subjects import failures, is_own, subjects
from mbd_ros.errors import MbdError, SceneError
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene

_WANTED = (1.0e-3, 1.0e-6, 1.0e-8)
_WANTED_RATIOS = {  # scene, error -> how many times less CPU than the best peer is demanded
    ("arm7_swing", 1.0e-6): 3.0,
    ("arm7_swing", 1.0e-8): 6.0,
    ("arm7_swing_coupled", 1.0e-6): 5.0,
}
_NATIVE_RATIOS = {  # the same in native code
    ("arm7_swing", 1.0e-6): 20.0,
    ("arm7_swing", 1.0e-8): 50.0,
    ("arm7_swing_coupled", 1.0e-6): 30.0,
}
_MINE = OURS, NATIVE
_LOOSE = 3.0  # times more precise than asked
_FAINT = 0.1  # a ratio that needs more than one decimal
_INSTALL = {"mujoco": "mujoco", "pydrake": "drake", "exudyn": "exudyn"}
_TEXT = (
    "The same robots, initial states and samples in every package, all contenders in one "
    "process, in turn; `mbd_ros, compiled` is this one in native code. Times are CPU time of one "
    "thread for the integration alone, calls from Python included, best of the rounds. "
    "Costs at equal error are read from each package's own Pareto front over all its set-ups, "
    "between two runs by a power law. In the plots a line is such a front, and the other runs are "
    "dots. The reference is our converged motion, checked by a second method; the finest run of "
    "each peer is compared with it below, which on the free arm is a third check.",
    "A cost with ≤ is that of a package's cheapest run, which already is more than 3 times as "
    "precise as asked: what less precision would cost is not known, and the ratio is a bound, "
    "too. Errors grow with the span, which may be shorter here than in the section on one scene.",
)
PEERS = {
    "mujoco": "mbd_ros.applications.report.peers.mujoco_peer",
    "pydrake": "mbd_ros.applications.report.peers.drake_peer",
    "exudyn": "mbd_ros.applications.report.peers.exudyn_peer",
}
_SHOWN = {"mujoco": "MuJoCo", "pydrake": "Drake", "exudyn": "Exudyn"}
_SCENES = (
    "arm7_swing",
    "arm7_release",
    "arm7_swing_coupled",
    "x02_four_bar_1e-2",
    "a02_four_bars_2",
)
_QUICK = ("arm7_swing_coupled",)
_STEPS = (
    0.05,
    0.025,
    0.02,
    0.0125,
    0.01,
    8e-3,
    5e-3,
    2.5e-3,
    2e-3,
    1.6e-3,
    1.25e-3,
    1e-3,
    8e-4,
    5e-4,
    2.5e-4,
)  # s
_LARGEST = {"dop853": 0.05, "rk4": 0.01, "adams": 0.01}
_SMALLEST = {"dop853": 2e-3, "rk4": 5e-4, "adams": 2.5e-4}
_SECONDS, _SECONDS_QUICK = 40.0, 8.0
_SPAN = 1.0  # s


def items(scenes: Sequence[str], quick: bool) -> list[Item]:
    """One item a scene; none without peers."""
    names = installed()
    if not names:
        return []
    seconds, work_items = (_SECONDS_QUICK if quick else _SECONDS), []
    for subject in subjects(scenes, quick):
        if scenes or subject.name in (_QUICK if quick else _SCENES):
            spec = {
                "scene": subject.path,
                "times": [t for t in subject.times if t <= _SPAN],
                "peers": names,
                "quick": quick,
            }
            work_items.append(Item("peers", subject.name, spec, seconds, True))
    return work_items


def installed() -> list[str]:
    """Those of `PEERS` that can be imported."""
    return [name for name in PEERS if importlib.util.find_spec(name) is not None]


def run(spec: Spec) -> Outcome:
    """All contenders on one scene, in turn."""
    ground, times = common_ground(load_scene(spec["scene"])), tuple(spec["times"])
    missing = [name for name in spec["peers"] if name not in installed()]
    if missing:
        return {"failed": f"not installed on this worker: {', '.join(missing)}"}
    try:
        motion = motion_of(ground.scene, times)
    except MbdError as error:
        return {"failed": f"{type(error).__name__}: {error}"}
    contenders: list[Contender] = []
    facts: dict[str, Any] = {"left": list(ground.left), "refused": [], "setups": []}
    for name in spec["peers"]:
        module = importlib.import_module(PEERS[name])
        try:
            contenders += list(module.runs(task_of(ground, motion.states), spec["quick"]))
            facts["setups"].append(module.SETUP)
        except SceneError as error:
            facts["refused"].append(f"{_SHOWN[name]}: {error}")
    if contenders:
        contenders = [*_ours(ground.scene, spec["quick"]), *contenders]
    records = compete(ground.scene, contenders, motion, 2 if spec["quick"] else 3)
    agreement = motion.agreement if motion.check else None
    facts |= {"span": times[-1], "quick": spec["quick"], "own": is_own(spec["scene"])}
    return {"runs": records, "agreement": agreement, "check": motion.check, **facts}


def _ours(scene: Scene, quick: bool) -> Iterator[Ours]:
    for choice in _choices(scene, quick):
        yield Ours(scene, choice)
    if compiles(scene, {"type": "dop853"}):
        for choice in _native_choices(scene, quick):
            yield Ours(scene, choice)


def _choices(scene: Scene, quick: bool) -> Iterator[Choice]:
    """Choices that `precision` found on the front of such scenes."""
    least = 5e-4 if scene.has_loops else 0.0  # s; below it a loop takes seconds
    for stabilization in stabilizations(scene, "plain", "dop853")[: 1 if quick else 3 : 2]:
        for exponent in range(3, 13, 2 if quick else 1):
            entry = {"type": "dop853", "tolerance": float(f"1e-{exponent}")}
            yield Choice("plain", stabilization, entry, 1e-2)
        for kind, order in (("dop853", 0), ("rk4", 0), *(("adams", k) for k in (6, 7, 8))):
            for dt in _STEPS[:: 2 if quick else 1]:
                if max(_SMALLEST[kind], least) <= dt <= _LARGEST[kind]:
                    entry = {"type": kind} | ({"order": order} if order else {})
                    yield Choice("plain", stabilization, entry, dt)


def _native_choices(scene: Scene, quick: bool) -> Iterator[Choice]:
    """Choices for native code, where an evaluation costs little and a call from Python much."""
    for stabilization in stabilizations(scene, "plain", "dop853")[: 1 if quick else 3 : 2]:
        for kind in ("dop853",) if quick else ("dopri5", "dop853"):
            for exponent in range(2, 13, 2 if quick else 1):
                entry = {"type": kind, "tolerance": float(f"1e-{exponent}")}
                yield Choice(COMPILED, stabilization, entry, 5e-2)
        for order in () if quick else (4, 6, 8):
            for dt in _STEPS[4:]:
                yield Choice(COMPILED, stabilization, {"type": "adams", "order": order}, dt)


def section(outcomes: Sequence[tuple[Item, Outcome]]) -> Section:
    """Ratios first, then one plot a scene."""
    missing = [name for name in PEERS if name not in installed()]
    made = compose([(item.name, outcome) for item, outcome in outcomes], missing)
    return made._replace(wrong=[*failures(outcomes), *made.wrong])


def compose(outcomes: Sequence[tuple[str, Mapping[str, Any]]], missing: Sequence[str]) -> Section:
    """The section from outcomes by scene and the peers that are not installed."""
    text = [f"{name} is not installed: pip install {_INSTALL[name]}" for name in missing]
    compared, figures, demands, finest, wrong = {}, {}, [], [], []
    for name, outcome in outcomes:
        if "failed" in outcome:
            text.append(f"{name}: {outcome['failed']}")
            continue
        text += _not_told(name, outcome)
        if outcome["agreement"] is None:
            wrong.append(f"{name}: {UNCHECKED}")
            continue
        groups = groups_of(outcome)
        if not any(group.runs for package, group in groups.items() if package not in _MINE):
            text.append(f"{name}: no peer finished a run")
            continue
        text += [line for line in outcome["setups"] if line not in text]
        compared[name, outcome["span"]] = groups
        if outcome["own"] and not outcome["quick"]:  # that runs too short to be judged
            demands += _demands(name, groups)
        finest += _finest(name, outcome, groups)
        figures[f"peers_{name}"] = _figure(name, groups)
    if not compared:
        return Section("Other packages", ["No scene was compared.", *text], wrong=wrong)
    text = [*_TEXT, *text]
    text += repeatable([run for _, outcome in outcomes for run in outcome.get("runs", ())])
    tables = [costs(compared, _WANTED)]
    if demands:
        tables.append(
            Table("Demands", ("scene", "error", "ratio", "demanded", "verdict"), demands)
        )
    columns = ("scene", "package", "set-up", "position", "CPU ms per s")
    tables.append(Table("Finest runs", columns, finest))
    judged = [name for scene, _ in _WANTED_RATIOS if (name := f"peers_{scene}") in figures]
    headline = (tables[0].title, *(judged or list(figures))[:1])
    return Section("Other packages", text, tables, figures, wrong, headline=headline)


def _not_told(name: str, outcome: Mapping[str, Any]) -> list[str]:
    """Parts of scenes that the comparison leaves out, and packages that could not take part."""
    lines = [f"{name}: not compared with {reason}" for reason in outcome["refused"]]
    if outcome["left"] and outcome["setups"]:
        parts = ", ".join(outcome["left"])
        lines.append(
            f"{name} is compared without {parts}: no peer has these as they are here, so they are "
            "left out in every package."
        )
    return lines


def groups_of(outcome: Mapping[str, Any]) -> dict[str, Group]:
    """Finished runs by package."""
    done = finished(outcome["runs"])
    packages = dict.fromkeys(run["package"] for run in outcome["runs"])
    return {
        name: Group([run for run in done if run["package"] == name], outcome["agreement"])
        for name in packages
    }


class Group:
    """Finished runs of one package and their points."""

    def __init__(self, runs: Sequence[Mapping[str, Any]], agreement: float | None) -> None:
        self.runs, self.points = runs, points_of(runs, agreement)


def _demands(scene: str, groups: Mapping[str, Group]) -> list[Sequence[str]]:
    """The best peer against what is demanded of it; nothing where no peer is so precise."""
    rows = []
    for package, wanted in ((OURS, _WANTED_RATIOS), (NATIVE, _NATIVE_RATIOS)):
        for (name, error), demanded in wanted.items():
            if name != scene or package not in groups:
                continue
            best_ratio = _best_ratio(groups, package, error)
            if best_ratio is None:
                continue
            judged = "holds" if best_ratio >= demanded else "does not hold"
            shown_name = scene if package == OURS else f"{scene}, compiled"
            rows.append([shown_name, power(error), f"{best_ratio:.1f}", f"{demanded:g}", judged])
    return rows


def _best_ratio(groups: Mapping[str, Group], package: str, error: float) -> float | None:
    """Cost of the best peer over that of ours, 0 if ours is not so precise; None without peer."""
    found = [cost_at(group.points, error) for peer, group in groups.items() if peer not in _MINE]
    best = min((cost for cost in found if cost is not None), default=None)
    if best is None:
        return None
    mine = cost_at(groups[package].points, error)
    return 0.0 if mine is None else best / mine


def _finest(
    scene: str, outcome: Mapping[str, Any], groups: Mapping[str, Group]
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


def _figure(scene: str, groups: Mapping[str, Group]) -> Any:
    ours = groups[OURS]
    peers = {name: group.points for name, group in groups.items() if name != OURS and group.runs}
    return diagram(f"{scene}, mbd_ros and peers", ours.runs, ours.points, peers)


def costs(
    compared: Mapping[tuple[str, float], Mapping[str, Group]],
    errors: Sequence[float],
    title: str = "CPU per simulated second at equal error (x: times that of mbd_ros)",
) -> Table:
    """Rows of scenes and errors, columns of packages.

    Args:
        compared: Scene and span -> its runs by package.
        errors: Those at which costs are read.
        title: Of the table.
    """
    peers = dict.fromkeys(name for groups in compared.values() for name in groups if name != OURS)
    rows = []
    for (scene, span), groups in compared.items():
        for error in errors:
            cells = [_cost(groups[OURS], groups.get(peer), error) for peer in peers]
            ours = _priced(groups[OURS].points, error) or "not reached"
            rows.append([scene, f"{span:g} s", power(error), ours, *cells])
    return Table(title, ("scene", "span", "error", OURS, *peers), rows)


def _cost(ours: Group, theirs: Group | None, error: float) -> str:
    if theirs is None or not theirs.points:
        return "-"
    cost, factor = _priced(theirs.points, error), ratio(ours.points, theirs.points, error)
    if not cost:
        return f"reaches {shown(min(point.error for point in theirs.points))} only"
    loose = is_loose(ours.points, error), is_loose(theirs.points, error)
    if factor is None or all(loose):
        return cost
    sign = {(True, False): "≥ ", (False, True): "≤ "}.get(loose, "")
    return f"{cost}, {sign}{factor:.1f} x" if factor >= _FAINT else f"{cost}, {sign}{factor:.1g} x"


def _priced(points: Sequence[Point], error: float) -> str:
    """The cost of an error, marked where it is only known to be less; empty where none is."""
    cost = cost_at(points, error)
    return "" if cost is None else f"{'≤ ' * is_loose(points, error)}{cost:.3g} ms"


def is_loose(points: Sequence[Point], error: float) -> bool:
    """Whether the cheapest run is far more precise than asked."""
    best = front(points)
    return bool(best) and _LOOSE * points[best[0]].error < error


def ratio(ours: Sequence[Point], theirs: Sequence[Point], error: float) -> float | None:
    """How many times more CPU the others need; None where one of the two does not get there."""
    mine, other = cost_at(ours, error), cost_at(theirs, error)
    return None if mine is None or other is None else other / mine
