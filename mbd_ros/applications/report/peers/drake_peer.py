"""Drake on the scenes of this package; the only importer of pydrake."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import DiscreteContactApproximation, MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    LinearSpringDamper,
    PrismaticJoint,
    PrismaticSpring,
    RevoluteJoint,
    RevoluteSpring,
    RigidBody,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator

from mbd_ros.applications.report.peers.contenders import cpu_time
from mbd_ros.applications.report.peers.translation import Body, Task
from mbd_ros.applications.report.precision.converged import Record
from mbd_ros.core.state import Array, State
from mbd_ros.errors import DivergedError, SceneError

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
_LINEAR = 2  # coefficients of a coupling
_HINGE, _SLIDE = (RevoluteJoint, RevoluteSpring), (PrismaticJoint, PrismaticSpring)


class DrakeRun:
    """One integrator and accuracy or step, or the discrete plant with one step.

    Args:
        scheme: Integration scheme; empty for the discrete plant.
        accuracy: Of the error control; None for fixed steps.
        dt: Step [s], or with error control longest first step.

    Raises:
        SceneError: Drake cannot express the scene.
    """

    package = "Drake"

    def __init__(
        self, task: Task, scheme: str, accuracy: float | None = None, dt: float = 0.1
    ) -> None:
        self._task, self._scheme, self._accuracy, self._dt = task, scheme, accuracy, dt
        try:
            self._plant = _plant(task, 0.0 if scheme else dt)
        except RuntimeError as error:
            raise SceneError(str(error).splitlines()[0]) from error
        self._q, self._v = _coordinates(task, self._plant)
        self.setup = scheme or "discrete, SAP"
        if scheme and accuracy is None:
            self.setup += ", fixed step"
        self.record: Record = {"dt": dt} if accuracy is None else {"accuracy": accuracy}

    def run(self, times: Sequence[float]) -> tuple[list[State], float]:
        """Return the states at the samples, and the CPU time of the integration [s].

        Raises:
            DivergedError: Drake gives up.
        """
        simulator, plant = Simulator(self._plant), self._plant
        if self._scheme:
            integrator = ResetIntegratorFromFlags(simulator, self._scheme, self._dt)
            if self._accuracy is None:
                integrator.set_fixed_step_mode(True)
            else:
                integrator.set_target_accuracy(self._accuracy)
        context = simulator.get_mutable_context()
        q, v, torques = (np.zeros(len(i)) for i in (self._q, self._v, self._v))
        q[self._q], v[self._v] = _to_drake(self._task)
        torques[self._v] = self._task.torques
        plant.SetPositions(context, q)
        plant.SetVelocities(context, v)
        plant.get_applied_generalized_force_input_port().FixValue(context, torques)
        simulator.Initialize()
        states, used = [], 0.0
        for t in times:
            try:
                used += cpu_time(lambda end=t: simulator.AdvanceTo(end))
            except RuntimeError as error:
                raise DivergedError(f"Drake: {error}"[:160]) from error
            q, v = plant.GetPositions(context)[self._q], plant.GetVelocities(context)[self._v]
            states.append(State(t, *_from_drake(self._task, q, v)))
        return states, used


def runs(task: Task, quick: bool) -> Iterator[DrakeRun]:
    """The sweep over integrators, accuracies and steps."""
    if not task.has_rows:
        for scheme, accuracies in _ACCURACIES.items():
            chosen = accuracies[: 3 if quick else None]
            yield from (DrakeRun(task, scheme, accuracy) for accuracy in chosen)
        for scheme, steps in _FIXED.items():
            fixed = steps[: 3 if quick else None]
            yield from (DrakeRun(task, scheme, dt=dt) for dt in fixed)
    yield from (DrakeRun(task, "", dt=dt) for dt in (_STEPS[2:4] if quick else _STEPS))


def _plant(task: Task, dt: float) -> MultibodyPlant:
    plant = MultibodyPlant(dt)
    plant.mutable_gravity_field().set_gravity_vector(task.gravity)
    if dt:
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
    bodies = [plant.world_body()]
    for body in task.moving:
        bodies.append(_add_body(plant, bodies[body.parent], body))
    for child, parent, coefficients in task.follows:
        if len(coefficients) > _LINEAR:
            raise SceneError("couplings that are not linear")
        offset, factor = coefficients
        one, other = (plant.GetJointByName(task.moving[i - 1].name) for i in (child, parent))
        plant.AddCouplerConstraint(one, other, factor, offset)
    _add_pairs(plant, task, bodies)
    for a, b, stiffness, damping, length in task.springs:
        ends = (bodies[a.body], a.place.translation, bodies[b.body], b.place.translation)
        plant.AddForceElement(LinearSpringDamper(*ends, length, stiffness, damping))
    plant.Finalize()
    return plant


def _add_pairs(plant: MultibodyPlant, task: Task, bodies: Sequence[RigidBody]) -> None:
    """Points that coincide, frames that coincide, points at a distance."""
    pairs = (*task.points, *task.welds, *((a, b) for a, b, _ in task.bars))
    ends = list(bodies)
    if any(end.body == 0 for pair in pairs for end in pair):
        ends[0] = _add_anchor(plant)
    for a, b in task.points:
        plant.AddBallConstraint(
            ends[a.body], a.place.translation, ends[b.body], b.place.translation
        )
    for a, b in task.welds:
        plant.AddWeldConstraint(ends[a.body], _pose(a.place), ends[b.body], _pose(b.place))
    for a, b, distance in task.bars:
        points = ends[a.body], a.place.translation, ends[b.body], b.place.translation
        plant.AddDistanceConstraint(*points, distance)


def _add_body(plant: MultibodyPlant, parent: RigidBody, spec: Body) -> RigidBody:
    body = plant.AddRigidBody(spec.name, _inertia(spec.inertia))
    if not spec.axis.any():
        return body
    place = FixedOffsetFrame(f"at {spec.name}", parent.body_frame(), _pose(spec.place))
    frames = plant.AddFrame(place), body.body_frame()
    kind, spring = _SLIDE if spec.slides else _HINGE
    joint = plant.AddJoint(kind(spec.name, *frames, spec.axis, damping=spec.damping))
    if spec.stiffness:
        plant.AddForceElement(spring(joint, spec.rest, spec.stiffness))
    if spec.armature:
        actuator = plant.AddJointActuator(spec.name, joint)
        actuator.set_default_rotor_inertia(spec.armature)
    return body


def _inertia(spec: Any) -> SpatialInertia:
    if spec.mass == 0.0:
        return SpatialInertia.Zero()
    unit = spec.inertia / spec.mass
    moments = UnitInertia(*np.diag(unit), unit[0, 1], unit[0, 2], unit[1, 2])
    about_origin = moments.ShiftFromCenterOfMass(-spec.lever)
    return SpatialInertia(spec.mass, spec.lever, about_origin)


def _pose(place: Any) -> RigidTransform:
    return RigidTransform(RotationMatrix(place.rotation), place.translation)


def _add_anchor(plant: MultibodyPlant) -> RigidBody:
    """A body welded to the world: with the world itself in a loop AdvanceTo of 1.51 crashes."""
    inertia = SpatialInertia.SolidSphereWithMass(1.0, 0.1)  # that of a welded body says nothing
    body = plant.AddRigidBody(_ANCHOR, plant.AddModelInstance(_ANCHOR), inertia)
    plant.WeldFrames(plant.world_frame(), body.body_frame())
    return body


def _coordinates(task: Task, plant: MultibodyPlant) -> tuple[Array, Array]:
    """Where our coordinates and velocities stand in those of Drake."""
    joints = [plant.GetJointByName(body.name) for body in task.joints]
    q, v = (
        [joint.position_start() for joint in joints],
        [joint.velocity_start() for joint in joints],
    )
    if task.is_floating:
        free = plant.GetBodyByName(task.moving[0].name)
        q = [*range(free.floating_positions_start(), free.floating_positions_start() + 7), *q]
        first = free.floating_velocities_start_in_v()
        v = [*range(first, first + 6), *v]
    return np.array(q), np.array(v)


def _to_drake(task: Task) -> tuple[Array, Array]:
    """The start: Drake's free body is w, x, y, z, then its place; angular, then linear velocity.

    Both velocities are in the world.
    """
    q, v = task.q.copy(), task.v.copy()
    if task.is_floating:
        R = pin.XYZQUATToSE3(q[:7]).rotation
        q[:7] = [*q[[6, 3, 4, 5]], *q[:3]]
        v[:6] = [*R.dot(v[3:6]), *R.dot(v[:3])]
    return q, v


def _from_drake(task: Task, q: Array, v: Array) -> tuple[Array, Array]:
    if task.is_floating:
        q[:7] = [*q[4:7], *q[[1, 2, 3, 0]]]
        R = pin.XYZQUATToSE3(q[:7]).rotation
        v[:6] = [*R.T.dot(v[3:6]), *R.T.dot(v[:3])]
    return q, v
