"""One run against the converged motion: its errors and its time."""

import gc
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbd_ros.applications.report.precision.converged import Choice, Known, distance, problem_of
from mbd_ros.applications.report.precision.reference_problems import error
from mbd_ros.core.state import State
from mbd_ros.errors import MbdError, SolveError
from mbd_ros.methods.projection.assembly import violation
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.scene.built_scene import Scene

Record = dict[str, Any]
_USELESS = 1.0e3  # error of a run that says nothing [rad or m]


def measure(scene: Scene, choice: Choice, motion: Known, repeats: int, most: float) -> Record:
    """Run a scene and measure error and time.

    Args:
        scene: The scene.
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
    found: dict[str, float] = {
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
        found["multipliers"] = float(np.abs(solved - motion.multipliers).max()) / scale
    return found
