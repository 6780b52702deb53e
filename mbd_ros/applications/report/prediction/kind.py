"""Error of the least cost against run time, of `mbd-ros predict` at every tolerance."""

import gc
import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mbd_ros.applications.report.items import Item, Outcome, Section, Spec, Table
from mbd_ros.applications.report.precision.text import shown
from mbd_ros.errors import MbdError
from mbd_ros.features.prediction.job import predict
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.from_python import scene_from
from mbd_ros.scene.reader import load_scene

# Optimal motions whose least costs are known.

_SLIDE = (
    "<robot name='mass'><link name='ground'/><link name='mass'><inertial><mass value='1'/>"
    "<inertia ixx='1' ixy='0' ixz='0' iyy='1' iyz='0' izz='1'/></inertial></link>"
    "<joint name='slide' type='prismatic'><parent link='ground'/><child link='mass'/>"
    "<axis xyz='1 0 0'/><limit lower='-10' upper='10' effort='1000' velocity='1000'/></joint>"
    "</robot>"
)


class Problem(NamedTuple):
    """A task with its least cost.

    Attributes:
        make: Builds the scene.
        task: Of `Scene.predict`, without mesh and tolerance.
        cost: The least one, in the unit of the goals.
        source: Where that is from.
    """

    make: Callable[[], Scene]
    task: Mapping[str, Any]
    cost: float
    source: str


def _mass() -> Scene:
    sections = {
        "robot": {"gravity": [0.0, 0.0, 0.0]},
        "actuators": [{"type": "ideal", "joints": ["slide"]}],
    }
    return scene_from(sections, urdf=_SLIDE)


def _cart_pole() -> Scene:
    return load_scene("package://mbd_ros/config/scenes/cart_pole.yaml")


_EFFORT = {"type": "effort"}
PROBLEMS: Mapping[str, Problem] = {
    "cart_pole": Problem(
        _cart_pole,
        {
            "duration": 2.0,
            "end": {"cart.position": 1.0, "pole.position": math.pi, "*.velocity": 0.0},
            "goals": [_EFFORT],
        },
        58.80766745817,
        "M. Kelly, SIAM Review 59, 2017, solved by multiple shooting of Pontryagin's equations",
    ),
    "bryson_denham": Problem(
        _mass,
        {
            "duration": 1.0,
            "start": {"slide.velocity": 1.0},
            "end": {"slide.position": 0.0, "slide.velocity": -1.0},
            "bounds": {"slide.position": [None, 1.0 / 9.0]},
            "goals": [{**_EFFORT, "weight": 0.5}],
        },
        4.0,
        "A. E. Bryson, Y.-C. Ho, Applied Optimal Control, 1975, sec. 3.11, closed form",
    ),
}


KIND, TITLE = "prediction", "Prediction"
_TOLERANCES: Mapping[str, Sequence[float]] = {  # of the error between nodes
    "gauss": (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8),
    "radau": (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8),
    "hermite_simpson": (1e-2, 1e-3, 1e-4, 1e-5),
}
_QUICK = (1e-3,)
_SECONDS, _SECONDS_QUICK = 3.0, 1.0
_DEFAULT = 1e-7
_ASKED = 1e-5  # relative error of the least cost at the default tolerance
_LOOKS = {
    "gauss": ("#0072B2", "o"),
    "radau": ("#009E73", "s"),
    "hermite_simpson": ("#E69F00", "^"),
}
_LEAST = 1e-16  # shown instead of zero
_TEXT = (
    "Motions of least effort whose costs are known: the swing-up of a cart-pole, and a mass that "
    "returns before a wall (Bryson and Denham), along which a bound acts. Each scheme starts from "
    "its default mesh, which the tolerance of the error between nodes refines. The error is that "
    "of the least cost, relative. Time is CPU time of one thread with building, solving, tables "
    "and the replay of the motion that checks it, best of two runs. Replay: how far integration "
    "with the found inputs ends from the motion.",
)
_COLUMNS = ("problem", "scheme", "tolerance", "error of the cost", "error between nodes", "replay")


