"""The inputs of a motion integrated again by an accurate method of the package."""

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
_LEAST = 1.0e-12  # tolerance of integration
_MOST = 1.0e-7  # tolerance of integration


class Replay(NamedTuple):
    """How a simulation follows a motion.

    Attributes:
        deviation: Largest difference at the end of positions, velocities and internal states,
            relative to 1 + the largest value of each; NaN where there is no simulation.
        why: Why there is none; empty where there is.
    """

    deviation: float
    why: str = ""


NOT_AGAIN = Replay(float("nan"), "not done for a last iterate")


def replay(
    whole: Simulation,
    modes: Sequence[PhaseMode],
    motions: Sequence[PhaseMotion],
    *,
    at_nodes: bool = False,
) -> Replay:
    """Integrate the inputs of a motion, each phase from its beginning to its end.

    Args:
        whole: Of the scene, under the inputs of the motion.
        modes: The systems of the phases.
        motions: Of the phases.
        at_nodes: From node to node instead: loads that were measured do not give way, and a motion
            that leaves its plan by a rounding leaves it altogether.
    """
    pairs = zip(modes, motions, strict=True)
    found = [_phase_again(whole, *one, at_nodes=at_nodes) for one in pairs]
    why = [one.why for one in found if one.why]
    return Replay(max(one.deviation for one in found), "; ".join(why))


def _phase_again(
    whole: Simulation, mode: PhaseMode, motion: PhaseMotion, *, at_nodes: bool
) -> Replay:
    simulation = whole
    if mode.phased is not None:  # without its guards: a phase ends at its time
        system = whole.system.systems[mode.number]  # type: ignore[attr-defined]
        simulation = simulation_of_phase(whole, system, motion.duration)
    nodes = list(range(len(motion.mesh.knots))) if at_nodes else [0, len(motion.mesh.knots) - 1]
    worst = 0.0
    try:
        for pair in itertools.pairwise(nodes):
            worst = max(worst, _from_node(simulation, mode, motion, pair))
    except MbdError as error:
        return Replay(float("nan"), str(error))
    return Replay(worst)


def _from_node(
    simulation: Simulation, mode: PhaseMode, motion: PhaseMotion, pair: tuple[int, int]
) -> float:
    """How far a simulation from one node is off at another one."""
    begin, end = motion.begin + motion.duration * motion.mesh.knots[list(pair)]
    x = simulation.system.expand(State(begin, *(motion.nodes[key][pair[0]] for key in "qvz")))
    last = x = x._replace(mode=mode.mode) if mode.mode else x
    with np.errstate(over="ignore", invalid="ignore"):
        for at in simulation.run(x, end - begin):
            last = at
    return deviation(simulation, last, motion, pair[1])


def simulation_of(
    scene: Scene, motions: Sequence[PhaseMotion], error: float, samples: int = 1
) -> Simulation:
    """A simulation of a scene under the inputs of a motion, a thousand times finer than it.

    Args:
        motions: Of the phases.
        error: Between nodes, relative.
        samples: How many of the longest phase it gives.
    """
    tolerance = min(max(_SHARE * error, _LEAST), _MOST)
    is_stiff = any(muscle.is_elastic for muscle in scene.muscles) and not scene.phases
    word = "auto" if is_stiff else "plain"
    solver = {"type": word} if scene.solver.tier == "auto" else None
    dt = max(motion.duration for motion in motions) / samples
    accurate = {"type": "dop853", "tolerance": tolerance}
    options = {"integrator": accurate, "dt": dt, "solver": solver}
    return build_simulation(scene, sources=sources_of(scene, motions), **options)


def sources_of(scene: Scene, motions: Sequence[PhaseMotion]) -> dict[str, Source]:
    """The inputs of a motion as polynomials of the time, by name of the part."""
    most = max(int(motion.mesh.degrees.max()) for motion in motions)
    pieces = [_pieces(motion, most) for motion in motions]
    times = np.concatenate([one for one, _ in pieces])
    coefficients = np.concatenate([one for _, one in pieces])
    return {
        name: Polynomials(times, coefficients[:, :, slots])
        for name, slots in scene.inputs.slots.items()
    }


def _pieces(motion: PhaseMotion, most: int) -> tuple[Array, Array]:
    mesh, first = motion.mesh, motion.mesh.first_points
    found = np.zeros((mesh.intervals, most, motion.points["u"].shape[1]))
    for i, degree in enumerate(mesh.degrees.tolist()):
        own = motion.points["u"][first[i] : first[i + 1]]
        h = motion.duration * mesh.widths[i]
        powers = mesh.scheme_of(degree).powers() / h ** np.arange(degree)[:, None]
        found[i, :degree] = powers @ own
    return motion.begin + motion.duration * mesh.knots[:-1], found


def deviation(simulation: Simulation, x: State, motion: PhaseMotion, node: int = -1) -> float:
    """Largest relative difference of a state from a node of a motion, the last one by default."""
    y, chart = simulation.system.reduce(x), simulation.system.chart
    end = {key: motion.nodes[key][node] for key in "qvz"}
    off: dict[str, Array] = {
        "q": chart.difference(end["q"], y.q),
        "v": y.v - end["v"],
        "z": y.z - end["z"],
    }
    sizes = {key: 1.0 + np.abs(motion.nodes[key]).max(axis=0, initial=0.0) for key in ("v", "z")}
    sizes["q"] = np.ones(1) * (1.0 + np.abs(motion.nodes["q"]).max(initial=0.0))
    worst: Any = [np.abs(off[key] / sizes[key]).max(initial=0.0) for key in "qvz"]
    return float(max(worst))
