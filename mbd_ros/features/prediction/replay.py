"""Simulation of the inputs of a predicted motion by an accurate integrator."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.loads.inputs import Polynomials, Source
from mbd_ros.core.state import Array, State
from mbd_ros.errors import MbdError
from mbd_ros.features.prediction.modes import PhaseMode, simulation_of_phase
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.optimal_control.phase_motion import PhaseMotion
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.runs.simulation import build_simulation

_SHARE = 1.0e-3  # of the error between nodes: what integration may add to it
_LEAST = 1.0e-12  # smallest tolerance of integration
_MOST = 1.0e-7  # largest tolerance of integration


class Replay(NamedTuple):
    """Deviation of a simulation from a predicted motion.

    Attributes:
        deviation: Largest difference at the end of positions, velocities and internal states,
            relative to 1 + the largest value of each; NaN without a simulation.
        why: Reason why there is no simulation; empty where there is one.
    """

    deviation: float
    why: str = ""


NOT_REPLAYED = Replay(float("nan"), "not done for a last iterate")


def replay(
    scene_simulation: Simulation,
    modes: Sequence[PhaseMode],
    motions: Sequence[PhaseMotion],
    *,
    at_nodes: bool = False,
) -> Replay:
    """Simulate the inputs of a motion, each phase from its beginning to its end.

    Args:
        scene_simulation: Simulation of the scene with the inputs of the motion.
        modes: Systems of the phases.
        motions: Motions of the phases.
        at_nodes: Whether to start again at each node, for measured loads: since they do not
            depend on the motion, a deviation by rounding would grow.
    """
    pairs = zip(modes, motions, strict=True)
    replays = [_replay_phase(scene_simulation, *pair, at_nodes=at_nodes) for pair in pairs]
    reasons = [r.why for r in replays if r.why]
    return Replay(max(r.deviation for r in replays), "; ".join(reasons))


def _replay_phase(
    scene_simulation: Simulation, mode: PhaseMode, motion: PhaseMotion, *, at_nodes: bool
) -> Replay:
    simulation = scene_simulation
    if mode.phased is not None:  # without its guards: a phase ends at its time
        system = scene_simulation.system.systems[mode.number]  # type: ignore[attr-defined]
        simulation = simulation_of_phase(scene_simulation, system, motion.duration)
    nodes = list(range(len(motion.mesh.knots))) if at_nodes else [0, len(motion.mesh.knots) - 1]
    worst = 0.0
    try:
        for pair in itertools.pairwise(nodes):
            worst = max(worst, _node_deviation(simulation, mode, motion, pair))
    except MbdError as error:
        return Replay(float("nan"), str(error))
    return Replay(worst)


def _node_deviation(
    simulation: Simulation, mode: PhaseMode, motion: PhaseMotion, pair: tuple[int, int]
) -> float:
    """Return the deviation of a simulation from one node at another node."""
    begin, end = motion.begin + motion.duration * motion.mesh.knots[list(pair)]
    x = simulation.system.expand(State(begin, *(motion.nodes[key][pair[0]] for key in "qvz")))
    last = x = x._replace(mode=mode.mode) if mode.mode else x
    with np.errstate(over="ignore", invalid="ignore"):
        for state in simulation.run(x, end - begin):
            last = state
    return deviation(simulation, last, motion, pair[1])


def build_input_simulation(
    scene: Scene, motions: Sequence[PhaseMotion], error: float, samples: int = 1
) -> Simulation:
    """Build a simulation of a scene with the inputs of a motion, a thousand times as accurate.

    Args:
        motions: Motions of the phases.
        error: Relative error of the motion between nodes.
        samples: Number of samples of the longest phase.
    """
    tolerance = min(max(_SHARE * error, _LEAST), _MOST)
    is_stiff = any(muscle.is_elastic for muscle in scene.muscles) and not scene.phases
    kind = "auto" if is_stiff else "plain"
    solver = {"type": kind} if scene.solver.tier == "auto" else None
    dt = max(motion.duration for motion in motions) / samples
    accurate = {"type": "dop853", "tolerance": tolerance}
    options = {"integrator": accurate, "dt": dt, "solver": solver}
    return build_simulation(scene, sources=sources_of(scene, motions), **options)


def sources_of(scene: Scene, motions: Sequence[PhaseMotion]) -> dict[str, Source]:
    """Return the inputs of a motion as polynomials of time, by name of the part."""
    most = max(int(motion.mesh.degrees.max()) for motion in motions)
    pieces = [_pieces(motion, most) for motion in motions]
    times = np.concatenate([begins for begins, _ in pieces])
    coefficients = np.concatenate([values for _, values in pieces])
    return {
        name: Polynomials(times, coefficients[:, :, slots])
        for name, slots in scene.inputs.slots.items()
    }


def _pieces(motion: PhaseMotion, most: int) -> tuple[Array, Array]:
    """Return times at which intervals begin, and coefficients (intervals, most, nu)."""
    mesh, first = motion.mesh, motion.mesh.first_points
    coefficients = np.zeros((mesh.intervals, most, motion.points["u"].shape[1]))
    for i, degree in enumerate(mesh.degrees.tolist()):
        u = motion.points["u"][first[i] : first[i + 1]]
        h = motion.duration * mesh.widths[i]
        powers = mesh.scheme_of(degree).powers() / h ** np.arange(degree)[:, None]
        coefficients[i, :degree] = powers @ u
    return motion.begin + motion.duration * mesh.knots[:-1], coefficients


def deviation(simulation: Simulation, x: State, motion: PhaseMotion, node: int = -1) -> float:
    """Return the largest relative difference of a state from a node, by default the last one."""
    y, chart = simulation.system.reduce(x), simulation.system.chart
    end = {key: motion.nodes[key][node] for key in "qvz"}
    errors: dict[str, Array] = {
        "q": chart.difference(end["q"], y.q),
        "v": y.v - end["v"],
        "z": y.z - end["z"],
    }
    sizes = {key: 1.0 + np.abs(motion.nodes[key]).max(axis=0, initial=0.0) for key in ("v", "z")}
    sizes["q"] = np.ones(1) * (1.0 + np.abs(motion.nodes["q"]).max(initial=0.0))
    worst: Any = [np.abs(errors[key] / sizes[key]).max(initial=0.0) for key in "qvz"]
    return float(max(worst))
