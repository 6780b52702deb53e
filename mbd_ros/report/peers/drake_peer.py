"""Drake on the scenes of this package; the only importer of pydrake."""

from collections.abc import Iterator, Sequence

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import DiscreteContactApproximation, MultibodyPlant
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator

from mbd_ros.core.state import State
from mbd_ros.errors import DivergedError
from mbd_ros.report.peers.contenders import Task, cpu_time
from mbd_ros.report.precision.rungs import Record

SETUP = (
    "Drake: error-controlled RK3 and RK5 of the continuous plant where there is no constraint; "
    "couplings and loops only exist in its discrete plant (SAP), as coupler and ball constraints; "
    "no limits, no contact geometry. Left out: loops that close on the world, on which Drake 1.51 "
    "crashes."
)
_ACCURACIES = {  # RK3 takes seconds beyond
    "runge_kutta3": (1e-3, 1e-5, 1e-7),
    "runge_kutta5": (1e-3, 1e-5, 1e-7, 1e-9, 1e-11),
}
_STEPS = (1e-3, 2e-4, 5e-5)  # s


class DrakeRun:
    """One integrator and accuracy, or the discrete plant with one step.

    Args:
        task: The scene.
        scheme: Integration scheme; empty for the discrete plant.
        fineness: Accuracy, or step [s].
    """

    package = "Drake"

    def __init__(self, task: Task, scheme: str, fineness: float) -> None:
        self._task, self._scheme, self._fineness = task, scheme, fineness
        self._plant = _plant(task, 0.0 if scheme else fineness)
        joints = [self._plant.GetJointByName(name) for name in task.names]
        self._q = np.array([joint.position_start() for joint in joints])
        self._v = np.array([joint.velocity_start() for joint in joints])
        self.setup = scheme or "discrete, SAP"
        self.record: Record = {"accuracy" if scheme else "dt": fineness}

    def run(self, times: Sequence[float]) -> tuple[list[State], float]:
        """As `Contender.run`.

        Raises:
            DivergedError: Drake gives up.
        """
        simulator, plant, n = Simulator(self._plant), self._plant, len(self._q)
        if self._scheme:
            integrator = ResetIntegratorFromFlags(simulator, self._scheme, 0.1)
            integrator.set_target_accuracy(self._fineness)
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
    """The sweep over integrators and accuracies."""
    if not (task.couplings or task.loops):
        for scheme, accuracies in _ACCURACIES.items():
            chosen = accuracies[: 3 if quick else None]
            yield from (DrakeRun(task, scheme, accuracy) for accuracy in chosen)
    if any("world" in (loop.frame_a, loop.frame_b) for loop in task.loops):
        return  # AdvanceTo of Drake 1.51 ends in a segmentation fault
    yield from (DrakeRun(task, "", dt) for dt in (_STEPS[:1] if quick else _STEPS))


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
    for loop in task.loops:
        body_a, body_b = plant.GetBodyByName(loop.frame_a), plant.GetBodyByName(loop.frame_b)
        plant.AddBallConstraint(body_a, np.array(loop.point_a), body_b, np.array(loop.point_b))
    plant.Finalize()
    return plant
