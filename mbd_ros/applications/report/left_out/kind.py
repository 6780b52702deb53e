"""Parts that a scene leaves out: imports, the cost of each part, and all of them together."""

import json
import subprocess
import sys
import time
import timeit
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pinocchio as pin

from mbd_ros.applications.report.items import Item, Outcome, Section, Spec, Table
from mbd_ros.applications.report.left_out.probe import LIBRARIES
from mbd_ros.applications.report.subjects import failures, subjects
from mbd_ros.core.dynamics.system import evaluation_at
from mbd_ros.core.dynamics.tiers import tier_of
from mbd_ros.errors import MbdError, ModelError
from mbd_ros.methods.projection.assembly import project
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.reading.part_entries import build_part
from mbd_ros.scene.runs.compiling import attempted, traced
from mbd_ros.scene.runs.simulation import build_simulation
from mbd_ros.scene.schema.code_permission import is_permitted

# Operations of the equations of a scene, and which of them its parts add.

_PARTS = {"operations_loads": ("forces", "actuators"), "operations_rows": ("constraints",)}


def operations(scene: Scene) -> Outcome:
    """Operations of one evaluation of the accelerations as they are compiled.

    Parts are counted by leaving them out: what a scene does not name adds none.

    Returns:
        `operations`, of them `operations_loads` and `operations_rows`; or `uncounted`, why not.
    """
    try:
        full_count = _count(scene, ())
    except MbdError as error:
        return {"uncounted": str(error)[:160]}
    counts: Outcome = {"operations": full_count}
    for key, sections in _PARTS.items():
        try:
            counts[key] = full_count - _count(scene, sections)
        except MbdError:  # others need these parts
            continue
    return counts


def _count(scene: Scene, without: Sequence[str]) -> int:
    """Values that accelerations without some sections take.

    Raises:
        MbdError: There are no such equations.
    """

    def take() -> int:
        rest = scene.without(without) if without else scene
        return int(traced(rest).function("accelerate").n_instructions())

    return attempted(take)


_PROBE = "mbd_ros.applications.report.left_out.probe"
_FAR = 1.0e6  # [rad or m]: a stop that nothing reaches
_SECONDS = 4.0
_TEXT = (
    "What each scene builds and imports in a fresh process, and what one evaluation of its "
    "equations costs. 'Everything on' is the same scene with all rows through the QP tier, a stop "
    "at every joint that is never reached, and a projection after every step; both columns are "
    "microseconds of CPU for one step of semi-implicit Euler, that is one evaluation.",
    "The parts add up to less than a step where the tier has more to do than they: mass matrix, "
    "factorisation and the loop of the simulation. A dash stands for a part that is not there.",
    "Operations are those of one evaluation in straight-line code, additions to sines, and those "
    "that go away with all loads or all constraints: what a scene does not name adds none. A dash "
    "stands there for a scene that cannot be traced; report.json says why.",
)
_COLUMNS = (
    "scene",
    "formulation",
    "parts imported",
    "parts left out",
    "libraries left out",
    "bare aba",
    "evaluation",
    "loads",
    "rows",
    "projection",
    "step",
    "everything on",
    "factor",
    "operations",
    "of loads",
    "of rows",
)
_SHORT = 1.0e-9  # s: so short that the motion stays where it is


def items(scenes: Sequence[str], quick: bool) -> list[Item]:
    """One item a scene."""
    return [
        Item(
            "left_out", s.name.replace(".", "_"), {"scene": s.path, "quick": quick}, _SECONDS, True
        )
        for s in subjects(scenes, quick)
    ]


def run(spec: Spec) -> Outcome:
    """Imports and costs of one scene."""
    path, calls = spec["scene"], 100 if spec["quick"] else 400
    words = [path, "--allow-code"] if is_permitted() else [path]
    probe = subprocess.run(
        [sys.executable, "-m", _PROBE, *words], capture_output=True, text=True, check=False
    )
    if probe.returncode:
        return {"failed": probe.stderr.strip().splitlines()[-1][:200]}
    try:
        outcome: Outcome = {**json.loads(probe.stdout.splitlines()[-1]), **costs(path, calls)}
        outcome |= operations(load_scene(path))
    except MbdError as error:
        return {"failed": f"{type(error).__name__}: {error}"}
    return outcome


