"""The motion that explains a recording best: `mbd-ros estimate`."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.contracts import Sensor
from mbd_ros.core.dynamics.output_values import Showing
from mbd_ros.core.state import NANOSECOND, Array, Motion
from mbd_ros.errors import DataError, MbdError, SceneError, SolveError
from mbd_ros.features.estimation.estimation import EFFORTS, Estimation, estimation_of
from mbd_ros.features.estimation.faults import InnovationWatch
from mbd_ros.features.estimation.task import EstimateTask
from mbd_ros.features.estimation.tracker import Tracker
from mbd_ros.features.estimation.unknowns import inner
from mbd_ros.files.table import MAIN, TIME, Column, Result, Table
from mbd_ros.files.text_file import check_place, refuse_overwriting
from mbd_ros.jobs.arguments import about
from mbd_ros.jobs.progress import Say, Watch, progress, watching
from mbd_ros.methods.estimation.kalman_filter import Filtered, KalmanFilter, lagged, smoothed
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
    """All joints of a mechanism, from what was recorded of it.

    Args:
        scene: The scene; its sensors besides what joint states carry.
        motion: Result, file or bag with positions, velocities and efforts of some joints, and
            `<sensor>` or `<sensor>.<component>` of sensors of the scene.
        task: A task, or a task file with a section `estimate`.
        wrenches: Result, file or bag of the external loads of the scene.
        topic: JointState topic of a bag.
        say: Is called with each line for people; without it the lines are
            `metadata["remarks"]`.
        progress: True for a line on a terminal, or a function of a label and a share.
        **options: Attributes of `EstimateTask`, in place of those of the task.

    Returns:
        Table `samples`: `time`, `<joint>.position`, `.velocity`, `.acceleration`, `.effort`,
        `<joint>.position_deviation`, `.velocity_deviation`, multipliers, and
        `disturbance.<joint>` with its `_deviation`. Table `innovations`: measured less predicted
        of every number over its expected deviation, nan where it was not measured, and `nis`.

    Raises:
        DataError: Something cannot be read or does not fit the scene.
        SolveError: The mechanism cannot be assembled, or its equations contradict one another.
    """
    remarks: list[str] = []
    tell = say or remarks.append
    with watching(progress):
        asked = replace(_task(scene, task), **options)
        found = run_estimate(scene, motion, asked, topic, tell, wrenches)
        tables = {
            MAIN: sample_table(found.estimation, found.samples, found.inputs),
            INNOVATIONS: innovation_table(found.estimation, found.samples),
        }
    topics = state_topics(scene.robot, ("position", "velocity"))
    given = {
        "motion": motion,
        "wrenches": wrenches,
        "task": task if isinstance(task, str | Path) else None,
        **options,
    }
    result = Result(tables, metadata_of("estimate", scene, given, topics))
    result.metadata["consistency"] = found.watch.consistency()._asdict()
    if say is None:
        result.metadata["remarks"] = remarks
    return result


def _task(scene: Scene, task: EstimateTask | str | Path) -> EstimateTask:
    if isinstance(task, EstimateTask):
        return task
    parts = read_task(task, scene).parts
    if "estimate" not in parts:
        raise SceneError(f"{task}: no section 'estimate'")
    asked: EstimateTask = parts["estimate"]
    return asked


def estimate_to(
    scene: Scene, motion: Path, out: Path, innovations: Path | None, say: Say, **options: Any
) -> None:
    """Read a recording, write the estimate, and perhaps its innovations."""
    for place in filter(None, (out, innovations)):
        refuse_overwriting(place, motion)
        check_place(place)
    result = estimate(scene, motion, say=say, progress=True, **options)
    Result({MAIN: result[MAIN]}, result.metadata).to(out)
    if innovations is not None:
        Result({MAIN: result[INNOVATIONS]}, result.metadata).to(innovations)
    say(f"{result[MAIN].rows} samples -> {out}")


class Estimated(NamedTuple):
    """What was estimated.

    Attributes:
        estimation: Scene, process and estimator.
        samples: One a sample of the recording, smoothed where that is possible.
        inputs: u before each sample.
        watch: What all innovations say.
        faults: Number of a sensor -> what was wrong with it last, and how often.
        restarts: How often the estimator began anew.
    """

    estimation: Estimation
    samples: list[Filtered]
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
) -> Estimated:
    """Do the task of `estimate`."""
    where = name_of(source)
    names = [joint.name for joint in scene.robot.joints]
    recording = read_motion(source, names, topic=topic, required=())
    for reason, count in recording.dropped.items():
        say(f"{where}: {count} messages left out: {reason}")
    motion = recording.motion
    given = [n for i, n in enumerate(names) if np.isfinite(motion.position[:, i]).any()]
    rated = _rated(motion)
    with about(where):
        estimation = estimation_of(scene, task, given, rated)
    say(f"measured: {', '.join(estimation.process.sensors.names)}")
    values = measured_values(estimation, source, motion)
    inputs = recorded_inputs(estimation, motion, wrenches, say)
    found = _filtered(estimation, motion.stamps * NANOSECOND, values, inputs, where)
    for line in _lines(found):
        say(line)
    if isinstance(estimation.estimator, KalmanFilter):
        if task.lag is None:
            after = smoothed(estimation.process, found.samples)
        else:
            after = lagged(estimation.process, found.samples, task.lag)
        samples = [
            s._replace(belief=b._replace(innovation=s.belief.innovation))
            for s, b in zip(found.samples, after, strict=True)
        ]
        found = found._replace(samples=samples)
    return found


def _rated(motion: Motion) -> list[str]:
    if motion.velocity is None:
        return []
    told = np.isfinite(motion.velocity).any(axis=0) & motion.velocity.any(axis=0)
    return [name for name, is_told in zip(motion.names, told, strict=True) if is_told]


def _filtered(
    estimation: Estimation, times: Array, values: Array, inputs: list[Array | None], where: str
) -> Estimated:
    process, estimator = estimation.process, estimation.estimator
    first = estimation.scene.initial._replace(t=float(times[0]))
    with about(where):
        y = process.near(process.consistent(first), values[0], estimation.prior)
        estimator.begin(y, estimation.prior, float(times[0]))
    tracker = Tracker(estimator, process.sensors, memory=0.0)
    tracker.watch = InnovationWatch(len(times))
    samples, faults = list[Filtered](), dict[str, tuple[str, int]]()
    for k, t in progress(enumerate(times.tolist()), len(times), "estimate"):
        try:
            with np.errstate(over="ignore", invalid="ignore"):  # the belief is looked at
                tracker.take(t, values[k], inputs[k])
        except MbdError as error:
            raise type(error)(f"{where}: at t = {t:.9g} s: {error}") from error
        belief = estimator.belief
        if not np.isfinite(belief.P).all():
            raise SolveError(f"{where}: at t = {t:.9g} s: the estimate is not finite")
        is_filter = isinstance(estimator, KalmanFilter)
        samples.append(estimator.sample if is_filter else Filtered(None, belief, belief))
        for name, what in tracker.faults.found().items():
            faults[name] = what, faults.get(name, ("", 0))[1] + 1
    return Estimated(estimation, samples, inputs, tracker.watch, faults, tracker.restarts)


def _lines(found: Estimated) -> Iterator[str]:
    consistency = found.watch.consistency()
    low, high = consistency.nis_band
    yield (
        f"innovations: mean square {consistency.nis:.4g} of what is expected, {low:.4g} .. "
        f"{high:.4g} for a right model; correlation {consistency.correlation:.3g}"
    )
    if consistency.fault:
        yield f"warning: {consistency.fault}"
    for name, (what, count) in found.faults.items():
        yield f"warning: {name}: {what} (at {count} samples)"
    if found.restarts:
        yield f"warning: the estimator began anew {found.restarts} times: nothing fitted"


def measured_values(estimation: Estimation, source: Source, motion: Motion) -> Array:
    """What was measured, NaN where nothing was, shape (samples, m).

    Args:
        estimation: Of the scene.
        source: The recording; columns `<sensor>` or `<sensor>.<component>`.

    Raises:
        DataError: Nothing of any sensor is in it.
    """
    sensors = estimation.process.sensors
    found = np.full((len(motion.stamps), sensors.m), np.nan)
    column = {name: i for i, name in enumerate(motion.names)}
    for sensor, mine in zip(sensors.sensors, sensors.slices, strict=True):
        own = _of_joints(inner(sensor), motion)
        if own is not None:
            found[:, mine.start] = own[:, column[inner(sensor).frame]]  # type: ignore[attr-defined]
            continue
        read = read_columns(source, sensors.names[mine])
        if read is not None and len(read) == len(found):
            found[:, mine] = read
    if not np.isfinite(found).any():
        raise DataError(f"{name_of(source)}: nothing of {', '.join(sensors.names)} is in it")
    return found


def _of_joints(sensor: Sensor, motion: Motion) -> Array | None:
    """The quantity of all joints that a sensor measures at one of them; None for other sensors."""
    if isinstance(sensor, Encoder):
        return motion.position
    if isinstance(sensor, Tachometer):
        return motion.velocity
    return motion.effort if isinstance(sensor, Effort) else None


def recorded_inputs(
    estimation: Estimation, motion: Motion, wrenches: Source | None, say: Say
) -> list[Array | None]:
    """Inputs before each sample: its efforts and commands act in the interval that ends there.

    The effort of a joint with a sensor of type `effort` is measured, and no input.

    Args:
        estimation: Of the scene.
        wrenches: External loads; None where none are known.
        say: Is told what is lacking.

    Raises:
        DataError: Wrenches that do not fit scene and motion.
    """
    refuse_unused(estimation.scene, wrenches)
    u = _of_drives(estimation, motion, say)
    loads = estimation.scene.wrenches
    if not loads:
        return [None] * len(motion.stamps) if u is None else list(u)
    if wrenches is None:
        say(f"unloaded: {', '.join(loads)}; --wrenches FILE brings their values")
        return [None] * len(motion.stamps) if u is None else list(u)
    if u is None:
        u = np.tile(estimation.scene.inputs.safe, (len(motion.stamps), 1))
    samples, _ = read_loads(estimation.scene, wrenches, wrenches)
    for name, one in samples.items():
        slots = estimation.scene.inputs.slots[name]
        u[:, slots] = wrench_at(name_of(wrenches), name, one, motion.stamps)
    return list(u)


def _of_drives(estimation: Estimation, motion: Motion, say: Say) -> Array | None:
    """Inputs by what drives, shape (samples, nu); None where nothing does."""
    scene, task = estimation.scene, estimation.task
    told = motion.effort if task.inputs == "efforts" else motion.command
    if task.inputs == "none":
        return None
    if told is None or not np.isfinite(told).any():
        say(f"no {task.inputs} in the recording: none are assumed")
        return None
    values = np.where(np.isfinite(told), told, 0.0)
    u = np.tile(scene.inputs.safe, (len(values), 1))
    if task.inputs == "efforts":
        felt = {one.frame for one in scene.sensors if isinstance(one, Effort)}
        is_driven = np.array([name not in felt for name in motion.names])
        u[:, scene.inputs.slots[EFFORTS]] = values * is_driven
        return u
    column = {name: i for i, name in enumerate(motion.names)}
    for part in scene.actuators:
        u[:, part.u] = values[:, [column[name] for name in part.joints]]
    return u


def sample_table(
    estimation: Estimation, samples: Sequence[Filtered], inputs: Sequence[Array | None]
) -> Table:
    """Estimated motion, what parts show in it, and deviations.

    Args:
        estimation: What was estimated.
        samples: One a sample.
        inputs: u at each of them.
    """
    process = estimation.process
    system, tangent = process.simulation.system, process.tangent
    robot, loads, nv = system.robot, system.loads, system.robot.model.nv
    showing = Showing(system.k, system.layout, loads.forces)
    t, q, v, a, effort, shown, deviation = [], [], [], [], [], [], []
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
        shown.append(showing.at(x, known, now.a, now.lam))
        of_joints = tangent.of_all_joints(belief.x)
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
            *output_columns(showing.numbers, np.array(shown)),
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
        for one in joint_columns(joints, quantity, values):
            columns.append(one._replace(name=f"{one.name}_deviation"))
    pairs = zip(system.internals.names, system.internals.units, strict=True)
    for i, (name, unit) in enumerate(pairs):
        columns.append(Column(f"{name}_deviation", deviations[:, 2 * nv + i], unit))
    return columns


def innovation_table(estimation: Estimation, samples: Sequence[Filtered]) -> Table:
    """Innovations over their expected deviation, and what they say together.

    Args:
        estimation: What was estimated.
        samples: One a sample.
    """
    names = estimation.process.sensors.names
    found = [s.belief.innovation for s in samples]
    values = np.array([np.full(len(names), np.nan) if i is None else i.normalized for i in found])
    nis = [np.nan if i is None or not i.freedom else i.squared / i.freedom for i in found]
    times = np.array([s.belief.t for s in samples])
    columns = [Column(name, values[:, i]) for i, name in enumerate(names)]
    return Table([Column(TIME, times, "s"), *columns, Column("nis", np.array(nis))])
