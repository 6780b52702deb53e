"""Drake on the scenes of this package; the only importer of pydrake."""

from collections.abc import Iterator, Sequence

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import DiscreteContactApproximation, MultibodyPlant
from pydrake.multibody.tree import RigidBody, SpatialInertia
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator

from mbd_ros.core.state import State
from mbd_ros.errors import DivergedError
from mbd_ros.report.peers.contenders import Task, cpu_time
from mbd_ros.report.precision.rungs import Record

SETUP = (
    "Drake: RK3 and RK5 of the continuous plant where there is no constraint, with fixed steps "
    "and with error control; couplings and loops only exist in its discrete plant (SAP), as "
    "coupler and ball constraints, the end of a loop on the world as a body that is welded to it; "
    "no limits, no contact geometry."
)
_ACCURACIES = {  # RK3 takes seconds beyond
    "runge_kutta3": (1e-1, 1e-3, 1e-5, 1e-7),
    "runge_kutta5": (1e-3, 1e-5, 1e-7, 1e-9, 1e-11, 1e-12, 1e-13, 1e-14),
}
_FIXED = {  # s
    "runge_kutta3": (5e-3, 2e-3, 1e-3, 5e-4, 2.5e-4),
    "runge_kutta5": (1e-2, 5e-3, 4e-3, 2.5e-3, 2e-3, 1.25e-3, 1e-3, 8e-4, 5e-4, 2.5e-4),
}
_STEPS = (1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 5e-5)  # s, discrete plant
_ANCHOR = "end_of_loop_on_world"


class DrakeRun:
    """One integrator and accuracy or step, or the discrete plant with one step.

    Args:
        task: The scene.
        scheme: Integration scheme; empty for the discrete plant.
        accuracy: Of the error control; None for fixed steps.
        dt: Step [s], or with error control longest first step.
    """

    package = "Drake"

    def __init__(
        self, task: Task, scheme: str, accuracy: float | None = None, dt: float = 0.1
    ) -> None:
        self._task, self._scheme, self._accuracy, self._dt = task, scheme, accuracy, dt
        self._plant = _plant(task, 0.0 if scheme else dt)
        joints = [self._plant.GetJointByName(name) for name in task.names]
        self._q = np.array([joint.position_start() for joint in joints])
        self._v = np.array([joint.velocity_start() for joint in joints])
        self.setup = scheme or "discrete, SAP"
        if scheme and accuracy is None:
            self.setup += ", fixed step"
        self.record: Record = {"dt": dt} if accuracy is None else {"accuracy": accuracy}

    def run(self, times: Sequence[float]) -> tuple[list[State], float]:
        """As `Contender.run`.

        Raises:
            DivergedError: Drake gives up.
        """
        simulator, plant, n = Simulator(self._plant), self._plant, len(self._q)
        if self._scheme:
            integrator = ResetIntegratorFromFlags(simulator, self._scheme, self._dt)
            if self._accuracy is None:
                integrator.set_fixed_step_mode(True)
            else:
                integrator.set_target_accuracy(self._accuracy)
        context = simulator.get_mutable_context()
        start = np.zeros(2 * n)
        start[self._q], start[n + self._v] = self._task.q, self._task.v
        plant.SetPositionsAndVelocities(context, start)
        simulator.Initialize()
        states, used = [], 0.0
        for t in times:
            try:
                used += cpu_time(lambda end=t: simulator.AdvanceTo(end))
            except RuntimeError as error:
                raise DivergedError(f"Drake: {error}"[:160]) from error
            q, v = plant.GetPositions(context)[self._q], plant.GetVelocities(context)[self._v]
            states.append(State(t, q, v))
        return states, used


def runs(task: Task, quick: bool) -> Iterator[DrakeRun]:
    """The sweep over integrators, accuracies and steps."""
    if not (task.couplings or task.loops):
        for scheme, accuracies in _ACCURACIES.items():
            chosen = accuracies[: 3 if quick else None]
            yield from (DrakeRun(task, scheme, accuracy) for accuracy in chosen)
        for scheme, steps in _FIXED.items():
            fixed = steps[: 3 if quick else None]
            yield from (DrakeRun(task, scheme, dt=dt) for dt in fixed)
    yield from (DrakeRun(task, "", dt=dt) for dt in (_STEPS[2:4] if quick else _STEPS))


def _plant(task: Task, dt: float) -> MultibodyPlant:
    plant = MultibodyPlant(dt)
    parser = Parser(plant)
    (model,) = parser.AddModels(task.urdf)
    plant.mutable_gravity_field().set_gravity_vector(task.gravity)
    if plant.HasBodyNamed("base", model):
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    if dt:
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
    for name in task.names:
        joint = plant.GetJointByName(name)
        joint.set_position_limits([-np.inf], [np.inf])
        joint.set_velocity_limits([-np.inf], [np.inf])
    for child, parent, factor, offset in task.couplings:
        one, other = plant.GetJointByName(child), plant.GetJointByName(parent)
        plant.AddCouplerConstraint(one, other, factor, offset)
    if any("world" in (loop.frame_a, loop.frame_b) for loop in task.loops):
        _add_anchor(plant)
    for loop in task.loops:
        body_a, body_b = _end(plant, loop.frame_a), _end(plant, loop.frame_b)
        plant.AddBallConstraint(body_a, np.array(loop.point_a), body_b, np.array(loop.point_b))
    plant.Finalize()
    return plant


def _add_anchor(plant: MultibodyPlant) -> None:
    """A body welded to the world: with the world itself in a loop AdvanceTo of 1.51 crashes."""
    inertia = SpatialInertia.SolidSphereWithMass(1.0, 0.1)  # that of a welded body says nothing
    body = plant.AddRigidBody(_ANCHOR, plant.AddModelInstance(_ANCHOR), inertia)
    plant.WeldFrames(plant.world_frame(), body.body_frame())


def _end(plant: MultibodyPlant, frame: str) -> RigidBody:
    return plant.GetBodyByName(_ANCHOR if frame == "world" else frame)