def items(scenes: Sequence[str], quick: bool) -> list[Item]:
    """One item a problem and scheme; none for the scenes of a user, whose costs nobody knows."""
    if scenes:
        return []
    seconds = _SECONDS_QUICK if quick else _SECONDS
    return [
        Item(
            KIND,
            f"{name}.{scheme}",
            {"problem": name, "scheme": scheme, "tolerances": list(_QUICK if quick else chosen)},
            seconds,
            True,
        )
        for name in PROBLEMS
        for scheme, chosen in _TOLERANCES.items()
    ]


def run(spec: Spec) -> Outcome:
    """One scheme on one problem, from coarse to fine."""
    problem = PROBLEMS[spec["problem"]]
    predict(problem.make(), _task(spec, 1e-1))  # what is loaded at the first use
    return {"runs": [_timed(spec, tolerance) for tolerance in spec["tolerances"]]}


def section(outcomes: Sequence[tuple[Item, Outcome]]) -> Section:
    """A table, and a picture a problem."""
    if not outcomes:
        return Section(TITLE, ["Predictions are made of our own problems only."])
    rows, wrong = [], []
    for item, outcome in outcomes:
        name, scheme = item.spec["problem"], item.spec["scheme"]
        for entry in outcome["runs"]:
            if "stopped" in entry:
                wrong.append(f"{name}, {scheme}, {entry['tolerance']:g}: {entry['stopped']}")
                continue
            numbers = [shown(entry[key]) for key in ("off", "stated", "replay")]
            cost = f"{1e3 * entry['seconds']:.3g}"
            rows.append([name, scheme, f"{entry['tolerance']:.0e}", *numbers, cost])
            if entry["tolerance"] <= _DEFAULT and not entry["off"] <= _ASKED:
                wrong.append(f"{name}, {scheme}: the cost is {entry['off']:.1e} off")
    found = {f"prediction_{name}": _figure(name, outcomes) for name in PROBLEMS}
    table = Table("Error of the least cost", (*_COLUMNS, "CPU ms"), rows)
    sources = [f"{name}: {problem.source}." for name, problem in PROBLEMS.items()]
    return Section(TITLE, [*_TEXT, *sources], [table], found, wrong)


def _task(spec: Spec, tolerance: float) -> dict[str, Any]:
    task = dict(PROBLEMS[spec["problem"]].task)
    return task | {"mesh": {"scheme": spec["scheme"]}, "tolerance": tolerance}


def _timed(spec: Spec, tolerance: float) -> dict[str, Any]:
    problem, seconds = PROBLEMS[spec["problem"]], list[float]()
    try:
        for _ in range(2):
            gc.collect()
            begin = time.process_time()
            plan = predict(problem.make(), _task(spec, tolerance)).metadata
            seconds.append(time.process_time() - begin)
    except MbdError as stop:
        return {"tolerance": tolerance, "stopped": f"{type(stop).__name__}: {stop}"[:160]}
    off = abs(float(plan["cost"]) / problem.cost - 1.0)
    checked = {"stated": float(plan["error"]), "replay": float(plan["replay"])}
    return {"tolerance": tolerance, "off": off, **checked, "seconds": min(seconds)}


def _figure(name: str, outcomes: Sequence[tuple[Item, Outcome]]) -> Figure:
    """Error of the cost over CPU time, a line a scheme."""
    figure = Figure(figsize=(6.2, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for item, outcome in outcomes:
        if item.spec["problem"] != name:
            continue
        done = [entry for entry in outcome["runs"] if "off" in entry]
        color, marker = _LOOKS[item.spec["scheme"]]
        axes.plot(
            [1e3 * entry["seconds"] for entry in done],
            [max(entry["off"], _LEAST) for entry in done],
            color=color,
            marker=marker,
            label=item.spec["scheme"],
        )
    axes.set_yscale("log")
    axes.set_xlabel("CPU ms")
    axes.set_ylabel("error of the least cost, relative")
    axes.set_title(name, parse_math=False)
    axes.grid(alpha=0.4)
    if axes.lines:
        axes.legend(frameon=False)
    return figure
