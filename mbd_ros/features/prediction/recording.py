"""A recorded motion with its loads: what a motion begins with and tracks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.kinematics.poses import configuration_of
from mbd_ros.core.state import NANOSECOND, Array, Motion
from mbd_ros.errors import DataError, SceneError
from mbd_ros.features.prediction.modes import Driven, driving_wrenches
from mbd_ros.features.prediction.task import PredictTask, RecordingTask
from mbd_ros.files.table import MAIN, TIME, read_result
from mbd_ros.methods.signals.opensim_splines import opensim_splines
from mbd_ros.motion.external_loads import read_loads, wrench_at
from mbd_ros.motion.recordings import Capture, read_capture, read_columns, read_motion
from mbd_ros.optimal_control.problem import GivenInputs, Goal, body_names
from mbd_ros.parts.sensors.marker import Marker
from mbd_ros.scene.built_scene import Scene

_DEGREE = 5  # of splines, as inverse dynamics takes them
_DRIFT = 0.1  # of a step: a low-pass that resamples ends a little earlier
_STEP = 1.0e-4  # s, of differences of orientations
_SAMPLES = 501  # of a recording that a search begins with
_SMOOTH = (".position", ".velocity")  # what has no kinks: splines; straight lines for the rest
_FEWEST = 4  # samples of a spline


def recorded(scene: Scene, task: PredictTask) -> tuple[Scene, PredictTask, Recording | None]:
    """The scene with the loads of a recording, and the task with its times.

    Raises:
        DataError: A file that cannot be read, or does not fit the scene.
        SceneError: Times that do not belong together.
    """
    asked = task.recording
    if asked is None:
        return scene, task, None
    from mbd_ros.motion.external_loads import ExternalLoads

    external = None if asked.external is None else ExternalLoads(scene, asked.external)
    scene = scene if external is None else external.scene
    motion = _read(scene, asked)
    times = motion.stamps * NANOSECOND
    slack = _DRIFT * float(np.diff(times).min())
    first, last = np.clip(asked.times or times[[0, -1]], times[0], times[-1]).tolist()
    wanted = asked.times or (first, last)
    if first >= last or max(abs(first - wanted[0]), abs(last - wanted[1])) > slack:
        raise SceneError(
            f"{task.source}: predict.recording.times: {wanted[0]:g} .. {wanted[1]:g} s, "
            f"the motion {asked.motion} is at {times[0]:g} .. {times[-1]:g} s"
        )
    if external is not None:
        loads, loaded = external.at, tuple(scene.wrenches)
    else:
        loads, loaded = _measured(scene, asked)
    found = Recording(
        *(first, last - first, _splines(scene, motion)),
        lambda at: loads(np.round(at / NANOSECOND).astype(np.int64)),
        *(loaded, tuple(external.remarks) if external else ()),
    )
    return scene, _timed(task, found), found


def _read(scene: Scene, asked: RecordingTask) -> Motion:
    robot = scene.robot
    names = [joint.name for joint in robot.joints]
    found = read_motion(
        asked.motion,
        names,
        required=scene.couplings.independent,
        bodies={base.name: base.frame for base in robot.bases},
        members=robot.members,
        sliding=robot.prismatic_joints,
        assumed=lambda name: float(scene.initial.q[robot.joint(name).q]),
    ).motion
    if len(found.stamps) < 2:
        raise DataError(f"{asked.motion}: one sample is no motion")
    return found if asked.cutoff is None else _smooth(found, asked.cutoff)


def _smooth(motion: Motion, cutoff: float) -> Motion:
    """Positions and poses behind a low-pass; quaternions get their length again later."""
    known = np.isfinite(motion.position).all(axis=0)
    poses = [body.pose for body in motion.bodies]
    found = opensim_splines(motion.stamps, np.hstack([motion.position[:, known], *poses]), cutoff)
    first, *others = np.split(found.position, int(known.sum()) + 7 * np.arange(len(poses)), axis=1)
    position = np.full((len(found.stamps), motion.position.shape[1]), np.nan)
    position[:, known] = first
    pairs = zip(motion.bodies, others, strict=True)
    bodies = tuple(body._replace(pose=pose, twist=None) for body, pose in pairs)
    return motion._replace(
        stamps=found.stamps,
        position=position,
        velocity=None,
        acceleration=None,
        effort=None,
        command=None,
        bodies=bodies,
    )


def _measured(scene: Scene, asked: RecordingTask) -> tuple[Callable[..., Any], tuple[str, ...]]:
    if asked.wrenches is None:
        return (lambda stamps: []), ()
    samples, _ = read_loads(scene, asked.motion, asked.wrenches)

    def at(stamps: Any) -> list[Array]:
        return [wrench_at(name, one, stamps) for name, one in samples.items()]

    return at, tuple(samples)


def _splines(scene: Scene, motion: Motion) -> Callable[[Array], tuple[Array, Array, Array]]:
    from scipy.interpolate import make_interp_spline  # only where there is a recording

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

    def whole(at: Array) -> tuple[Array, Array, Array]:
        q = configuration(at)
        v, a = np.zeros((2, robot.model.nv, len(at)))
        v[v_of], a[v_of] = angles(at, 1).T, angles(at, 2).T
        for base in robot.bases:
            v[base.v], a[base.v] = _twists(base, configuration, at)
        scene.couplings.expand(q, v, a)
        return q.T, v.T, a.T

    return whole


def _twists(base: Any, configuration: Callable[[Array], Array], at: Array) -> tuple[Array, Array]:
    """Twist of a free body and its rate, in its own axes, shape (6, n) each."""
    from mbd_ros.optimal_control.phase_motion import BODY

    def pose(shift: float) -> Array:
        found: Array = configuration(at + shift)[base.q].T
        return found

    before, here, after = (pose(way * _STEP) for way in (-1.0, 0.0, 1.0))
    backward = np.array([BODY.difference(*pair) for pair in zip(before, here, strict=True)])
    forward = np.array([BODY.difference(*pair) for pair in zip(here, after, strict=True)])
    v = 0.5 * (forward + backward) / _STEP
    return v.T, ((forward - backward) / _STEP**2).T


def _timed(task: PredictTask, found: Recording) -> PredictTask:
    """The task with the duration of its recording."""
    span = found.duration, found.duration
    phases = tuple(
        replace(one, duration=span) if one.duration is None else one for one in task.phases
    )
    asked = [one.duration or span for one in phases]
    low, high = (sum(one[i] for one in asked) for i in (0, 1))
    slack = 1.0e-9 * (1.0 + found.duration)
    if found.loaded and (high - low > slack or high > found.duration + slack):
        raise SceneError(
            f"{task.source}: predict.duration: {low:g} .. {high:g} s, loads are recorded for a "
            f"motion of {found.duration:g} s; accepted: a number up to that, or recording.times"
        )
    return replace(task, phases=phases)


class Recording(NamedTuple):
    """A recording of a motion.

    Attributes:
        begin: Where the motion begins in it [s].
        duration: [s].
        motion: Times [s] -> configurations, velocities and accelerations of all joints.
        loads: Times [s] -> wrench of each load, in the order of `external_wrenches`.
        loaded: Names of these loads.
        remarks: What is odd about its files.
    """

    begin: float
    duration: float
    motion: Callable[[Array], tuple[Array, Array, Array]]
    loads: Callable[[Array], list[Array]]
    loaded: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


def given_inputs(
    driven: Driven,
    bounded: Iterable[str],
    recording: Recording | None,
    begin: float,
    duration: float,
) -> GivenInputs:
    """The loads of a phase; those that nobody measured are zero, but for those that drive.

    Args:
        driven: The scene, and which of its wrenches drive its bases.
        bounded: Names of quantities with bounds.
        recording: With the loads; None for none.
        begin: Of the phase [s].
        duration: Of the phase [s].
    """
    names = [name for name in driven.scene.wrenches if name not in driven.residuals]
    inputs, loaded = driven.scene.inputs, () if recording is None else recording.loaded
    every = [
        at for name in names for at in range(inputs.slots[name].start, inputs.slots[name].stop)
    ]
    free = set(driving_wrenches(driven.scene, bounded)) if recording is None else set[str]()
    known = [i for i, at in enumerate(every) if inputs.names[at] not in free]
    places = np.array(every, dtype=np.intp)[known]
    kept: list[tuple[bytes, Array]] = []

    def at(shares: Array) -> Array:
        key = shares.tobytes()
        if not kept or kept[0][0] != key:
            none = np.zeros((len(shares), 6))
            given = dict.fromkeys(names, none)
            if recording is not None and loaded:
                loads = recording.loads(begin + duration * shares)
                given |= dict(zip(loaded, loads, strict=True))
            whole = np.hstack([given[name] for name in names] or [none[:, :0]])
            kept[:] = [(key, whole[:, known])]
        return kept[0][1]

    return GivenInputs(places, at)


class References:
    """What goals track, from files.

    Args:
        recording: Of the motion, whose clock all files have; None without one: each begins with
            the motion then.
        begin: Where the motion begins in the time of the scene [s].
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
        """What quantities should be, shape (len(names), len(times)), NaN where nothing is known.

        Args:
            goal: Of type `tracking`.
            times: [s].

        Raises:
            DataError: A file that cannot be read, or none.
        """
        file = goal.options["file"] or self._motion
        if file is None:
            raise DataError(f"goal {goal.name}: no file, and the task has no recording")
        found = np.full((len(names), len(times)), np.nan)
        if file == self._motion and self._recording is not None:
            self._of_motion(names, times, found)
        left = [i for i, one in enumerate(found) if np.isnan(one).all()]
        if left:
            found[left] = self._of_columns(file, [names[i] for i in left], times)
        left = [i for i, one in enumerate(found) if np.isnan(one).all()]
        if left and any(names[i] in self._markers for i in left):
            found[left] = self._of_markers(file, [names[i] for i in left], times)
        return found

    def since(self, begin: float) -> Callable[[Goal, Sequence[str], Array], Array]:
        """The same for times since the beginning of a phase [s]."""
        return lambda goal, names, times: self(goal, names, begin + times)

    def _since(self, times: Array, first: float) -> Array:
        """Times of a file."""
        return times if self._recording is not None else times - self._begin + first

    @cached_property
    def _markers(self) -> dict[str, tuple[Marker, int]]:
        every = [one for one in self._scene.sensors if isinstance(one, Marker)]
        axes = list(enumerate(Marker.components))
        return {f"{one.name}.{axis}": (one, i) for one in every for i, axis in axes}

    def _of_motion(self, names: Sequence[str], times: Array, found: Array) -> None:
        """Positions, velocities and accelerations of the recording."""
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
                found[i] = of[name]

    def _of_columns(self, file: Path, names: Sequence[str], times: Array) -> Array:
        robot = self._scene.robot
        joints = [joint.name for joint in robot.joints]
        table = read_columns(file, (TIME, *names), joints, robot.prismatic_joints)
        if table is None:
            raise DataError(f"{file}: a bag has no columns; accepted: a table")
        at = self._since(times, float(table[0, 0]))
        pairs = zip(names, table.T[1:], strict=True)
        return np.array([_between(name, table[:, 0], one, at) for name, one in pairs])

    def _of_markers(self, file: Path, names: Sequence[str], times: Array) -> Array:
        capture = self._capture(file)
        column = {label: i for i, label in enumerate(capture.labels)}
        at = self._since(times, float(capture.times[0]))
        found = np.full((len(names), len(times)), np.nan)
        for i, name in enumerate(names):
            if name not in self._markers:
                continue
            marker, axis = self._markers[name]
            place = column.get(marker.title, column.get(marker.name))
            if place is not None:
                values = capture.places[:, place, axis]
                found[i] = _between(".position", capture.times, values, at)
        return found

    def _capture(self, file: Path) -> Capture:
        if file not in self._captures:
            self._captures[file] = read_capture(file)
        return self._captures[file]


