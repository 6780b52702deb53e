"""Motion of a scene to rounding, how far a second method agrees, and runs against it.

A run is measured by its errors and its time.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.applications.report.precision.reference_problems import (
    PROBLEMS,
    Problem,
    error,
    reference,
)
from mbd_ros.core.dynamics.tiers import TIERS
from mbd_ros.core.state import Array, State
from mbd_ros.errors import MbdError, SceneError, SolveError
from mbd_ros.methods.projection.assembly import violation
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.runs.simulation import build_simulation

BAUMGARTE = {"type": "baumgarte", "time_constant": 0.02}
STABILIZATIONS: tuple[Mapping[str, Any], ...] = (
    {"type": "projection"},
    BAUMGARTE,
    {"type": "none"},
)
WANTED = (1.0e-3, 1.0e-6, 1.0e-9)  # errors for which a choice is offered [rad or m]
COMPILED = "compiled"  # the plain tier in native code
KEEPERS = ("rattle", "shake", "generalized_alpha")  # keep rows themselves
BY_NAME = {problem.name: problem for problem in PROBLEMS}
_FINE = {"type": "dop853", "tolerance": 1e-13}
_SECOND: tuple[tuple[Mapping[str, Any], float], ...] = (  # integrator, steps in those of the scene
    ({"type": "gauss_legendre", "stages": 3, "tolerance": 1e-13}, 0.5),
    ({"type": "dopri5", "tolerance": 1e-12}, 1.0),
    ({"type": "adams", "order": 8}, 0.125),
)
_SPECIAL: Mapping[str, tuple[tuple[Mapping[str, Any], float], ...]] = {
    # Every toggle multiplies the rounding error of a stage that falls next to it: few stages
    "a02_four_bars_40": (({"type": "dop853"}, 1.0), ({"type": "dopri5"}, 0.5)),
    "s01_parabola": (({"type": "filippov", "tolerance": 1e-13}, 1.0), ({"type": "filippov"}, 0.2)),
}
_GOOD = 1.0e-10  # agreement that needs no third method
_ENOUGH = 1.0e-3  # of a step: two times that are meant to be the same
_STEPS = (1.0, 0.5, 0.25, 0.125)  # of the scene
_NEAR = 1.0e-8  # [rad or m]: agreement that proves the point by itself
_SETTLED = 2.0  # distance in last changes; a method of order 2 that approaches has 1/3
Record = dict[str, Any]
_USELESS = 1.0e3  # error of a run that says nothing [rad or m]


@cache
def known(path: str, times: tuple[float, ...]) -> Known:
    """Converged motion of a scene at some times.

    Args:
        times: Samples [s], increasing, > 0.

    Raises:
        MbdError: No method gets there.
    """
    return motion_of(load_scene(path), times)


class Known(NamedTuple):
    """A converged motion.

    Attributes:
        times: Samples [s].
        states: States of all joints there.
        multipliers: Those of `System.multiplier_rows` in the tier `plain`, one row a sample.
        energies: [J].
        method: Method that computed it.
        check: Second method that computed it; empty where none succeeded.
        agreement: Largest difference in position between the two [rad or m]; inf without.
        published: Error against the published reference, in its measure; None without one.
        is_wrong: Whether that error is beyond what the reference demands of precise codes.
    """

    times: tuple[float, ...]
    states: tuple[State, ...]
    multipliers: Array
    energies: Array
    method: str
    check: str
    agreement: float
    published: float | None
    is_wrong: bool


def motion_of(scene: Scene, times: tuple[float, ...]) -> Known:
    """Converged motion of a built scene, as `known`."""
    special = None if scene.path is None else _SPECIAL.get(scene.path.stem)
    methods = ((_FINE, 1.0), *_SECOND) if special is None else special
    first = _choice(scene, *methods[0])
    simulation, ys = trace(scene, first, times)
    states = tuple(simulation.system.expand(y) for y in ys)
    check, agreement = _second(scene, times, states, methods[1:])
    published, is_wrong = _published(scene, states)
    solved = [simulation.system.evaluate(x).lam for x in states]
    return Known(
        times,
        states,
        np.array(solved),
        np.array([simulation.system.energy(y) for y in ys]),
        f"{first.method}, {first.fineness}",
        check,
        agreement,
        published,
        is_wrong,
    )


def _choice(scene: Scene, integrator: Mapping[str, Any], steps: float) -> Choice:
    stabilization = {"type": "projection"} if scene.system().rows else None
    return Choice("plain", stabilization, integrator, steps * scene.dt)


def trace(scene: Scene, choice: Choice, times: Sequence[float]) -> tuple[Simulation, list[State]]:
    """States of the integrated coordinates at some times.

    Raises:
        MbdError: The run stopped.
    """
    simulation = choice.build(scene)
    y, ys = simulation.start(scene.initial), []
    for t in times:
        y = simulation.advance(y, None, t)
        if abs(y.t - t) > _ENOUGH * choice.dt:
            raise SolveError(f"the run ends at {y.t:g} s instead of {t:g} s")
        ys.append(y)
    return simulation, ys


def _second(
    scene: Scene,
    times: Sequence[float],
    states: Sequence[State],
    methods: Sequence[tuple[Mapping[str, Any], float]],
) -> tuple[str, float]:
    """The method that agrees best, and the largest difference."""
    best = ("", float("inf"))
    for integrator, steps in methods:
        choice = _choice(scene, integrator, steps)
        try:
            simulation, ys = trace(scene, choice, times)
        except MbdError:
            continue
        pairs = zip(ys, states, strict=True)
        off = [distance(scene, simulation.system.expand(y), x) for y, x in pairs]
        worst = float(np.max(off))  # nan stays nan
        if worst < best[1]:
            best = (f"{choice.method}, {choice.fineness}", worst)
        if worst <= _GOOD:
            break
    return best


def distance(scene: Scene, ours: State, theirs: State) -> float:
    """Largest difference of two configurations of all joints [rad or m]."""
    return float(np.abs(pin.difference(scene.robot.model, theirs.q, ours.q)).max())


def _published(scene: Scene, states: Sequence[State]) -> tuple[float | None, bool]:
    problem = problem_of(scene)
    if problem is None:
        return None, False
    found = error(problem, scene.robot, states)
    return found, not found <= reference(problem.reference).high


def problem_of(scene: Scene) -> Problem | None:
    """The published problem that a scene file of ours is; None for any other file."""
    if scene.path is None or scene.path.parent.name != "benchmark":
        return None
    return BY_NAME.get(scene.path.stem)


class Choice(NamedTuple):
    """One way to integrate a scene.

    Attributes:
        solver: A tier of `mbd_ros.core.dynamics.tiers`, `plain` for the cheapest, `compiled` for
            the cheapest in native code.
        stabilization: Its entry; None where there is nothing to stabilize.
        dt: Step, or with a tolerance longest first step [s].
    """

    solver: str
    stabilization: Mapping[str, Any] | None
    integrator: Mapping[str, Any]
    dt: float

    @property
    def method(self) -> str:
        """Name of the integrator with the option that separates it from its relatives."""
        more = [f"{k} {v}" for k, v in self.integrator.items() if k in ("order", "stages")]
        return " ".join([self.integrator["type"], *more])

    @property
    def fineness(self) -> str:
        """Tolerance or step."""
        tolerance = self.integrator.get("tolerance")
        return f"dt {self.dt:g} s" if tolerance is None else f"tolerance {tolerance:g}"

    def build(self, scene: Scene) -> Simulation:
        """The simulation of a scene that is chosen."""
        return build_simulation(
            scene,
            integrator=self.integrator,
            dt=self.dt,
            stabilization=self.stabilization,
            solver={"type": self.solver},
        )


def formulations(scene: Scene) -> list[str]:
    """`plain` and the tiers that solve the scene differently."""
    seen, names = {_signature(scene, "plain")}, ["plain"]
    for name in TIERS[1:]:
        try:
            signature = _signature(scene, name)
        except SceneError:
            continue
        if signature not in seen:
            seen.add(signature)
            names.append(name)
    return names


def _signature(scene: Scene, solver: str) -> tuple[type, int, bool]:
    system = scene.system(solver={"type": solver})
    return system.tier, len(system.rows), system.bounded is not None


def stabilizations(scene: Scene, solver: str, kind: str) -> Sequence[Mapping[str, Any] | None]:
    """Those that make a difference with a tier and an integrator, the usual one first."""
    has_rows = bool(scene.system(solver={"type": solver}).rows)
    return STABILIZATIONS if has_rows and kind not in KEEPERS else (None,)


def approach(scene: Scene, motion: Known) -> Approach:
    """Whether RATTLE approaches a converged motion as its step is halved.

    Accelerations need J' v, which RATTLE does not read: it keeps g = 0 and J v = 0 by impulses. A
    wrong drift therefore leaves RATTLE settled at a distance. Where it does not settle with these
    steps, at a toggle, there is no result.
    """
    if not scene.system().rows:
        return Approach(False, "no rows")
    runs = _runs(scene, motion)
    if len(runs) < 2:
        return Approach(False, "RATTLE does not run here")
    away = [_apart(scene, run, motion.states) for run in runs]
    shown = "RATTLE, step halved: " + " -> ".join(f"{d:.1e}" for d in away)
    is_settled = away[-1] > _SETTLED * _apart(scene, runs[-1], runs[-2])
    if away[-1] > _NEAR and is_settled:
        return Approach(True, shown)
    return Approach(False, shown if away[-1] < away[-2] else f"{shown}, not settled")


class Approach(NamedTuple):
    """Result of the check.

    Attributes:
        is_wrong: RATTLE settles on another motion.
        text: Its largest differences in position from step to step [rad or m].
    """

    is_wrong: bool
    text: str


def _runs(scene: Scene, motion: Known) -> list[list[State]]:
    """States of all joints at the samples, for steps that are halved."""
    runs = []
    for steps in _STEPS:
        choice = Choice("plain", None, {"type": "rattle"}, steps * scene.dt)
        try:
            simulation, ys = trace(scene, choice, motion.times)
        except MbdError:
            continue
        runs.append([simulation.system.expand(y) for y in ys])
    return runs


def _apart(scene: Scene, ours: Sequence[State], theirs: Sequence[State]) -> float:
    return max(distance(scene, x, y) for x, y in zip(ours, theirs, strict=True))


def of_record(record: Mapping[str, Any]) -> Choice:
    """The choice that a result was made with."""
    return Choice(*(record[key] for key in Choice._fields))


def snippet(choice: Choice) -> str:
    """Lines to be pasted into a scene file."""
    lines = [f"integrator: {_entry(choice.integrator)}", f"dt: {_number(choice.dt)}"]
    if choice.stabilization is not None:
        lines.insert(0, f"stabilization: {_entry(choice.stabilization)}")
    if choice.solver != "plain":
        lines.insert(0, f"solver: {{type: {choice.solver}}}")
    return "\n".join(lines)


def compiles(scene: Scene, integrator: Mapping[str, Any]) -> bool:
    """Whether `auto` takes compiled steps; not where extra or compiler are missing."""
    simulation = build_simulation(scene, integrator=integrator, solver={"type": "auto"})
    return simulation.how.startswith(COMPILED)


def _entry(entry: Mapping[str, Any]) -> str:
    values = {k: _number(v) if isinstance(v, float) else str(v) for k, v in entry.items()}
    return f"{{{', '.join(f'{k}: {v}' for k, v in values.items())}}}"


def _number(value: float) -> str:
    return f"{value:g}"


def measure(scene: Scene, choice: Choice, motion: Known, repeats: int, most: float) -> Record:
    """Run a scene and measure error and time.

    Args:
        choice: How it is run.
        motion: The converged motion.
        repeats: How often it is run; the best time counts.
        most: Evaluations after which it is given up, looked at from sample to sample.

    Returns:
        The choice and errors [rad, m, their rates, J, of the largest multiplier], CPU `seconds`
        per simulated second, `spread` of the repeats (None without any), `evaluations`; or
        `stopped`.
    """
    record: Record = dict(choice._asdict())
    seconds: list[float] = []
    try:
        for _ in range(repeats):
            simulation, ys, used = timed(scene, choice, motion.times, most)
            seconds.append(used / motion.times[-1])
        record |= errors(scene, simulation, ys, motion)
    except MbdError as stop:
        return record | {"stopped": f"{type(stop).__name__}: {stop}"[:160]}
    if not record["position"] < _USELESS:
        return record | {"stopped": "far off"}
    best = min(seconds)
    spread = sorted(seconds)[len(seconds) // 2] / best - 1.0 if len(seconds) > 1 else None
    record |= {"seconds": best, "spread": spread}
    return record | {"evaluations": simulation.system.evaluations, "steps": simulation.steps}


def timed(
    scene: Scene, choice: Choice, times: Sequence[float], most: float = np.inf
) -> tuple[Simulation, list[State], float]:
    """A run, its states at the samples, and its CPU time [s] without building and assembling.

    Raises:
        MbdError: The run stopped, or takes more evaluations than `most`.
    """
    simulation = choice.build(scene)
    y, ys = simulation.start(scene.initial), []
    gc.collect()
    gc.disable()
    try:
        begin = time.process_time()
        for t in times:
            y = simulation.advance(y, None, t)
            ys.append(y)
            if simulation.system.evaluations > most:
                raise SolveError(f"more than {most:.3g} evaluations at {t:g} s")
        used = time.process_time() - begin
    finally:
        gc.enable()
    return simulation, ys, used


def errors(
    scene: Scene, simulation: Simulation, ys: Sequence[State], motion: Known
) -> Mapping[str, float]:
    """Largest errors over the samples.

    Position is in the measure of the published reference where there is one. Multipliers are those
    of the equations at the state that was reached, relative to the largest one of the motion.
    """
    system, problem = simulation.system, problem_of(scene)
    states = [system.expand(y) for y in ys]
    pairs = list(zip(states, motion.states, strict=True))
    off = float(np.max([distance(scene, x, known) for x, known in pairs]))  # nan stays nan
    position = off if problem is None else error(problem, scene.robot, states)
    violations = [violation(system, y) for y in ys]
    energies = np.array([system.energy(y) for y in ys])
    error_of: dict[str, float] = {
        "position": position,
        "configuration": off,
        "velocity": float(np.max([np.abs(x.v - known.v).max() for x, known in pairs])),
        "energy": float(np.abs(energies - motion.energies).max()),
        "drift": max(d.position for d in violations),
        "drift_rate": max(d.velocity for d in violations),
    }
    if motion.multipliers.size:
        solved = np.array([system.evaluate(x).lam for x in states])
        scale = float(np.abs(motion.multipliers).max()) or 1.0
        error_of["multipliers"] = float(np.abs(solved - motion.multipliers).max()) / scale
    return error_of
