"""Read a recorded motion with its loads, and complete joints that closed loops determine."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbd_ros.core.kinematics.poses import configuration_of
from mbd_ros.core.model.robot import Joint, Robot
from mbd_ros.core.state import NANOSECOND, Array, BodyMotion, Motion, State, WrenchSamples
from mbd_ros.core.thresholds import FOLD
from mbd_ros.errors import DataError
from mbd_ros.files.recording import Recording
from mbd_ros.jobs.arguments import about
from mbd_ros.jobs.progress import Say, progress
from mbd_ros.methods.inverse_dynamics.efforts import join_names
from mbd_ros.methods.inverse_dynamics.loop_motion import LoopMotion, Mask
from mbd_ros.methods.inverse_dynamics.torque_estimator import Observations, TorqueEstimator, Tuning
from mbd_ros.motion.derivatives import OPENSIM, Derivatives, differentiate
from mbd_ros.motion.external_loads import read_loads, wrench_at
from mbd_ros.motion.filters import causal_line, observe
from mbd_ros.motion.recordings import Source, name_of, read_motion
from mbd_ros.scene.built_scene import Scene

if TYPE_CHECKING:
    from mbd_ros.motion.external_loads import ExternalLoads
    from mbd_ros.motion.stance import StanceTask

_TIME_TOLERANCE = 0.01  # of the time step, since times of resampled motions are rounded


class Task(NamedTuple):
    """A recorded motion, and the options of inverse dynamics.

    Attributes:
        motion: Result, file or bag with the motion.
        derivatives: Source of velocities and accelerations.
        wrenches: Table or bag of the external loads of the scene. A bag that holds the motion
            holds its loads, too.
        topic: JointState topic of a bag.
        parts: Also compute the torques by cause: gravity, coriolis, inertial and external. Scenes
            with loops refuse it, since a cause alone may be out of reach of the actuators.
        bounds: Keep efforts within the limits of actuators, and forces of stops, dry friction and
            limited drives within their laws.
        external: External loads of OpenSim (.xml with its .mot), in place of those of the scene.
        time_range: First and last time that is solved [s]. Derivatives still come from the whole
            motion.
        power: Also compute the powers of joints, parts and segments, and their balance.
        stance: How unmeasured forces of contacts are found; None takes 0 for them.
        wrench_axes: Recorded axis along each axis of the scene, such as `x,z,-y`, for the loads
            of `wrenches`; `screen` takes them from X_SCREEN and Y_SCREEN of a .c3d. By default
            the axes are the same.
    """

    motion: Source
    derivatives: Derivatives = Derivatives()
    wrenches: Source | None = None
    topic: str = "/joint_states"
    parts: bool = False
    bounds: bool = False
    external: Path | None = None
    time_range: tuple[float, float] | None = None
    power: bool = False
    stance: StanceTask | None = None
    wrench_axes: str | None = None


def observe_motion(
    scene: Scene, task: Task, say: Say, external: ExternalLoads | None = None
) -> Observed:
    """Read a motion and its loads, and compute its derivatives."""
    where, derivatives = name_of(task.motion), task.derivatives
    solver = scene.inverse_dynamics()
    with about("--cutoff"):
        tuning = Tuning(cutoff=derivatives.causal_cutoff)
        estimator = TorqueEstimator(scene.robot, solver, tuning)
    recording = read_recording(scene, task, estimator.names, solver.needed, say)
    motion = recording.motion
    loads, dropped = dict[str, WrenchSamples](), Counter[str]()
    if external is None:
        loads, dropped = read_loads(scene, task.motion, task.wrenches, task.wrench_axes)
    if recording.of_laboratory and derivatives.source == "given" and motion.velocity is None:
        derivatives = derivatives._replace(source="zero-phase" if motion.bodies else OPENSIM)
        say(f"positions alone: {derivatives.source} derivatives")
    if derivatives.source == "causal":
        with np.errstate(
            over="ignore", invalid="ignore"
        ):  # samples that are not finite are reported later
            samples, cutoff = observe(estimator, motion, dropped), None
        remarks = [causal_line(estimator.differentiator, derivatives.causal_cutoff)]
    else:
        with about(where), np.errstate(over="ignore", invalid="ignore"):
            samples, cutoff, remarks = differentiate(scene, where, motion, derivatives)
    for text in remarks:
        say(text)
    for reason, count in dropped.items():
        say(f"{count} samples left out: {reason}")
    if not len(samples.stamps):
        raise DataError(f"{where}: no sample can be used")
    samples = _within(where, samples, task.time_range)
    wrenches = [wrench_at(where, name, load, samples.stamps) for name, load in loads.items()]
    if external is not None:
        wrenches = external.at(samples.stamps)
    return Observed(motion, samples, wrenches, cutoff, derivatives)


def _within(
    where: str, samples: Observations, time_range: tuple[float, float] | None
) -> Observations:
    """Return the samples within a time range, including those at its ends."""
    if time_range is None:
        return samples
    times = samples.stamps * NANOSECOND
    margin = _TIME_TOLERANCE * float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    inside = (times >= time_range[0] - margin) & (times <= time_range[1] + margin)
    if not inside.any():
        raise DataError(
            f"{where}: --time-range {time_range[0]:g} {time_range[1]:g} contains no sample; the "
            f"motion is at {times[0]:.6g} to {times[-1]:.6g} s"
        )
    return Observations(*(field[inside] for field in samples))


class Observed(NamedTuple):
    """A recorded motion, prepared for inverse dynamics.

    Attributes:
        motion: The motion as it was read.
        samples: Samples of the independent joints, with derivatives.
        wrenches: One (n, 6) array for every load of the scene.
        cutoff: Cutoff frequency of the low-pass filter of each joint [Hz]; None without filter.
        derivatives: Source of velocity and acceleration.
    """

    motion: Motion
    samples: Observations
    wrenches: list[Array]
    cutoff: Array | None
    derivatives: Derivatives


def read_recording(
    scene: Scene, task: Task, names: Sequence[str], needed: Sequence[str], say: Say
) -> Recording:
    """Read the motion and complete the joints that loops determine."""
    where = name_of(task.motion)
    bodies = {base.name: base.frame for base in scene.robot.bases}
    recording = read_motion(
        task.motion,
        names,
        topic=task.topic,
        required=needed,
        bodies=bodies,
        members=scene.robot.members,
        sliding=scene.robot.prismatic_joints,
        assumed=lambda name: float(scene.initial.q[scene.robot.joint(name).q]),
    )
    for text in _storage_lines(where, recording, scene.robot.locked):
        say(text)
    recording, remarks = close_loops(scene, where, recording)
    for text in remarks:
        say(text)
    for reason, count in recording.dropped.items():
        say(f"{where}: {count} messages left out: {reason}")
    if recording.by_log_time:
        say(f"{where}: stamps are 0, so the times of the log are used")
    return recording


def _storage_lines(where: str, recording: Recording, locked: Mapping[str, float]) -> Iterator[str]:
    """Yield remarks on a laboratory file: columns that are not used, and joints without column."""
    motion = recording.motion
    yield from (f"{where}: {text}" for text in recording.remarks)
    if recording.assumed:
        start = [motion.position[0, motion.names.index(name)] for name in recording.assumed]
        positions = [f"{n} = {q:.6g}" for n, q in zip(recording.assumed, start, strict=True)]
        remark = f"{where}: some joints have no column and stay at their initial position"
        yield f"{remark}: {', '.join(positions)}"
    unused = recording.unused or ()
    if of_locked := [label for label in unused if label in locked]:
        yield f"{where}: columns of locked joints, not used: {join_names(of_locked)}"
    if others := [label for label in unused if label not in locked]:
        yield f"{where}: columns of no joint, not used: {join_names(others)}"


def loads_of_laboratory(scene: Scene, task: Task) -> ExternalLoads | None:
    """Return the OpenSim external loads of a task, and the scene with these loads; None if none.

    Raises:
        DataError: The loads cannot be used, or the task names wrenches too.
    """
    if task.external is None:
        return None
    if task.wrenches is not None:
        raise DataError(f"--external {task.external} is not accepted together with --wrenches")
    if task.wrench_axes is not None:
        raise DataError(f"--external {task.external} is not accepted together with --wrench-axes")
    from mbd_ros.motion.external_loads import ExternalLoads  # reads XML, loads scipy

    return ExternalLoads(scene, task.external)


def close_loops(scene: Scene, where: str, recording: Recording) -> tuple[Recording, list[str]]:
    """Reconstruct independent joints that were not measured from the closed loops.

    The branch of the loops is that of the initial state of the scene, followed from sample to
    sample.

    Args:
        scene: The scene; without loops all independent joints must be measured.
        where: Source of the motion, for messages.
        recording: Motion of the independent, then the dependent joints, NaN where absent.

    Returns:
        The motion, and remarks.

    Raises:
        DataError: A joint was not measured, and no loop determines it from the others.
        SolveError: The initial state cannot be assembled.
    """
    names = scene.couplings.independent
    if not names:
        return recording, []
    position = recording.motion.position[:, : len(names)]
    is_measured = np.isfinite(position).any(axis=0)
    if not is_measured.any():
        raise DataError(f"{where}: has no position of any of {', '.join(names)}")
    complete = np.isfinite(position[:, is_measured]).all(axis=1)
    if not complete.any():
        raise DataError(f"{where}: no sample has positions of all measured joints")
    if not complete.all():
        recording.dropped["the position of a joint is missing"] += int((~complete).sum())
    motion = recording.motion if complete.all() else select_rows(recording.motion, complete)
    if is_measured.all():
        return recording._replace(motion=motion), []
    joints = [scene.robot.joint(name) for name in names]
    motion, warnings = _complete_joints(scene, where, motion, joints, is_measured)
    missing = [name for name, known in zip(names, is_measured, strict=True) if not known]
    remarks = [f"{name} is reconstructed from the loops" for name in missing]
    return recording._replace(motion=motion), remarks + warnings


def _complete_joints(
    scene: Scene, where: str, motion: Motion, joints: Sequence[Joint], is_measured: Mask
) -> tuple[Motion, list[str]]:
    """Return the motion of all independent joints, and a warning if the loops fold."""
    loops, robot, n = scene.closed_loop().motion, scene.robot, len(joints)
    measured = np.zeros(robot.model.nv, dtype=np.bool_)
    measured[[joint.v for joint, known in zip(joints, is_measured, strict=True) if known]] = True
    measured[robot.base_v] = True
    fields, indices = _fields(robot, motion, joints)
    angles = [joint.q for joint in joints if joint.kind == "continuous" and measured[joint.v]]
    fields[0][:, angles] = np.unwrap(fields[0][:, angles], axis=0)
    before, conditions = loops.assemble(scene.initial), []
    rows = zip(motion.stamps.tolist(), *fields, strict=True)
    for i, (stamp, q, v, a) in enumerate(progress(rows, len(motion.stamps), "closing")):
        x, a, condition = loops.close_loops(before, State(stamp * NANOSECOND, q, v), a, measured)
        if i == 0:
            _check_tied(where, loops, x, measured)
        before = x.q
        conditions.append(condition)
        for field, values in zip(fields, (x.q, x.v, a), strict=True):
            field[i] = values
    dependent = motion.position[:, n:]
    columns = [
        np.concatenate((field[:, index], other), axis=1)
        for field, index, other in zip(
            fields, indices, (dependent, *[dependent * np.nan] * 2), strict=True
        )
    ]
    for i, recorded in ((1, motion.velocity), (2, motion.acceleration)):
        if recorded is None:
            columns[i] = None
    completed = motion._replace(**dict(zip(motion._fields[2:5], columns, strict=True)))
    return completed, _fold_warnings(motion, conditions)


def _fields(
    robot: Robot, motion: Motion, joints: Sequence[Joint]
) -> tuple[tuple[Array, Array, Array], tuple[list[int], ...]]:
    """Return q, v and a of all coordinates, NaN where unknown, and the indices of the joints."""
    n, nq, nv = len(motion.stamps), robot.model.nq, robot.model.nv
    q, v, a = np.full((n, nq), np.nan), np.full((n, nv), np.nan), np.full((n, nv), np.nan)
    at_q, at_v = [joint.q for joint in joints], [joint.v for joint in joints]
    for field, at, values in zip((q, v, a), (at_q, at_v, at_v), motion[2:5], strict=True):
        if values is not None:
            field[:, at] = values[:, : len(joints)]
    for base, body in zip(robot.bases, motion.bodies, strict=True):
        q[:, base.q] = configuration_of(robot, body.pose)
        for field, values in ((v, body.twist), (a, body.acceleration)):
            if values is not None:
                field[:, base.v] = values
    return (q, v, a), (at_q, at_v, at_v)


def _check_tied(where: str, loops: LoopMotion, x: State, measured: Mask) -> None:
    undetermined = loops.undetermined(x, measured)
    if undetermined:
        raise DataError(
            f"{where}: has no position of {', '.join(undetermined)}, and no loop determines it "
            "from the measured joints"
        )


def _fold_warnings(motion: Motion, conditions: Sequence[float]) -> list[str]:
    worst = int(np.argmax(conditions))
    if conditions[worst] <= FOLD:
        return []
    return [
        f"the loops fold near {motion.stamps[worst] * NANOSECOND:.9g} s (condition number "
        f"{conditions[worst]:.2g}), so reconstructed joints may be on another branch from there "
        "on; measure another joint"
    ]


def select_rows(motion: Motion, rows: Mask | slice) -> Motion:
    """Return some samples of a motion."""
    return motion._replace(
        **_rows(motion, rows, {"names", "bodies"}),
        bodies=tuple(body._replace(**_rows(body, rows, {"name"})) for body in motion.bodies),
    )


def _rows(motion: Motion | BodyMotion, rows: Mask | slice, excluded: set[str]) -> dict[str, Any]:
    """Return some rows of all fields, except those excluded."""
    fields = motion._asdict().items()
    return {f: None if v is None else v[rows] for f, v in fields if f not in excluded}