def _between(name: str, times: Array, values: Array, at: Array) -> Array:
    """Values between samples, NaN in gaps and beyond the ends."""
    known = np.isfinite(values)
    if not known.any():
        return np.full(len(at), np.nan)
    if known.sum() >= _FEWEST and name.endswith(_SMOOTH):
        from scipy.interpolate import CubicSpline

        found: Array = CubicSpline(times[known], values[known])(at)
    else:
        found = np.interp(at, times[known], values[known])
    step = float(np.diff(times).max(initial=0.0))
    distance = np.abs(at[:, None] - times[known][None, :]).min(axis=1)
    return np.where(distance <= 1.001 * step, found, np.nan)


def recorded_lines(quantities: Any, file: Path) -> dict[str, tuple[float, ...]]:
    """A motion in a file as lines of a guess: quantity -> values at equal times.

    Raises:
        DataError: A file that cannot be read, or that has no quantity of the motion.
    """
    table = read_result(file)[MAIN]
    places = np.linspace(table[TIME][0], table[TIME][-1], _SAMPLES)
    found = {
        name: tuple(np.interp(places, table[TIME], table[name]).tolist())
        for name in table
        if name in quantities.names and quantities.find(name)[0].letter in tuple("qvzu")
    }
    if not found:
        raise DataError(f"{file}: no column of the motion, such as {quantities.names[0]}")
    return found
