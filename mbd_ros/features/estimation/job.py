"""Estimation of the motion of a mechanism from a recording: `mbd-ros estimate`."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.contracts import Sensor
from mbd_ros.core.dynamics.output_values import Showing
from mbd_ros.core.state import NANOSECOND, Array, Motion
from mbd_ros.errors import DataError, MbdError, SceneError, SolveError
from mbd_ros.features.estimation.estimation import EFFORTS, Estimation, build_estimation
from mbd_ros.features.estimation.faults import InnovationWatch
from mbd_ros.features.estimation.task import EstimateTask
from mbd_ros.features.estimation.tracker import Tracker
from mbd_ros.features.estimation.unknowns import scene_sensor
from mbd_ros.files.table import MAIN, TIME, Column, Result, Table
from mbd_ros.files.text_file import check_place, refuse_overwriting
from mbd_ros.jobs.arguments import about
from mbd_ros.jobs.progress import Say, Watch, progress, watching
from mbd_ros.methods.estimation.kalman_filter import (
    FilterSample,
    KalmanFilter,
    smooth,
    smooth_with_lag,
)
from mbd_ros.motion.columns import (
    body_columns,
    joint_columns,
    output_columns,
    state_topics,
    whole_bodies,
)
from mbd_ros.motion.external_loads import read_loads, refuse_unused, wrench_at
from mbd_ros.motion.recordings import Source, metadata_of, name_of, read_columns, read_motion
from mbd_ros.parts.sensors.effort import Effort
from mbd_ros.parts.sensors.encoder import Encoder
from mbd_ros.parts.sensors.tachometer import Tachometer
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.task_reader import read_task

INNOVATIONS = "innovations"
NO_TASK = EstimateTask()


def estimate(
    scene: Scene,
    motion: Source,
    *,
    task: EstimateTask | str | Path = NO_TASK,
    wrenches: Source | None = None,
    topic: str = "/joint_states",
    say: Say | None = None,
    progress: Watch = False,
    **options: Any,
) -> Result:
    """Estimate the motion of all joints of a mechanism from a recording.

    Args:
        scene: The scene, with its sensors apart from those for joint states.
        motion: Result, file or bag with positions, velocities and efforts of some joints, and
            columns `<sensor>` or `<sensor>.<component>` of sensors of the scene.
        task: A task, or a task file with a section `estimate`.
        wrenches: Result, file or bag with the external loads of the scene.
        topic: JointState topic of a bag.
        say: Function that is called with each line for people; without it the lines are
            `metadata["remarks"]`.
        progress: True for a progress line on a terminal, or a function of a label and a share.
        **options: Attributes of `EstimateTask` that replace those of the task.

    Returns:
        Table `samples`: `time`, `<joint>.position`, `.velocity`, `.acceleration`, `.effort`,
        `<joint>.position_deviation`, `.velocity_deviation`, multipliers, and
        `disturbance.<joint>` with its `_deviation`. Table `innovations`: measured minus predicted
        values over their expected deviation, NaN where nothing was measured, and `nis`.

    Raises:
        DataError: A file cannot be read or does not fit the scene.
        SolveError: The loops cannot be closed, or the equations are inconsistent.
    """
    remarks: list[str] = []
    tell = say or remarks.append
    with watching(progress):
        estimate_task = replace(_task(scene, task), **options)
        outcome = run_estimate(scene, motion, estimate_task, topic, tell, wrenches)
        tables = {
            MAIN: sample_table(outcome.estimation, outcome.samples, outcome.inputs),
            INNOVATIONS: innovation_table(outcome.estimation, outcome.samples),
        }
    topics = state_topics(scene.robot, ("position", "velocity"))
    sources = {
        "motion": motion,
        "wrenches": wrenches,
        "task": task if isinstance(task, str | Path) else None,
        **options,
    }
    result = Result(tables, metadata_of("estimate", scene, sources, topics))
    result.metadata["consistency"] = outcome.watch.consistency()._asdict()
    if say is None:
        result.metadata["remarks"] = remarks
    return result


def _task(scene: Scene, task: EstimateTask | str | Path) -> EstimateTask:
    if isinstance(task, EstimateTask):
        return task
    parts = read_task(task, scene).parts
    if "estimate" not in parts:
        raise SceneError(f"{task}: the task file has no section 'estimate'")
    section: EstimateTask = parts["estimate"]
    return section


def estimate_to(
    scene: Scene, motion: Path, out: Path, innovations: Path | None, say: Say, **options: Any
) -> None:
    """Estimate a motion, and write it and optionally its innovations."""
    for place in filter(None, (out, innovations)):
        refuse_overwriting(place, motion)
        check_place(place)
    result = estimate(scene, motion, say=say, progress=True, **options)
    Result({MAIN: result[MAIN]}, result.metadata).to(out)
    if innovations is not None:
        Result({MAIN: result[INNOVATIONS]}, result.metadata).to(innovations)
    say(f"{result[MAIN].rows} samples -> {out}")


class EstimationResult(NamedTuple):
    """Result of an estimation.

    Attributes:
        estimation: Scene, process and estimator.
        samples: One per sample of the recording, smoothed where the estimator can.
        inputs: u before each sample.
        watch: Statistics of all innovations.
        faults: Sensor -> its last fault, and the number of samples with it.
        restarts: Number of restarts of the estimator.
    """

    estimation: Estimation
    samples: list[FilterSample]
    inputs: list[Array | None]
    watch: InnovationWatch
    faults: dict[str, tuple[str, int]]
    restarts: int


def run_estimate(
    scene: Scene,
    source: Source,
    task: EstimateTask,
    topic: str,
    say: Say,
    wrenches: Source | None = None,
) -> EstimationResult:
    """Estimate as a task says."""
    where = name_of(source)
    names = [joint.name for joint in scene.robot.joints]
    recording = read_motion(source, names, topic=topic, required=())
    for reason, count in recording.dropped.items():
        say(f"{where}: {count} messages were left out: {reason}")
    motion = recording.motion
    measured = [n for i, n in enumerate(names) if np.isfinite(motion.position[:, i]).any()]
    rated = _joints_with_velocity(motion)
    with about(where):
        estimation = build_estimation(scene, task, measured, rated)
    say(f"measured: {', '.join(estimation.process.sensors.names)}")
    values = collect_measurements(estimation, source, motion)
    inputs = collect_inputs(estimation, motion, wrenches, say)
    outcome = _filter(estimation, motion.stamps * NANOSECOND, values, inputs, where)
    for line in _summary(outcome):
        say(line)
    if isinstance(estimation.estimator, KalmanFilter):
        if task.lag is None:
            beliefs = smooth(estimation.process, outcome.samples)
        else:
            beliefs = smooth_with_lag(estimation.process, outcome.samples, task.lag)
        samples = [
            s._replace(belief=b._replace(innovation=s.belief.innovation))
            for s, b in zip(outcome.samples, beliefs, strict=True)
        ]
        outcome = outcome._replace(samples=samples)
    return outcome


def _joints_with_velocity(motion: Motion) -> list[str]:
    """Return the joints with a measured velocity that is not always 0."""
    if motion.velocity is None:
        return []
    has_velocity = np.isfinite(motion.velocity).any(axis=0) & motion.velocity.any(axis=0)
    return [name for name, has in zip(motion.names, has_velocity, strict=True) if has]


def _filter(
    estimation: Estimation, times: Array, values: Array, inputs: list[Array | None], where: str
) -> EstimationResult:
    process, estimator = estimation.process, estimation.estimator
    first = estimation.scene.initial._replace(t=float(times[0]))
    with about(where):
        y = process.fit_state(process.consistent(first), values[0], estimation.prior)
        estimator.begin(y, estimation.prior, float(times[0]))
    tracker = Tracker(estimator, process.sensors, memory=0.0)
    tracker.watch = InnovationWatch(len(times))
    samples, faults = list[FilterSample](), dict[str, tuple[str, int]]()
    for k, t in progress(enumerate(times.tolist()), len(times), "estimate"):
        try:
            with np.errstate(over="ignore", invalid="ignore"):  # the belief is checked below
                tracker.add_sample(t, values[k], inputs[k])
        except MbdError as error:
            raise type(error)(f"{where}: at t = {t:.9g} s: {error}") from error
        belief = estimator.belief
        if not np.isfinite(belief.P).all():
            raise SolveError(f"{where}: at t = {t:.9g} s: the estimate is not finite")
        is_filter = isinstance(estimator, KalmanFilter)
        samples.append(estimator.sample if is_filter else FilterSample(None, belief, belief))
        for name, fault in tracker.faults.active_faults().items():
            faults[name] = fault, faults.get(name, ("", 0))[1] + 1
    return EstimationResult(estimation, samples, inputs, tracker.watch, faults, tracker.restarts)


def _summary(outcome: EstimationResult) -> Iterator[str]:
    """Yield lines about the innovations and faults."""
    consistency = outcome.watch.consistency()
    low, high = consistency.nis_band
    yield (
        f"innovations: mean square {consistency.nis:.4g} of its expected value, {low:.4g} .. "
        f"{high:.4g} for a right model; correlation {consistency.correlation:.3g}"
    )
    if consistency.fault:
        yield f"warning: {consistency.fault}"
    for name, (what, count) in outcome.faults.items():
        yield f"warning: {name}: {what} (at {count} samples)"
    if outcome.restarts:
        yield f"warning: the estimator restarted {outcome.restarts} times, since nothing fitted"


def collect_measurements(estimation: Estimation, source: Source, motion: Motion) -> Array:
    """Return the measured values, NaN where there are none, shape (samples, m).

    Args:
        estimation: The prepared scene.
        source: The recording, with columns `<sensor>` or `<sensor>.<component>`.

    Raises:
        DataError: The recording has no value of any sensor.
    """
    sensors = estimation.process.sensors
    values = np.full((len(motion.stamps), sensors.m), np.nan)
    column = {name: i for i, name in enumerate(motion.names)}
    for sensor, columns in zip(sensors.sensors, sensors.slices, strict=True):
        quantity = _joint_quantity(scene_sensor(sensor), motion)
        if quantity is not None:
            joint = scene_sensor(sensor).frame  # type: ignore[attr-defined]
            values[:, columns.start] = quantity[:, column[joint]]
            continue
        read = read_columns(source, sensors.names[columns])
        if read is not None and len(read) == len(values):
            values[:, columns] = read
    if not np.isfinite(values).any():
        names = ", ".join(sensors.names)
        raise DataError(f"{name_of(source)}: the recording has no value of any of {names}")
    return values


def _joint_quantity(sensor: Sensor, motion: Motion) -> Array | None:
    """Return the quantity of all joints of which a sensor measures one; None for others."""
    if isinstance(sensor, Encoder):
        return motion.position
    if isinstance(sensor, Tachometer):
        return motion.velocity
    return motion.effort if isinstance(sensor, Effort) else None


def collect_inputs(
    estimation: Estimation, motion: Motion, wrenches: Source | None, say: Say
) -> list[Array | None]:
    """Return the inputs before each sample; they act in the interval that ends there.

    The effort of a joint with a sensor of type `effort` is a measurement, and no input.

    Args:
        estimation: The prepared scene.
        wrenches: External loads; None if there are none.
        say: Receives a line for each missing input.

    Raises:
        DataError: Wrenches do not fit scene and motion.
    """
    refuse_unused(estimation.scene, wrenches)
    u = _drive_inputs(estimation, motion, say)
    loads = estimation.scene.wrenches
    if not loads:
        return [None] * len(motion.stamps) if u is None else list(u)
    if wrenches is None:
        say(f"zero loads are assumed for {', '.join(loads)}; give their values by --wrenches FILE")
        return [None] * len(motion.stamps) if u is None else list(u)
    if u is None:
        u = np.tile(estimation.scene.inputs.safe, (len(motion.stamps), 1))
    samples, _ = read_loads(estimation.scene, wrenches, wrenches)
    for name, load in samples.items():
        slots = estimation.scene.inputs.slots[name]
        u[:, slots] = wrench_at(name_of(wrenches), name, load, motion.stamps)
    return list(u)


def _drive_inputs(estimation: Estimation, motion: Motion, say: Say) -> Array | None:
    """Return the inputs of drives, shape (samples, nu); None where nothing drives."""
    scene, task = estimation.scene, estimation.task
    recorded = motion.effort if task.inputs == "efforts" else motion.command
    if task.inputs == "none":
        return None
    if recorded is None or not np.isfinite(recorded).any():
        say(f"there are no {task.inputs} in the recording; zeros are assumed")
        return None
    values = np.where(np.isfinite(recorded), recorded, 0.0)
    u = np.tile(scene.inputs.safe, (len(values), 1))
    if task.inputs == "efforts":
        measured = {sensor.frame for sensor in scene.sensors if isinstance(sensor, Effort)}
        is_driven = np.array([name not in measured for name in motion.names])
        u[:, scene.inputs.slots[EFFORTS]] = values * is_driven
        return u
    column = {name: i for i, name in enumerate(motion.names)}
    for part in scene.actuators:
        u[:, part.u] = values[:, [column[name] for name in part.joints]]
    return u


def sample_table(
    estimation: Estimation, samples: Sequence[FilterSample], inputs: Sequence[Array | None]
) -> Table:
    """Return a table of the estimated motion, outputs of parts, and deviations.

    Args:
        estimation: The prepared scene.
        samples: Estimates.
        inputs: u at each of them.
    """
    process = estimation.process
    system, tangent = process.simulation.system, process.tangent
    robot, loads, nv = system.robot, system.loads, system.robot.model.nv
    showing = Showing(system.k, system.layout, loads.forces)
    t, q, v, a, effort, outputs, deviation = [], [], [], [], [], [], []
    for sample, u in zip(samples, inputs, strict=True):
        belief = sample.belief
        x = system.expand(belief.x)
        now = process.evaluate(x, u)
        known = loads.inputs(x, u)
        t.append(belief.t)
        q.append(x.q)
        v.append(x.v)
        a.append(now.a)
        effort.append(loads.actuator_torque(system.k, x, known))
        outputs.append(showing.at(x, known, now.a, now.lam))
        of_joints = tangent.lift_to_joints(belief.x)
        spread = np.einsum("ij,jk,ik->i", of_joints, belief.P, of_joints)
        z = belief.P.diagonal()[len(belief.P) - len(x.z) :]
        deviation.append(np.sqrt(np.maximum(np.concatenate((spread, z)), 0.0)))
    joints = robot.joints
    q_at, v_at = [j.q for j in joints], [j.v for j in joints]
    every = np.array(v), np.array(a), np.array(effort), np.array(deviation)
    v_all, a_all, efforts, deviations = every
    q_all = np.array(q)
    return Table(
        [
            Column(TIME, np.array(t), "s"),
            *joint_columns(joints, "position", q_all[:, q_at]),
            *joint_columns(joints, "velocity", v_all[:, v_at]),
            *joint_columns(joints, "acceleration", a_all[:, v_at]),
            *joint_columns(joints, "effort", efforts[:, v_at]),
            *body_columns(robot, whole_bodies(robot, q_all, v_all, a_all)),
            *output_columns(showing.numbers, np.array(outputs)),
            *_deviations(estimation, deviations, nv, v_at),
        ]
    )


def _deviations(
    estimation: Estimation, deviations: Array, nv: int, v_at: list[int]
) -> list[Column]:
    system = estimation.process.simulation.system
    joints = system.robot.joints
    columns = []
    for quantity, values in (
        ("position", deviations[:, v_at]),
        ("velocity", deviations[:, nv : 2 * nv][:, v_at]),
    ):
        for column in joint_columns(joints, quantity, values):
            columns.append(column._replace(name=f"{column.name}_deviation"))
    pairs = zip(system.internals.names, system.internals.units, strict=True)
    for i, (name, unit) in enumerate(pairs):
        columns.append(Column(f"{name}_deviation", deviations[:, 2 * nv + i], unit))
    return columns


def innovation_table(estimation: Estimation, samples: Sequence[FilterSample]) -> Table:
    """Return a table of innovations over their expected deviation, and of their NIS.

    Args:
        estimation: The prepared scene.
        samples: Estimates.
    """
    names = estimation.process.sensors.names
    innovations = [s.belief.innovation for s in samples]
    values = np.array(
        [np.full(len(names), np.nan) if i is None else i.normalized for i in innovations]
    )
    nis = [np.nan if i is None or not i.freedom else i.squared / i.freedom for i in innovations]
    times = np.array([s.belief.t for s in samples])
    columns = [Column(name, values[:, i]) for i, name in enumerate(names)]
    return Table([Column(TIME, times, "s"), *columns, Column("nis", np.array(nis))])
