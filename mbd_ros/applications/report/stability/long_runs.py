"""Long runs: energy and constraints over a million steps."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.applications.report.items import Item, Outcome, Section, Spec, Table
from mbd_ros.applications.report.stability.oracle import Oracle
from mbd_ros.applications.report.stability.page import long_run_plot
from mbd_ros.applications.report.stability.reference_motion import starting_rate
from mbd_ros.applications.report.stability.scene_text import LoadedScene, joint
from mbd_ros.applications.report.stability.scenes import mechanism, rod, rods
from mbd_ros.core.state import State
from mbd_ros.errors import MbdError
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.scene.reading.coupling_entries import coupling_kinds
from mbd_ros.scene.runs.simulation import build_simulation

# Small scenes without friction, for a million steps.


class LongScene(NamedTuple):
    """How a scene is run.

    Attributes:
        dt: Step [s].
    """

    title: str
    dt: float


LONG_SCENES: Mapping[str, LongScene] = {
    "pendulum": LongScene("Pendulum", 0.01),
    "coupled_arm": LongScene("Arm of three joints, the last coupled to the first", 2.0e-3),
    "four_bar": LongScene("Four-bar", 4.0e-3),
}


def _pendulum() -> LoadedScene:
    return mechanism({"initial": {"position": {"j0": -0.5}}}, *rods((1.0,)))()


def _coupled_arm() -> LoadedScene:
    """Hangs near its equilibrium and swings, so that the motion stays regular."""
    sections = {
        "couplings": {"j2": {"parent": "j0", "factor": 0.5, "offset": 0.8}},
        "initial": {"position": {"j0": -1.8, "j1": 0.1}},
    }
    return mechanism(sections, *rods((1.0, 1.0, 1.0)))()


def _four_bar() -> LoadedScene:
    """Crank, coupler and rocker of 1, 2 and 1.5 m on a ground of 2 m, released at rest."""
    elements = [
        *(joint("crank", "continuous", ("world", "crank_link")), rod("crank_link", 1.0, 1.0)),
        joint("coupler", "continuous", ("crank_link", "coupler_link"), (1.0, 0.0, 0.0)),
        rod("coupler_link", 2.0, 2.0),
        joint("rocker", "continuous", ("world", "rocker_link"), (2.0, 0.0, 0.0)),
        rod("rocker_link", 1.5, 1.5),
    ]
    closure = {
        "type": "loop_closure",
        "kind": "point",
        "directions": "xy",
        "frame_a": "coupler_link",
        "point_a": [2.0, 0.0, 0.0],
        "frame_b": "rocker_link",
        "point_b": [1.5, 0.0, 0.0],
    }
    start = {"position": {"crank": -1.6, "coupler": 0.8, "rocker": -1.5}}
    return mechanism({"constraints": [closure], "initial": start}, *elements)()


SCENES: Mapping[str, Callable[[], LoadedScene]] = {
    "pendulum": _pendulum,
    "coupled_arm": _coupled_arm,
    "four_bar": _four_bar,
}


KIND, TITLE = "long_runs", "Long runs"
STEPS, QUICK_STEPS, SAMPLES = 1_000_000, 5_000, 250
CLOSED = 1.0e-8  # m or rad, as for short runs
_STAYS = 0.05  # of the energy of the motion, by which a run may be off in the end
_METHODS: Mapping[str, Mapping[str, Any]] = {
    "rattle": {"type": "rattle"},
    "gauss_legendre": {"type": "gauss_legendre", "stages": 1},
    "generalized_alpha": {"type": "generalized_alpha"},
    "rk4": {"type": "rk4"},
    "dopri5": {"type": "dopri5"},
}
_KEEPERS = ("rattle", "generalized_alpha")
_SHORTER = 10  # times as few steps, where a million of them would take minutes
_IMPLICIT = ("gauss_legendre", "generalized_alpha")
_SLOW = 1.0e-7  # rate of constraints, relative to the fastest joint, as for short runs
_TRUNCATED = 1.0 / 12.0  # of dt^2 v'': error of the trapezoidal rule
_MICROSECONDS = {"pendulum": 30.0, "coupled_arm": 100.0, "four_bar": 200.0}  # a step, about


class RunSample(NamedTuple):
    """One instant of a run.

    Attributes:
        t: Time [s].
        energy: Change of the energy since the start [J].
        open: Largest |g| [m or rad].
        rate: Largest |g'| [m/s or rad/s].
        speed: Largest velocity of a joint [m/s or rad/s].
    """

    t: float
    energy: float
    open: float
    rate: float
    speed: float


def items(scenes: Sequence[str], quick: bool) -> list[Item]:
    """Every method on every small scene; nothing for the scenes of a user."""
    steps = QUICK_STEPS if quick else STEPS
    if scenes:
        return []
    entries = []
    for scene in LONG_SCENES:
        for method in _METHODS:
            count = steps // (_SHORTER if _is_short(scene, method) else 1)
            spec = {"scene": scene, "method": method, "steps": count}
            entries.append(Item(KIND, f"{scene}-{method}", spec, _seconds(scene, count)))
    return entries


def _is_short(scene: str, method: str) -> bool:
    return method in _IMPLICIT or (scene == "four_bar" and method != "rattle")


def _seconds(scene: str, steps: int) -> float:
    return 1.0e-6 * _MICROSECONDS[scene] * steps


def run(spec: Spec) -> Outcome:
    """Energy and violations at some instants of a long run."""
    loaded, dt = SCENES[spec["scene"]](), LONG_SCENES[spec["scene"]].dt
    scene, steps = loaded.scene, int(spec["steps"])
    oracle = Oracle(loaded)
    record: dict[str, Any] = {**spec, "dt": dt, "reason": ""}
    samples: list[RunSample] = []
    try:
        entry = _METHODS[spec["method"]]
        solver = "kkt" if spec["method"] in _KEEPERS and coupling_kinds(loaded.scene) else "plain"
        simulation = build_simulation(scene, integrator=entry, dt=dt, solver={"type": solver})
        swing = _follow(simulation, scene.initial, steps, oracle, samples)
        record["fastest"] = float(f"{starting_rate(scene):.6g}")
        record["swing"] = float(f"{swing:.6g}")
    except MbdError as error:
        record["reason"] = f"{type(error).__name__}: {error}"
    series = {
        name: [float(f"{sample[k]:.6g}") for sample in samples]
        for k, name in enumerate(RunSample._fields)
    }
    return {**record, "series": series, "wrong": _wrong(record, samples)}


def _follow(
    simulation: Simulation, start: State, steps: int, oracle: Oracle, samples: list[RunSample]
) -> float:
    """Sample a run; returns the energy that it turns between kinetic and potential [J]."""
    every, first, swing = max(1, steps // SAMPLES), None, 0.0
    for i, x in enumerate(simulation.run(start, steps * simulation.dt)):
        if i % every == 0:
            kinetic, potential = oracle.energy(x)
            first = kinetic + potential if first is None else first
            change = kinetic + potential - first
            speed = float(np.abs(x.v).max())
            samples.append(RunSample(x.t, change, oracle.violation(x), oracle.rate(x), speed))
            swing = max(swing, kinetic)
    return swing


def _wrong(record: Mapping[str, Any], samples: Sequence[RunSample]) -> str:
    """Why the run is wrong; empty if it is not."""
    if record["reason"]:
        return f"stopped: {record['reason']}"
    if not np.isfinite(np.array(samples)).all():
        return "not finite"
    worst = max(samples, key=lambda sample: sample.open)
    if worst.open > CLOSED:
        return f"constraints are {worst.open:.3g} open at t = {worst.t:.6g} s"
    worst, allowed = max(samples, key=lambda sample: sample.rate), _slow(record, samples)
    if worst.rate > allowed:
        text = f"constraints open with {worst.rate:.3g} per second at t = {worst.t:.6g} s"
        return f"{text}, {allowed:.2g} allowed"
    off = abs(samples[-1].energy)
    if off > _STAYS * record["swing"]:
        return f"energy off by {off:.3g} J of {record['swing']:.3g} J in the end"
    return ""


def _slow(record: Mapping[str, Any], samples: Sequence[RunSample]) -> float:
    """Rate of constraints that a method may leave [m/s or rad/s].

    Generalized-alpha keeps positions only: its velocities are off by what the trapezoidal rule
    leaves, dt^2 v'' / 12, with v'' about the largest velocity times the fastest rate squared.
    """
    speed = max(sample.speed for sample in samples)
    rounded = _SLOW * (1.0 + speed)
    if record["method"] != "generalized_alpha":
        return rounded
    return max(rounded, _TRUNCATED * (record["dt"] * record["fastest"]) ** 2 * speed)


def section(outcomes: Sequence[tuple[Item, Outcome]]) -> Section:
    """Energy and violations of constraints, as tables and plots."""
    if not outcomes:
        return Section(TITLE, ["Long runs are made of our own scenes only."])
    runs = [outcome for _, outcome in outcomes]
    steps = max(run["steps"] for run in runs)
    hours = max(run["steps"] * run["dt"] for run in runs) / 3600.0
    figures = {}
    for scene in dict.fromkeys(run["scene"] for run in runs):
        mine = [run for run in runs if run["scene"] == scene]
        figures[f"long_{scene}"] = long_run_plot(LONG_SCENES[scene].title, mine)
    text = [
        f"{steps:.0e} steps of one length each, up to {hours:.1f} hours of simulated time, "
        "without damping: energy must stay. RATTLE and generalized-alpha keep the constraints "
        "themselves, couplings as rows; for the others couplings are eliminated and loops kept by "
        "projection. Constraints and energies are evaluated apart from the code that integrates; "
        "velocity violations below 1e-9 are what differences leave. RATTLE and Gauss-Legendre are "
        "time-reversible: their energy oscillates. "
        "Generalized-alpha damps by design; energy errors of Runge-Kutta methods grow with the "
        "power of the step that is their order.",
        "Gauss-Legendre and generalized-alpha, and on the four-bar all but RATTLE, run for a "
        f"{_SHORTER}th of the steps, to save time. "
        "Wrong is a run that stops, is not finite, opens a constraint by more than "
        f"{CLOSED:g}, ends with an energy off by more than {_STAYS:.0%}, or has a "
        f"velocity violation above {_SLOW:g} (1 + largest velocity); for generalized-alpha, which "
        "keeps positions only, above (step × fastest rate)² / 12 of that velocity.",
    ]
    wrong = [f"{r['scene']}, {r['method']}: {r['wrong']}" for r in runs if r["wrong"]]
    return Section(TITLE, text, [_table(runs)], figures, wrong, headline=list(figures)[:1])


def _table(runs: Sequence[Mapping[str, Any]]) -> Table:
    rows = []
    for record in runs:
        series, swing = record["series"], record.get("swing", math.nan)
        energy = np.abs(series["energy"] or [math.nan])
        shares = (f"{energy.max() / swing:.1e}", f"{energy[-1] / swing:.1e}")
        opened = [f"{max(series[name], default=math.nan):.1e}" for name in ("open", "rate")]
        size = f"{record['steps']:.0e}", f"{record['dt']:g}"
        rows.append([record["scene"], record["method"], *size, *shares, *opened])
    columns = ["scene", "method", "steps", "dt [s]", "energy, largest", "energy, end"]
    columns += ["position violation [m, rad]", "velocity violation [1/s]"]
    return Table("Violations, energies relative to the largest kinetic energy", columns, rows)
