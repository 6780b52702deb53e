"""Preparation of a scene for an estimator: sensors, inputs, unknown efforts, noise."""

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
from mbd_ros.features.estimation.unknowns import EffortDisturbance, Unknowns, add_unknowns
from mbd_ros.methods.estimation.process import Estimator
from mbd_ros.parts.actuators.ideal import Ideal
from mbd_ros.parts.sensors.encoder import Encoder
from mbd_ros.parts.sensors.tachometer import Tachometer
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.runs.simulation import build_simulation
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.registry import resolve

EFFORTS = "efforts"  # name of the actuators that stand for measured efforts
_UNKNOWN_EFFORT = 10.0  # rad/s^2 or m/s^2: initial deviation of unknown efforts
_UNKNOWN_RATE = 100.0  # rad/s^3 or m/s^3: the same of the rates of efforts that drift


@dataclass(frozen=True)
class Estimation:
    """A scene that is prepared for an estimator.

    Attributes:
        scene: Scene with actuators for measured efforts and with disturbances.
        task: Options of the estimation.
        process: The mechanism as a process.
        estimator: Estimator that has not begun.
        scale: Efforts that accelerate each joint by 1 rad/s^2 or m/s^2, shape (nv,).
        disturbed: Joints with an unknown effort.
        deviations: Internal state to estimate -> initial standard deviation.
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
        """Slice of the unknown efforts in z, in the order of `disturbed`."""
        return _disturbance(self.scene).efforts if self.disturbed else slice(0, 0)

    @cached_property
    def parameters(self) -> dict[str, int]:
        """Number to estimate -> index in z."""
        names = self.process.simulation.system.internals.names
        return {name: names.index(name) for name in self.deviations}

    def unknown_efforts(self, x: State) -> Array:
        """Return the unknown efforts of the disturbed joints [N·m or N], (len(disturbed),).

        Args:
            x: State of all joints.
        """
        return x.z[self.disturbance]

    @property
    def prior(self) -> Array:
        """Covariance of the initial state, shape (n, n)."""
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
        lower = tangent.restriction(self.process.start)
        P: Array = (lower * np.concatenate((deviation, z)) ** 2).dot(lower.T)
        return P


def build_estimation(
    scene: Scene, task: EstimateTask, measured: Sequence[str], rated: Sequence[str]
) -> Estimation:
    """Prepare a scene for an estimator.

    Args:
        task: Options of the estimation.
        measured: Joints whose positions are in joint states.
        rated: Joints whose velocities are in joint states.

    Raises:
        SceneError: The task does not fit the scene; the message tells what is accepted.
    """
    where = f"{scene.name}: estimate"
    sensors = _sensors(scene, task, measured, rated)
    if not sensors:
        raise SceneError(
            f"{where}: nothing is measured: there are no joint states and no sensors in the scene"
        )
    system = prepare_scene(scene, task, ()).system()
    scale = effort_scale(system, scene.initial)
    joints = (
        _distinguishable_joints(system, scene)
        if task.disturbance is None
        else tuple(task.disturbance)
    )
    try:
        ready = prepare_scene(scene, task, joints)
        unknowns = add_unknowns(scene, ready, sensors, task.parameters)
        process = _process(unknowns, task, scale, joints)
        estimator = _estimator(task, process, where)
    except ModelError as error:
        raise SceneError(f"{where}: {error}") from error
    return Estimation(unknowns.scene, task, process, estimator, scale, joints, unknowns.deviations)


def _sensors(
    scene: Scene, task: EstimateTask, measured: Sequence[str], rated: Sequence[str]
) -> list[Sensor]:
    """Return the sensors of the scene, and sensors for what joint states contain in addition."""
    sensors = list(scene.sensors)
    measured_joints = {
        type(s): {x.joint.name for x in sensors if type(x) is type(s)}
        for s in sensors
        if isinstance(s, Encoder | Tachometer)
    }
    for name in measured:
        if name not in measured_joints.get(Encoder, ()):
            part: Sensor = Encoder(scene.robot, joint=name, noise=task.position_noise)
            part.name = f"{name}.position"
            sensors.append(part)
    for name in rated:
        if name not in measured_joints.get(Tachometer, ()):
            part = Tachometer(scene.robot, joint=name, noise=task.velocity_noise)
            part.name = f"{name}.velocity"
            sensors.append(part)
    return sensors


def prepare_scene(scene: Scene, task: EstimateTask, disturbed: Sequence[str]) -> Scene:
    """Return the scene with actuators for measured efforts, and with unknown efforts.

    Args:
        scene: The scene as it was read.
        task: Options of the estimation.
        disturbed: Joints with an unknown effort.

    Raises:
        ModelError: A joint is unknown.
    """
    return _with_disturbances(_with_measured_efforts(scene, task), disturbed, task.drifting)


def _with_disturbances(scene: Scene, joints: Sequence[str], drifting: bool) -> Scene:
    if not joints:
        return scene
    part = EffortDisturbance(scene.robot, joints, drifting=drifting)
    return scene.holding(forces=(*scene.parts.get("forces", ()), part))


def _with_measured_efforts(scene: Scene, task: EstimateTask) -> Scene:
    """Return the scene with efforts as inputs, if these are measured."""
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
    """Return the efforts that accelerate each joint alone by 1 rad/s^2 or m/s^2, (nv,)."""
    M = pin.crba(system.robot.model, system.robot.model.createData(), x.q)
    return np.array(np.diag(M))


def _distinguishable_joints(system: System, scene: Scene) -> tuple[str, ...]:
    """Return joints whose efforts have independent effects, as many as degrees of freedom."""
    y = system.reduce(scene.initial)
    respond = system.evaluate(scene.initial, None).respond(np.eye(system.robot.model.nv))
    moved = system.integrated(respond)
    joints, chosen, remainder = scene.robot.joints, list[str](), moved.copy()
    floor = FIXED_BY_OTHERS * float(np.linalg.norm(moved, axis=0).max(initial=0.0))
    for _ in range(len(y.v)):
        sizes = {j.name: float(np.linalg.norm(remainder[:, j.v])) for j in joints}
        name = max(sizes, key=lambda joint: sizes[joint])
        if not sizes[name] > max(floor, math.sqrt(np.finfo(float).eps) * floor):
            break
        column = remainder[:, scene.robot.joint(name).v] / sizes[name]
        remainder = remainder - np.outer(column, column.dot(remainder))
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
