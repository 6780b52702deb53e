"""A scene made ready for an estimator: sensors, inputs, unknown efforts, noise."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from mbd_ros.core.contracts import Sensor
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import FIXED_BY_OTHERS
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.features.estimation.mechanism_process import MechanismProcess
from mbd_ros.features.estimation.task import EstimateTask
from mbd_ros.features.estimation.unknowns import EffortDisturbance, Unknowns, with_unknowns
from mbd_ros.methods.estimation.process import Estimator
from mbd_ros.parts.actuators.ideal import Ideal
from mbd_ros.parts.sensors.encoder import Encoder
from mbd_ros.parts.sensors.tachometer import Tachometer
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.runs.simulation import build_simulation
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.registry import resolve

EFFORTS = "efforts"  # name of the loads that measured efforts are
_UNKNOWN_EFFORT = 10.0  # rad/s^2 or m/s^2, of unknown efforts at the start
_UNKNOWN_RATE = 100.0  # rad/s^3 or m/s^3, of the rates of those that drift


@dataclass(frozen=True)
class Estimation:
    """A scene made ready for an estimator.

    Attributes:
        scene: With what stands for measured efforts and disturbances.
        task: What was asked.
        estimator: Has not begun.
        scale: Efforts that accelerate each joint by 1 rad/s^2 or m/s^2, shape (nv,).
        disturbed: Joints with an unknown effort.
        deviations: Internal state that is estimated -> its deviation at the start.
    """

    scene: Scene
    task: EstimateTask
    process: MechanismProcess
    estimator: Estimator
    scale: Array
    disturbed: tuple[str, ...]
    deviations: Mapping[str, float]

    @cached_property
    def disturbance(self) -> slice:
        """Where the unknown efforts stand in z, in the order of `disturbed`."""
        return _disturbance(self.scene).efforts if self.disturbed else slice(0, 0)

    @cached_property
    def parameters(self) -> dict[str, int]:
        """Numbers that are estimated -> where each stands in z."""
        names = self.process.simulation.system.internals.names
        return {name: names.index(name) for name in self.deviations}

    def unknown_efforts(self, x: State) -> Array:
        """Of the disturbed joints [N·m or N], shape (len(disturbed),).

        Args:
            x: State of all joints.
        """
        return x.z[self.disturbance]

    @property
    def prior(self) -> Array:
        """Covariance of the first state, shape (n, n)."""
        task, tangent = self.task, self.process.tangent
        nz = len(self.process.start.z)
        nv = self.process.simulation.system.nv
        deviation = np.concatenate(
            (np.full(nv, task.position_deviation), np.full(nv, task.velocity_deviation))
        )
        z = np.zeros(nz)
        at = [self.scene.robot.joint(name).v for name in self.disturbed]
        z[self.disturbance] = _UNKNOWN_EFFORT * self.scale[at]
        if self.disturbed and task.drifting:
            part = _disturbance(self.scene)
            z[part.efforts.stop : part.z.stop] = _UNKNOWN_RATE * self.scale[at]
        z[list(self.parameters.values())] = list(self.deviations.values())
        lower = tangent.lowered(self.process.start)
        P: Array = (lower * np.concatenate((deviation, z)) ** 2).dot(lower.T)
        return P


def estimation_of(
    scene: Scene, task: EstimateTask, measured: Sequence[str], rated: Sequence[str]
) -> Estimation:
    """Make a scene ready for an estimator.

    Args:
        task: What is asked.
        measured: Joints whose positions come with joint states.
        rated: Joints whose velocities do.

    Raises:
        SceneError: Names what is wrong and what is accepted.
    """
    where = f"{scene.name}: estimate"
    sensors = _sensors(scene, task, measured, rated)
    if not sensors:
        raise SceneError(f"{where}: nothing is measured: neither joint states nor sensors")
    system = made_ready(scene, task, ()).system()
    scale = effort_scale(system, scene.initial)
    joints = _told_apart(system, scene) if task.disturbance is None else tuple(task.disturbance)
    try:
        ready = made_ready(scene, task, joints)
        unknowns = with_unknowns(scene, ready, sensors, task.parameters)
        process = _process(unknowns, task, scale, joints)
        estimator = _estimator(task, process, where)
    except ModelError as error:
        raise SceneError(f"{where}: {error}") from error
    return Estimation(unknowns.scene, task, process, estimator, scale, joints, unknowns.deviations)


def _sensors(
    scene: Scene, task: EstimateTask, measured: Sequence[str], rated: Sequence[str]
) -> list[Sensor]:
    """Those of the scene, and what joint states carry besides."""
    found = list(scene.sensors)
    own = {
        type(s): {x.joint.name for x in found if type(x) is type(s)}
        for s in found
        if isinstance(s, Encoder | Tachometer)
    }
    for name in measured:
        if name not in own.get(Encoder, ()):
            part: Sensor = Encoder(scene.robot, joint=name, noise=task.position_noise)
            part.name = f"{name}.position"
            found.append(part)
    for name in rated:
        if name not in own.get(Tachometer, ()):
            part = Tachometer(scene.robot, joint=name, noise=task.velocity_noise)
            part.name = f"{name}.velocity"
            found.append(part)
    return found


def made_ready(scene: Scene, task: EstimateTask, disturbed: Sequence[str]) -> Scene:
    """The scene with what stands for measured efforts and unknown ones.

    Args:
        scene: As it is read.
        task: What is asked.
        disturbed: Joints with an unknown effort.

    Raises:
        ModelError: Unknown joint.
    """
    return _disturbed(_driven(scene, task), disturbed, task.drifting)


def _disturbed(scene: Scene, joints: Sequence[str], drifting: bool) -> Scene:
    if not joints:
        return scene
    part = EffortDisturbance(scene.robot, joints, drifting=drifting)
    return scene.holding(forces=(*scene.parts.get("forces", ()), part))


def _driven(scene: Scene, task: EstimateTask) -> Scene:
    """The scene with efforts as inputs, where these are measured."""
    if task.inputs == "commands":
        return scene
    scene = scene.without(("actuators", "muscles"))
    if task.inputs == "none":
        return scene
    names = [joint.name for joint in scene.robot.joints]
    efforts = Ideal(scene.robot, joints=names)
    efforts.name = EFFORTS
    return scene.holding(actuators=(efforts,))


def effort_scale(system: System, x: State) -> Array:
    """Efforts that accelerate each joint alone by 1 rad/s^2 or m/s^2, shape (nv of the robot,)."""
    M = pin.crba(system.robot.model, system.robot.model.createData(), x.q)
    return np.array(np.diag(M))


def _told_apart(system: System, scene: Scene) -> tuple[str, ...]:
    """Joints whose efforts move the mechanism in different ways: as many as it can move in."""
    y = system.reduce(scene.initial)
    respond = system.evaluate(scene.initial, None).respond(np.eye(system.robot.model.nv))
    moved = system.integrated(respond)
    joints, chosen, rest = scene.robot.joints, list[str](), moved.copy()
    floor = FIXED_BY_OTHERS * float(np.linalg.norm(moved, axis=0).max(initial=0.0))
    for _ in range(len(y.v)):
        sizes = {j.name: float(np.linalg.norm(rest[:, j.v])) for j in joints}
        name = max(sizes, key=lambda one: sizes[one])
        if not sizes[name] > max(floor, math.sqrt(np.finfo(float).eps) * floor):
            break
        column = rest[:, scene.robot.joint(name).v] / sizes[name]
        rest = rest - np.outer(column, column.dot(rest))
        chosen.append(name)
    return tuple(j.name for j in joints if j.name in chosen)


def _process(
    unknowns: Unknowns, task: EstimateTask, scale: Array, joints: Sequence[str]
) -> MechanismProcess:
    scene = unknowns.scene
    simulation = build_simulation(scene)
    internals = simulation.system.internals
    noise, sizes = np.zeros(internals.nz), np.ones(internals.nz)
    if joints:
        at = [scene.robot.joint(name).v for name in joints]
        part = _disturbance(scene)
        sizes[part.z] = np.inf
        driven = slice(part.z.stop - len(joints), part.z.stop)
        noise[driven] = task.disturbance_noise * scale[at]
    for name, deviation in unknowns.deviations.items():
        sizes[internals.names.index(name)] = deviation
        noise[internals.names.index(name)] = deviation / math.sqrt(task.parameter_time)
    return MechanismProcess(
        simulation,
        unknowns.sensors,
        scene.initial,
        task.model_noise * scale,
        noise,
        masses=unknowns.masses,
        internal_sizes=sizes,
        limits=task.limits,
    )


def _disturbance(scene: Scene) -> EffortDisturbance:
    return next(part for part in scene.forces if isinstance(part, EffortDisturbance))


def _estimator(task: EstimateTask, process: MechanismProcess, where: str) -> Estimator:
    entry = dict(task.estimator)
    kind = resolve("estimators", entry.pop("type", "extended_kalman"), f"{where}.estimator")
    estimator: Estimator = schema.call(kind, entry, f"{where}.estimator", process)
    return estimator
