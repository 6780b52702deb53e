"""The inputs of a motion integrated again by an accurate method of the package."""

from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.dynamics.sources import Polynomials, Source
from mbd_ros.core.prediction.unknowns import PhaseMotion
from mbd_ros.core.simulation.simulation import Simulation
from mbd_ros.core.state import Array, State
from mbd_ros.errors import MbdError
from mbd_ros.scene.built_scene import Scene

ACCURATE = {"type": "dop853", "tolerance": 1.0e-10}


class Replay(NamedTuple):
    """How a simulation follows a motion.

    Attributes:
        deviation: Largest difference at the end of positions, velocities and internal states,
            relative to 1 + the largest value of each; NaN where there is no simulation.
        why: Why there is none; empty where there is.
    """

    deviation: float
    why: str = ""


def sources_of(scene: Scene, motion: PhaseMotion) -> dict[str, Source]:
    """The inputs of a motion as polynomials of the time, by name of the part."""
    mesh, knots = motion.mesh, motion.begin + motion.duration * motion.mesh.knots
    first, most = mesh.first_points, int(mesh.degrees.max())
    nu = motion.points["u"].shape[1]
    coefficients = np.zeros((mesh.intervals, most, nu))
    for i, degree in enumerate(mesh.degrees.tolist()):
        own = motion.points["u"][first[i] : first[i + 1]]
        h = motion.duration * mesh.widths[i]
        powers = mesh.scheme_of(degree).powers() / h ** np.arange(degree)[:, None]
        coefficients[i, :degree] = powers @ own
    return {
        name: Polynomials(knots[:-1], coefficients[:, :, slots])
        for name, slots in scene.inputs.slots.items()
    }


def simulation_of(scene: Scene, motion: PhaseMotion) -> Simulation:
    """A simulation of a scene under the inputs of a motion."""
    solver = {"type": "plain"} if scene.solver.compiles else None
    options = {"integrator": ACCURATE, "dt": motion.duration, "solver": solver}
    return scene.simulation(sources=sources_of(scene, motion), **options)


def state_at(simulation: Simulation, motion: PhaseMotion, node: int) -> State:
    """The state of all joints at a node."""
    t = motion.begin + motion.duration * float(motion.mesh.knots[node])
    parts = (motion.nodes[key][node] for key in "qvz")
    return simulation.system.expand(State(t, *parts))


def replay(scene: Scene, motion: PhaseMotion) -> Replay:
    """Integrate the inputs of a motion from its start to its end."""
    simulation = simulation_of(scene, motion)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            for x in simulation.run(state_at(simulation, motion, 0), motion.duration):
                last = x
    except MbdError as error:
        return Replay(float("nan"), str(error))
    return Replay(deviation(simulation, last, motion))


def deviation(simulation: Simulation, x: State, motion: PhaseMotion) -> float:
    """Largest relative difference of a state from the end of a motion."""
    y, chart = simulation.system.reduce(x), simulation.system.chart
    end = {key: motion.nodes[key][-1] for key in "qvz"}
    off: dict[str, Array] = {
        "q": chart.difference(end["q"], y.q),
        "v": y.v - end["v"],
        "z": y.z - end["z"],
    }
    sizes = {key: 1.0 + np.abs(motion.nodes[key]).max(axis=0, initial=0.0) for key in ("v", "z")}
    sizes["q"] = np.ones(1) * (1.0 + np.abs(motion.nodes["q"]).max(initial=0.0))
    worst: Any = [np.abs(off[key] / sizes[key]).max(initial=0.0) for key in "qvz"]
    return float(max(worst))
