"""Contact problems in this package and in others: error, creep and penetration by run time."""

import importlib
import math
from collections.abc import Sequence
from typing import Any

from mbd_ros.applications.report.contact import ours
from mbd_ros.applications.report.contact.problem import Problem, Trace, penetration
from mbd_ros.applications.report.contact.problems import problems
from mbd_ros.applications.report.contact.text import compose
from mbd_ros.applications.report.items import Item, Outcome, Section, Spec
from mbd_ros.applications.report.peers.contenders import USELESS, Contender, in_turn
from mbd_ros.applications.report.peers.kind import installed
from mbd_ros.applications.report.precision.rungs import Record

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
    facts = {"span": problem.times[-1], "unit": problem.unit, "asked": problem.asked}
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
