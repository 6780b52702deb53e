"""Samples that inverse dynamics is asked at, with joints that loops close."""

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

_NEAR = 0.01  # steps of the motion: times that were resampled are a little off


class Task(NamedTuple):
    """A recorded motion, and what inverse dynamics shall make of it.

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
    """Read a motion and its loads, and give it derivatives."""
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
        with np.errstate(over="ignore", invalid="ignore"):  # the results are looked at
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
    """The samples of a time, those at its ends among them."""
    if time_range is None:
        return samples
    times = samples.stamps * NANOSECOND
    margin = _NEAR * float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    inside = (times >= time_range[0] - margin) & (times <= time_range[1] + margin)
    if not inside.any():
        raise DataError(
            f"{where}: --time-range {time_range[0]:g} {time_range[1]:g}: no sample is there, the "
            f"motion is at {times[0]:.6g} to {times[-1]:.6g} s"
        )
    return Observations(*(field[inside] for field in samples))


class Observed(NamedTuple):
    """What is solved.

    Attributes:
        motion: As it was read.
        samples: Of the independent joints, with derivatives.
        wrenches: One (n, 6) array for every load of the scene.
        cutoff: Of the low-pass of each joint [Hz]; None without one.
        derivatives: Where velocity and acceleration came from.
    """

    motion: Motion
    samples: Observations
    wrenches: list[Array]
    cutoff: Array | None
    derivatives: Derivatives


def read_recording(
    scene: Scene, task: Task, names: Sequence[str], needed: Sequence[str], say: Say
) -> Recording:
    """The motion, with what loops give of it."""
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
        say(f"{where}: stamps are 0, the times of the log are used")
    return recording


def _storage_lines(where: str, recording: Recording, locked: Mapping[str, float]) -> Iterator[str]:
    """What a storage of a laboratory has besides joints, and which of them it lacks."""
    motion = recording.motion
    yield from (f"{where}: {text}" for text in recording.remarks)
    if recording.assumed:
        start = [motion.position[0, motion.names.index(name)] for name in recording.assumed]
        there = [f"{n} = {q:.6g}" for n, q in zip(recording.assumed, start, strict=True)]
        said = f"{where}: no column of some joints, they stay where the scene starts"
        yield f"{said}: {', '.join(there)}"
    unused = recording.unused or ()
    if held := [label for label in unused if label in locked]:
        yield f"{where}: columns of joints that the model locks, not used: {join_names(held)}"
    if others := [label for label in unused if label not in locked]:
        yield f"{where}: columns of no joint, not used: {join_names(others)}"


def loads_of_laboratory(scene: Scene, task: Task) -> ExternalLoads | None:
    """The external loads that a motion names, and the scene that carries them; None without.

    Raises:
        DataError: As `ExternalLoads`, or wrenches beside them.
    """
    if task.external is None:
        return None
    if task.wrenches is not None:
        raise DataError(f"--external {task.external}: --wrenches gives the loads already")
    if task.wrench_axes is not None:
        raise DataError(f"--external {task.external}: --wrench-axes turns --wrenches alone")
    from mbd_ros.motion.external_loads import ExternalLoads  # reads XML, loads scipy

    return ExternalLoads(scene, task.external)


def close_loops(scene: Scene, where: str, recording: Recording) -> tuple[Recording, list[str]]:
    """A motion in which the loops have given the independent joints that nobody measured.

    Their branch is that of the initial state of the scene, followed from sample to sample.

    Args:
        scene: The scene; one without loops has all independent joints measured.
        where: Source of the motion, for the messages.
        recording: Motion of the independent, then the dependent joints, NaN where absent.

    Returns:
        The motion, and remarks.

    Raises:
        DataError: The motion lacks a joint that no loop ties to the others.
        SolveError: The initial state cannot be assembled.
    """
    names = scene.couplings.independent
    if not names:
        return recording, []
    position = recording.motion.position[:, : len(names)]
    is_there = np.isfinite(position).any(axis=0)
    if not is_there.any():
        raise DataError(f"{where}: no position of any of {', '.join(names)}")
    whole = np.isfinite(position[:, is_there]).all(axis=1)
    if not whole.any():
        raise DataError(f"{where}: no sample has all of its joints")
    if not whole.all():
        recording.dropped["the position of a joint is missing"] += int((~whole).sum())
    motion = recording.motion if whole.all() else kept_rows(recording.motion, whole)
    if is_there.all():
        return recording._replace(motion=motion), []
    joints = [scene.robot.joint(name) for name in names]
    motion, fold = _completed(scene, where, motion, joints, is_there)
    lacking = [name for name, there in zip(names, is_there, strict=True) if not there]
    said = [f"{name} is reconstructed from the loops" for name in lacking]
    return recording._replace(motion=motion), said + fold


def _completed(
    scene: Scene, where: str, motion: Motion, joints: Sequence[Joint], is_there: Mask
) -> tuple[Motion, list[str]]:
    """The motion with the independent joints that lack in it, and where its loops fold."""
    loops, robot, n = scene.closed_loop().motion, scene.robot, len(joints)
    measured = np.zeros(robot.model.nv, dtype=np.bool_)
    measured[[joint.v for joint, there in zip(joints, is_there, strict=True) if there]] = True
    measured[robot.base_v] = True
    fields, places = _fields(robot, motion, joints)
    turning = [joint.q for joint in joints if joint.kind == "continuous" and measured[joint.v]]
    fields[0][:, turning] = np.unwrap(fields[0][:, turning], axis=0)
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
        np.concatenate((field[:, at], other), axis=1)
        for field, at, other in zip(
            fields, places, (dependent, *[dependent * np.nan] * 2), strict=True
        )
    ]
    for i, given in ((1, motion.velocity), (2, motion.acceleration)):
        if given is None:
            columns[i] = None
    whole = motion._replace(**dict(zip(motion._fields[2:5], columns, strict=True)))
    return whole, _folds(motion, conditions)


def _fields(
    robot: Robot, motion: Motion, joints: Sequence[Joint]
) -> tuple[tuple[Array, Array, Array], tuple[list[int], ...]]:
    """q, v and a of all coordinates, NaN where unknown, and where the joints stand in them."""
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
    loose = loops.undetermined(x, measured)
    if loose:
        raise DataError(
            f"{where}: no position of {', '.join(loose)}, and no loop gives it from the joints "
            "that are there"
        )


def _folds(motion: Motion, conditions: Sequence[float]) -> list[str]:
    worst = int(np.argmax(conditions))
    if conditions[worst] <= FOLD:
        return []
    return [
        f"the loops fold near {motion.stamps[worst] * NANOSECOND:.9g} s (condition number "
        f"{conditions[worst]:.2g}): from there on what is reconstructed may be on another branch; "
        "another joint should be measured"
    ]


def kept_rows(motion: Motion, rows: Mask | slice) -> Motion:
    """Some samples of a motion."""
    return motion._replace(
        **_rows(motion, rows, {"names", "bodies"}),
        bodies=tuple(body._replace(**_rows(body, rows, {"name"})) for body in motion.bodies),
    )


def _rows(whole: Motion | BodyMotion, rows: Mask | slice, others: set[str]) -> dict[str, Any]:
    """Some rows of all fields but others."""
    fields = whole._asdict().items()
    return {f: None if v is None else v[rows] for f, v in fields if f not in others}
