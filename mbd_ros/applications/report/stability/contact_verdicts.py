"""Verdicts on contact problems, by closed forms and by laws that every state can be asked for."""

import math
from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from mbd_ros.applications.report.contact.ours import sample, scene_of, trace_of
from mbd_ros.applications.report.contact.problem import CORNERS, Problem, Solid
from mbd_ros.applications.report.stability.cases import (
    BOUNDED,
    CONVERGED,
    TIME_STEPPING,
    WRONG,
    Verdict,
    raised,
)
from mbd_ros.applications.report.stability.scene_text import Entry
from mbd_ros.applications.report.stability.verdicts import ASKED
from mbd_ros.core.state import Array, State
from mbd_ros.scene.built_scene import Scene

CONTACT_METHODS: dict[str, Entry] = {
    "rk4": {"type": "rk4"},
    "dop853": {"type": "dop853", "tolerance": 1.0e-8},
    TIME_STEPPING: {"type": TIME_STEPPING},
}
_DEPTH = 1.0e-9  # of the largest length of a solid, in the ground
_GAIN = 1.0e-9  # of the energy of the motion, in one step
_QUARTERS, _BETTER = 3, 0.6  # shorter steps, and what one of them must leave of the error


def contact_methods(problem: Problem) -> list[str]:
    """Methods that take a problem: events need gaps that are smooth."""
    return list(CONTACT_METHODS) if problem.is_smooth else [TIME_STEPPING]


def judge_contact(problem: Problem, method: str, dt: float) -> Verdict:
    """The verdict on one run.

    Args:
        problem: The problem; its error is relative.
        method: Key of `CONTACT_METHODS`.
        dt: Step, or with a tolerance longest first step [s].
    """
    try:
        scene = scene_of(problem)
        error, fault = _attempt(problem, scene, method, dt)
        if fault:
            return Verdict(WRONG, error, fault)
        if error <= ASKED:
            return Verdict(CONVERGED, error)
        shorter, fault = _shorter(problem, scene, method, dt, error)
    except Exception as error:  # noqa: BLE001 - every exception is a verdict
        verdict = raised(error)
        return verdict if _is_named(problem, str(error)) else verdict._replace(kind=WRONG)
    if fault:
        return Verdict(WRONG, error, fault)
    if shorter <= max(ASKED, _BETTER * error):
        return Verdict(BOUNDED, error)
    return Verdict(WRONG, error, f"off by {error:.3g}, and by {shorter:.3g} at shorter steps")


def faults(problem: Problem, scene: Scene, states: Sequence[State]) -> str:
    """What no solution is needed for: the first fault of a motion, empty without any."""
    model = scene.robot.model
    data, before = model.createData(), math.inf
    size = max(length for solid in problem.solids for length in solid.size)
    energies = [_energy(model, data, x) for x in states]
    lift = sum(solid.mass for solid in problem.solids) * float(np.linalg.norm(problem.gravity))
    swing = max(float(np.ptp(energies)), max(_kinetic(model, data, x) for x in states))
    swing += lift * size
    for x, energy in zip(states, energies, strict=True):
        if not (np.isfinite(x.q).all() and np.isfinite(x.v).all()):
            return f"a state at t = {x.t:.6g} s is not finite"
        if energy > before + _GAIN * swing:
            return f"a step gains {energy - before:.3g} J of {swing:.3g} J at t = {x.t:.6g} s"
        if (depth := _depth(problem, x)) > _DEPTH * size:
            return f"something is {depth:.3g} m in the ground at t = {x.t:.6g} s"
        before = energy
    return ""


def _attempt(problem: Problem, scene: Scene, method: str, dt: float) -> tuple[float, str]:
    """The error of a run, and its first fault."""
    simulation = scene.simulation(integrator=CONTACT_METHODS[method], dt=dt)
    states = list(simulation.run(scene.initial, problem.times[-1]))
    if fault := faults(problem, scene, states):
        return math.inf, fault
    every = [states[round(t / dt)] for t in problem.times]
    return problem.error(trace_of(problem, simulation, every)), ""


def _shorter(
    problem: Problem, scene: Scene, method: str, dt: float, error: float
) -> tuple[float, str]:
    """The error at the first shorter step that is better, else at the last; its first fault."""
    found, fault = error, ""
    for k in range(1, _QUARTERS + 1):
        found, fault = _attempt(problem, scene, method, dt / 4**k)
        if fault or found <= max(ASKED, _BETTER * error):
            break
    return found, fault


def _is_named(problem: Problem, text: str) -> bool:
    """Whether a message names a time, a solid or a contact."""
    names = [*(solid.name for solid in problem.solids), "pair"]
    return "t = " in text or any(name in text for name in names)


def _energy(model: pin.Model, data: pin.Data, x: State) -> float:
    return _kinetic(model, data, x) + float(pin.computePotentialEnergy(model, data, x.q))


def _kinetic(model: pin.Model, data: pin.Data, x: State) -> float:
    return float(pin.computeKineticEnergy(model, data, x.q, x.v))


def _depth(problem: Problem, x: State) -> float:
    """Depth of the lowest point of all solids that are free [m]; the ground is z <= 0."""
    free = [solid for solid in problem.solids if solid.is_free]
    if len(free) < len(problem.solids):  # on something else than the ground
        return -math.inf
    attitudes = [pin.XYZQUATToSE3(q).rotation for q in x.q.reshape(-1, 7)]
    middles = sample(problem, x)[0]
    heights = [
        float(middle[2] + _lowest(solid, R))
        for solid, middle, R in zip(free, middles, attitudes, strict=True)
    ]
    return -min(heights)


def _lowest(solid: Solid, R: Array) -> float:
    """Height of the lowest point of a solid over its middle [m]."""
    if solid.shape == "sphere":
        return -solid.size[0]
    if solid.shape == "feet":
        return float((solid.feet @ R.T)[:, 2].min())
    half = 0.5 * np.array(solid.size)
    corners = [(x, y, z) * half for x, y in CORNERS for z in (-1.0, 1.0)]
    return float((np.array(corners) @ R.T)[:, 2].min())
