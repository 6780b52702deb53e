"""A recorded motion with its loads, which is the guess and the reference of a prediction."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.kinematics.poses import configuration_of
from mbd_ros.core.state import NANOSECOND, Array, Motion, have_same_bits
from mbd_ros.errors import DataError, SceneError
from mbd_ros.features.prediction.modes import DrivenScene, driving_wrenches
from mbd_ros.features.prediction.task import PredictTask, RecordingTask
from mbd_ros.files.table import MAIN, TIME, read_result
from mbd_ros.methods.signals.opensim_splines import opensim_splines
from mbd_ros.motion.external_loads import read_loads, wrench_at
from mbd_ros.motion.recordings import Capture, read_capture, read_columns, read_motion, refuse_huge
from mbd_ros.optimal_control.problem import Goal, PrescribedInputs, body_names
from mbd_ros.parts.sensors.marker import Marker
from mbd_ros.scene.built_scene import Scene

_DEGREE = 5  # of splines, as for inverse dynamics
_DRIFT = 0.1  # of a step: a low-pass that resamples ends a little earlier
_STEP = 1.0e-4  # s, of differences of orientations
_SAMPLES = 501  # of a recording that serves as guess
_SMOOTH = (".position", ".velocity")  # interpolated by splines, others by straight lines
_FEWEST = 4  # samples of a spline


def add_recording(scene: Scene, task: PredictTask) -> tuple[Scene, PredictTask, Recording | None]:
    """Return the scene with the loads of a recording, the task with its times, and the recording.

    Raises:
        DataError: A file cannot be read, or does not fit the scene.
        SceneError: Times of task and recording do not fit.
    """
    recording_task = task.recording
    if recording_task is None:
        return scene, task, None
    from mbd_ros.motion.external_loads import ExternalLoads

    external = (
        None if recording_task.external is None else ExternalLoads(scene, recording_task.external)
    )
    scene = scene if external is None else external.scene
    motion = _read_motion(scene, recording_task)
    times = motion.stamps * NANOSECOND
    slack = _DRIFT * float(np.diff(times).min())
    first, last = np.clip(recording_task.times or times[[0, -1]], times[0], times[-1]).tolist()
    interval = recording_task.times or (first, last)
    if first >= last or max(abs(first - interval[0]), abs(last - interval[1])) > slack:
        raise SceneError(
            f"{task.source}: predict.recording.times: {interval[0]:g} .. {interval[1]:g} s is "
            f"outside of the motion {recording_task.motion}, which lasts from {times[0]:g} to "
            f"{times[-1]:g} s"
        )
    if external is not None:
        loads, loaded = external.at, tuple(scene.wrenches)
    else:
        loads, loaded = _measured_loads(scene, recording_task)
    recording = Recording(
        *(first, last - first, _splines(scene, motion)),
        lambda at: loads(np.round(at / NANOSECOND).astype(np.int64)),
        *(loaded, tuple(external.remarks) if external else ()),
    )
    return scene, _with_duration(task, recording), recording


def _read_motion(scene: Scene, recording_task: RecordingTask) -> Motion:
    robot = scene.robot
    names = [joint.name for joint in robot.joints]
    motion = read_motion(
        recording_task.motion,
        names,
        required=scene.couplings.independent,
        bodies={base.name: base.frame for base in robot.bases},
        members=robot.members,
        sliding=robot.prismatic_joints,
        assumed=lambda name: float(scene.initial.q[robot.joint(name).q]),
    ).motion
    if len(motion.stamps) < 2:
        raise DataError(
            f"{recording_task.motion}: the file has one sample, but a motion needs two or more"
        )
    return motion if recording_task.cutoff is None else _low_pass(motion, recording_task.cutoff)


def _low_pass(motion: Motion, cutoff: float) -> Motion:
    """Return positions and poses after a low-pass; quaternions are normalized later."""
    known = np.isfinite(motion.position).all(axis=0)
    poses = [body.pose for body in motion.bodies]
    smooth = opensim_splines(motion.stamps, np.hstack([motion.position[:, known], *poses]), cutoff)
    cuts = int(known.sum()) + 7 * np.arange(len(poses))
    first, *others = np.split(smooth.position, cuts, axis=1)
    position = np.full((len(smooth.stamps), motion.position.shape[1]), np.nan)
    position[:, known] = first
    pairs = zip(motion.bodies, others, strict=True)
    bodies = tuple(body._replace(pose=pose, twist=None) for body, pose in pairs)
    return motion._replace(
        stamps=smooth.stamps,
        position=position,
        velocity=None,
        acceleration=None,
        effort=None,
        command=None,
        bodies=bodies,
    )


def _measured_loads(
    scene: Scene, recording_task: RecordingTask
) -> tuple[Callable[..., Any], tuple[str, ...]]:
    if recording_task.wrenches is None:
        return (lambda stamps: []), ()
    samples, _ = read_loads(scene, recording_task.motion, recording_task.wrenches)
    file = str(recording_task.wrenches)

    def at(stamps: Any) -> list[Array]:
        return [wrench_at(file, name, load, stamps) for name, load in samples.items()]

    return at, tuple(samples)


def _splines(scene: Scene, motion: Motion) -> Callable[[Array], tuple[Array, Array, Array]]:
    """Return a function from times to configurations, velocities and accelerations."""
    from scipy.interpolate import make_interp_spline  # only needed with a recording

    robot, times = scene.robot, motion.stamps * NANOSECOND
    k = min(_DEGREE, len(times) - 1)
    k -= 1 - k % 2
    known = np.flatnonzero(np.isfinite(motion.position).all(axis=0))
    joints = [robot.joints[i] for i in known]
    angles = make_interp_spline(times, motion.position[:, known], k=k)
    poses = [make_interp_spline(times, body.pose, k=k) for body in motion.bodies]
    q_of, v_of = ([getattr(joint, key) for joint in joints] for key in "qv")

    def configuration(at: Array) -> Array:
        q = np.repeat(robot.neutral()[:, None], len(at), axis=1)
        q[q_of] = angles(at).T
        for base, pose in zip(robot.bases, poses, strict=True):
            q[base.q] = configuration_of(robot, pose(at)).T
        return q

    def motion_at(at: Array) -> tuple[Array, Array, Array]:
        q = configuration(at)
        v, a = np.zeros((2, robot.model.nv, len(at)))
        v[v_of], a[v_of] = angles(at, 1).T, angles(at, 2).T
        for base in robot.bases:
            v[base.v], a[base.v] = _twists(base, configuration, at)
        scene.couplings.expand(q, v, a)
        return q.T, v.T, a.T

    return motion_at


def _twists(base: Any, configuration: Callable[[Array], Array], at: Array) -> tuple[Array, Array]:
    """Return the twist of a free body and its rate, in its own axes, shape (6, n) each."""
    from mbd_ros.optimal_control.phase_motion import BODY

    def pose(shift: float) -> Array:
        poses: Array = configuration(at + shift)[base.q].T
        return poses

    before, here, after = (pose(sign * _STEP) for sign in (-1.0, 0.0, 1.0))
    backward = np.array([BODY.difference(*pair) for pair in zip(before, here, strict=True)])
    forward = np.array([BODY.difference(*pair) for pair in zip(here, after, strict=True)])
    v = 0.5 * (forward + backward) / _STEP
    return v.T, ((forward - backward) / _STEP**2).T


def _with_duration(task: PredictTask, recording: Recording) -> PredictTask:
    """Return the task with the duration of its recording."""
    span = recording.duration, recording.duration
    phases = tuple(
        replace(phase, duration=span) if phase.duration is None else phase for phase in task.phases
    )
    durations = [phase.duration or span for phase in phases]
    low, high = (sum(duration[i] for duration in durations) for i in (0, 1))
    slack = 1.0e-9 * (1.0 + recording.duration)
    if recording.loaded and (high - low > slack or high > recording.duration + slack):
        raise SceneError(
            f"{task.source}: predict.duration: {low:g} .. {high:g} s does not fit the recorded "
            f"loads, which last {recording.duration:g} s; give one number up to that, or "
            "recording.times"
        )
    return replace(task, phases=phases)


class Recording(NamedTuple):
    """A recorded motion with its loads.

    Attributes:
        begin: Time in the recording at which the motion begins [s].
        duration: Duration [s].
        motion: Function from times [s] to configurations, velocities and accelerations.
        loads: Function from times [s] to the wrench of each load.
        loaded: Names of these loads, of `external_wrenches`.
        remarks: Remarks on its files.
    """

    begin: float
    duration: float
    motion: Callable[[Array], tuple[Array, Array, Array]]
    loads: Callable[[Array], list[Array]]
    loaded: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


def prescribed_inputs(
    driven_scene: DrivenScene,
    bounded: Iterable[str],
    recording: Recording | None,
    begin: float,
    duration: float,
) -> PrescribedInputs:
    """Return the prescribed loads of a phase.

    Loads without a measurement are zero, unless they drive the scene.

    Args:
        driven_scene: The scene, and which of its wrenches drive its bases.
        bounded: Names of quantities with bounds.
        recording: Recorded motion with the loads; None for none.
        begin: Begin of the phase [s].
        duration: Duration of the phase [s].
    """
    names = [name for name in driven_scene.scene.wrenches if name not in driven_scene.residuals]
    inputs, loaded = driven_scene.scene.inputs, () if recording is None else recording.loaded
    slots = [inputs.slots[name] for name in names]
    indices = [i for slot in slots for i in range(slot.start, slot.stop)]
    free = set(driving_wrenches(driven_scene.scene, bounded)) if recording is None else set[str]()
    known = [i for i, index in enumerate(indices) if inputs.names[index] not in free]
    places = np.array(indices, dtype=np.intp)[known]
    last: list[tuple[Array, Array]] = []  # shares, and the values there

    def at(shares: Array) -> Array:
        if not last or not have_same_bits(last[0][0], shares):
            zero = np.zeros((len(shares), 6))
            wrenches = dict.fromkeys(names, zero)
            if recording is not None and loaded:
                loads = recording.loads(begin + duration * shares)
                wrenches |= dict(zip(loaded, loads, strict=True))
            columns = np.hstack([wrenches[name] for name in names] or [zero[:, :0]])
            last[:] = [(shares.copy(), columns[:, known])]
        return last[0][1]

    return PrescribedInputs(places, at)


class References:
    """References of tracking goals, from files.

    Args:
        recording: Recorded motion, whose clock all files share; None without one, so that each
            file begins with the motion.
        motion: File of the recorded motion; None without one.
        begin: Time of the scene at which the motion begins [s].
    """

    def __init__(
        self, scene: Scene, recording: Recording | None, motion: Path | None, begin: float
    ) -> None:
        self._scene = scene
        self._recording = recording
        self._motion = motion
        self._begin = begin
        self._captures = dict[Path, Capture]()

    def __call__(self, goal: Goal, names: Sequence[str], times: Array) -> Array:
        """Return references, shape (len(names), len(times)), NaN where there are none.

        Args:
            goal: Goal of type `tracking`.
            names: Names of the quantities.
            times: Times [s].

        Raises:
            DataError: A file cannot be read, or there is none.
        """
        file = goal.options["file"] or self._motion
        if file is None:
            raise DataError(
                f"goal {goal.name}: there is no reference; give a file, or a recording in the task"
            )
        values = np.full((len(names), len(times)), np.nan)
        if file == self._motion and self._recording is not None:
            self._of_motion(names, times, values)
        missing = [i for i, row in enumerate(values) if np.isnan(row).all()]
        if missing:
            values[missing] = self._of_columns(file, [names[i] for i in missing], times)
        missing = [i for i, row in enumerate(values) if np.isnan(row).all()]
        if missing and any(names[i] in self._markers for i in missing):
            values[missing] = self._of_markers(file, [names[i] for i in missing], times)
        return values

    def shifted(self, begin: float) -> Callable[[Goal, Sequence[str], Array], Array]:
        """Return the same function for times since the beginning of a phase [s]."""
        return lambda goal, names, times: self(goal, names, begin + times)

    def _file_times(self, times: Array, first: float) -> Array:
        """Return times in a file."""
        return times if self._recording is not None else times - self._begin + first

    @cached_property
    def _markers(self) -> dict[str, tuple[Marker, int]]:
        markers = [sensor for sensor in self._scene.sensors if isinstance(sensor, Marker)]
        axes = list(enumerate(Marker.components))
        return {f"{m.name}.{axis}": (m, i) for m in markers for i, axis in axes}

    def _of_motion(self, names: Sequence[str], times: Array, values: Array) -> None:
        """Write positions, velocities and accelerations of the recording into `values`."""
        assert self._recording is not None
        robot = self._scene.robot
        q, v, a = self._recording.motion(times)
        of = {f"{joint.name}.position": q[:, joint.q] for joint in robot.joints}
        of |= {f"{joint.name}.velocity": v[:, joint.v] for joint in robot.joints}
        of |= {f"{joint.name}.acceleration": a[:, joint.v] for joint in robot.joints}
        for base in robot.bases:
            pose = q[:, base.q].copy()
            pose[:, :3] += robot.origin
            columns = (*pose.T, *v[:, base.v].T)
            of |= dict(zip(body_names(base.name), columns, strict=True))
        for i, name in enumerate(names):
            if name in of:
                values[i] = of[name]

    def _of_columns(self, file: Path, names: Sequence[str], times: Array) -> Array:
        robot = self._scene.robot
        joints = [joint.name for joint in robot.joints]
        table = read_columns(file, (TIME, *names), joints, robot.prismatic_joints)
        if table is None:
            raise DataError(f"{file}: a bag has no columns to track; give a table")
        at = self._file_times(times, float(table[0, 0]))
        pairs = zip(names, table.T[1:], strict=True)
        return np.array([_interpolate(name, table[:, 0], column, at) for name, column in pairs])

    def _of_markers(self, file: Path, names: Sequence[str], times: Array) -> Array:
        capture = self._capture(file)
        column = {label: i for i, label in enumerate(capture.labels)}
        at = self._file_times(times, float(capture.times[0]))
        values = np.full((len(names), len(times)), np.nan)
        for i, name in enumerate(names):
            if name not in self._markers:
                continue
            marker, axis = self._markers[name]
            place = column.get(marker.title, column.get(marker.name))
            if place is not None:
                samples = capture.places[:, place, axis]
                values[i] = _interpolate(".position", capture.times, samples, at)
        return values

    def _capture(self, file: Path) -> Capture:
        if file not in self._captures:
            self._captures[file] = read_capture(file)
        return self._captures[file]


def _interpolate(name: str, times: Array, values: Array, at: Array) -> Array:
    """Interpolate between samples; the result is NaN in gaps and beyond the ends."""
    known = np.isfinite(values)
    if not known.any():
        return np.full(len(at), np.nan)
    if known.sum() >= _FEWEST and name.endswith(_SMOOTH):
        from scipy.interpolate import CubicSpline

        between: Array = CubicSpline(times[known], values[known])(at)
    else:
        between = np.interp(at, times[known], values[known])
    step = float(np.diff(times).max(initial=0.0))
    distance = np.abs(at[:, None] - times[known][None, :]).min(axis=1)
    return np.where(distance <= 1.001 * step, between, np.nan)


def guess_lines_from_file(quantities: Any, file: Path) -> dict[str, tuple[float, ...]]:
    """Return a motion in a file as lines of a guess: quantity -> values at equally spaced times.

    Raises:
        DataError: The file cannot be read, has no quantity of the motion, or has huge numbers.
    """
    table = read_result(file)[MAIN]
    places = np.linspace(table[TIME][0], table[TIME][-1], _SAMPLES)
    lines = {
        name: tuple(np.interp(places, table[TIME], table[name]).tolist())
        for name in table
        if name in quantities.names and quantities.find(name)[0].letter in tuple("qvzu")
    }
    if not lines:
        raise DataError(f"{file}: no column of the motion, such as {quantities.names[0]}")
    refuse_huge(str(file), tuple(lines), *(table[name] for name in lines))
    return lines
