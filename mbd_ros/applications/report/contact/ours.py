"""This package on contact problems."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.applications.report.contact.problems import Problem, Solid, Trace
from mbd_ros.applications.report.peers.contenders import cpu_time
from mbd_ros.applications.report.precision.converged import Choice, Record
from mbd_ros.core.state import Array, State
from mbd_ros.methods.simulation.sample_accelerations import accelerations_at
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.from_python import scene_from

SETUP = (
    "mbd_ros: moreau_jean, and where gaps are smooth rk4 with fixed steps and dop853 with "
    "tolerances, which end their steps where contacts open, close, slip or stick."
)
_STEPS = (0.2, 0.1, 5e-2, 2e-2, 1e-2, 5e-3, 2e-3)  # s
_SHORTEST = 5e-3  # s, of rk4, which needs no shorter ones from event to event
_TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
_LONGEST = 1e-2  # s, first step of a method that chooses the others


class OurContacts:
    """One integrator and step.

    Args:
        choice: How it is run.
    """

    package = "mbd_ros"

    def __init__(self, problem: Problem, choice: Choice) -> None:
        self._problem, self._choice = problem, choice
        self._scene = scene_of(problem)
        self.record: Record = dict(choice._asdict())
        self.setup = choice.method

    def run(self, times: Sequence[float]) -> tuple[Trace, float]:
        """States at the samples, and CPU time of the integration alone [s].

        Raises:
            MbdError: The run stopped.
        """
        simulation = self._choice.build(self._scene)
        y, used, states = simulation.start(self._scene.initial), 0.0, list[State]()

        def advance(due: float) -> None:
            nonlocal y
            y = simulation.advance(y, None, due)

        for t in times:
            used += cpu_time(lambda due=t: advance(due))
            states.append(simulation.system.expand(y))
        return trace_of(self._problem, simulation, states), used


def runs(problem: Problem, quick: bool) -> Iterator[OurContacts]:
    """The sweep over integrators and steps."""
    for dt in _STEPS[4:6] if quick else _STEPS:
        has_events = problem.is_smooth and dt >= _SHORTEST
        for kind in ("moreau_jean", *(("rk4",) if has_events else ())):
            yield OurContacts(problem, Choice("plain", None, {"type": kind}, dt))
    if problem.is_smooth:
        for tolerance in _TOLERANCES[1:2] if quick else _TOLERANCES:
            entry = {"type": "dop853", "tolerance": tolerance}
            yield OurContacts(problem, Choice("plain", None, entry, _LONGEST))


def scene_of(problem: Problem) -> Scene:
    """The scene of a problem; the origin of a body is its mass centre."""
    free = [solid for solid in problem.solids if solid.is_free]
    poses = {s.name: {"xyz": _sum(s.at, s.centre), "rpy": list(s.rpy)} for s in free}
    twists = {s.name: _twist(s) for s in free if any((*s.v, *s.spin))}
    law = {"type": "rigid", "friction": problem.mu, "restitution": problem.restitution}
    solids = {solid.name: solid for solid in problem.solids}
    sections: dict[str, Any] = {
        "gravity": list(problem.gravity),
        "bodies": {solid.name: _body(solid) for solid in problem.solids},
        "contacts": [
            {**law, "name": f"pair{i}", "between": [_shape(solids[upper]), lower]}
            for i, (upper, lower) in enumerate(problem.pairs)
        ],
        "initial": {"pose": poses, **({"twist": twists} if twists else {})},
    }
    return scene_from(sections)


def _twist(solid: Solid) -> Mapping[str, Any]:
    return {"linear": list(solid.v), "angular": list(solid.spin), "expressed_in": "world"}


def _body(solid: Solid) -> Mapping[str, Any]:
    is_ball = solid.shape == "sphere"
    shape = {"sphere": solid.size[0]} if is_ball else {"box": list(solid.size)}
    if solid.is_free:
        return {"shape": shape, "mass": solid.mass}
    pose = {"xyz": list(solid.at), "rpy": list(solid.rpy)}
    return {"shape": shape, "free": False, "pose": pose}


def _shape(solid: Solid) -> Any:
    if solid.shape != "feet":
        return solid.name
    points = solid.feet - np.array(solid.centre)
    return {"frame": solid.name, "points": points.tolist()}


def _sum(a: Sequence[float], b: Sequence[float]) -> list[float]:
    return [x + y for x, y in zip(a, b, strict=True)]


def trace_of(problem: Problem, simulation: Simulation, states: Sequence[State]) -> Trace:
    """Return the compared quantities of a run, from its states at the samples."""
    samples = [sample(problem, x) for x in states]
    forces = _forces(problem, simulation, states[-1]) if problem.has_forces else np.zeros(0)
    return Trace(*(np.array(part) for part in zip(*samples, strict=True)), forces)


def _forces(problem: Problem, simulation: Simulation, x: State) -> Array:
    """Normal forces at the last state of a run [N], as `Trace` orders them."""
    cones = simulation.system.layout.cones
    lam = accelerations_at(simulation, x, None, simulation.stepper.forces).lam
    forces = np.array([lam[cone.slots.start] for cone in cones])
    if problem.solids[0].shape == "feet":
        return forces
    owners = np.array([cone.name.split(".")[0] for cone in cones])
    return np.array([forces[owners == f"pair{i}"].sum() for i in range(len(problem.pairs))])


def sample(problem: Problem, x: State) -> tuple[Array, Array, Array]:
    """Places of the middles, velocities and spins in the world."""
    places, velocities, spins = [], [], []
    free = [solid for solid in problem.solids if solid.is_free]
    for solid, q, v in zip(free, x.q.reshape(-1, 7), x.v.reshape(-1, 6), strict=True):
        R = pin.XYZQUATToSE3(q).rotation
        lever, spin = R.dot(-np.array(solid.centre)), R.dot(v[3:])
        places.append(q[:3] + lever)
        velocities.append(R.dot(v[:3]) + np.cross(spin, lever))
        spins.append(spin)
    return np.array(places), np.array(velocities), np.array(spins)