def section(outcomes: Sequence[tuple[Item, Outcome]]) -> Section:
    """One table."""
    rows = [_row(item.name, outcome) for item, outcome in outcomes]
    table = Table("What a scene pays for, microseconds", _COLUMNS, rows)
    return Section("What was left out", _TEXT, [table], wrong=failures(outcomes))


def costs(path: str, calls: int) -> Mapping[str, object]:
    """CPU time of the parts of a scene [us].

    Args:
        calls: Timed calls of each, five times over.
    """
    scene = load_scene(path)
    simulation = build_simulation(scene)
    system, y = simulation.system, simulation.start(scene.initial)
    x = system.expand(y)
    model, data, zero = system.model, system.model.createData(), np.zeros(system.model.nv)
    seconds: dict[str, object] = {"formulation": tier_of(system)}
    seconds["aba"] = _best(lambda: pin.aba(model, data, x.q, x.v, zero), calls)
    seconds["evaluation"] = _best(evaluation_at(system, y), calls)
    if not system.loads.is_empty:
        system.k.refresh(x.q, x.v)
        seconds["loads"] = _best(lambda: system.loads.total(system.k, x, None), calls)
    if system.rows:
        system.k.refresh(x.q, x.v)
        seconds["rows"] = _best(lambda: system.constraints.accelerations(system.k, x), calls)
        seconds["projection"] = _best(lambda: project(system, y), calls)
    seconds["step"] = _step(scene, {}, calls)
    try:
        seconds["everything"] = _step(_with_stops(scene), {"solver": {"type": "qp"}}, calls)
    except MbdError as error:
        seconds["refused"] = str(error)[:120]
    return seconds


def _step(scene: Scene, more: Mapping[str, Mapping[str, str]], calls: int) -> float:
    """One step as the scene corrects it [us]."""
    stabilization = {"type": "projection"} if more or scene.system().rows else None
    simulation = build_simulation(
        scene,
        integrator={"type": "semi_implicit_euler"},
        dt=_SHORT,
        stabilization=stabilization,
        **more,
    )
    y = simulation.start(scene.initial)

    def step() -> None:
        nonlocal y
        y = simulation.advance(y, None, y.t + _SHORT)

    return _best(step, calls)


def _with_stops(scene: Scene) -> Scene:
    """The scene with an idle stop at every joint that has one position."""
    stop = {"type": "joint_stop", "joints": ["all"], "lower": -_FAR, "upper": _FAR}
    try:
        part = build_part("constraints", stop, f"{scene.name}: stops", scene.robot)
    except ModelError:
        return scene
    return scene.holding(constraints=(*scene.parts.get("constraints", ()), part))


def _best(call: Callable[[], object], calls: int) -> float:
    timer = timeit.Timer(call, timer=time.process_time)
    return min(timer.repeat(5, calls)) / calls * 1e6


def _row(name: str, outcome: Outcome) -> list[str]:
    if "failed" in outcome:
        return [name, outcome["failed"], *[""] * (len(_COLUMNS) - 2)]
    unused = [library for library in LIBRARIES if library not in outcome["libraries"]]
    keys = ("aba", "evaluation", "loads", "rows", "projection", "step", "everything")
    times = [f"{outcome[key]:.1f}" if key in outcome else "-" for key in keys]
    factor = outcome["everything"] / outcome["step"] if "everything" in outcome else None
    return [
        name,
        outcome["formulation"],
        ", ".join(part.split(".")[-1] for part in outcome["parts"]) or "none",
        str(outcome["not_imported"]),
        ", ".join(unused),
        *times,
        outcome.get("refused", "-") if factor is None else f"{factor:.1f}",
        *(str(outcome.get(f"operations{of}", "-")) for of in ("", "_loads", "_rows")),
    ]
