"""Motion from recorded markers: `mbd-ros kinematics`."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from mbd_ros.core.kinematics.poses import with_continuous_signs, world_pose
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.model.urdf import joint_kinds, parse_urdf
from mbd_ros.core.state import Array, BodyMotion
from mbd_ros.errors import DataError
from mbd_ros.features.markers.exchanged_labels import exchanged_labels
from mbd_ros.features.markers.kinematics_task import KinematicsTask
from mbd_ros.features.markers.marker_cost import Seen
from mbd_ros.features.markers.marker_fit import Bools, Fit
from mbd_ros.features.markers.marker_kinematics import (
    NO_TASK,
    MarkerKinematics,
    Matched,
    match,
    read_tasks,
    solver_of,
    targets_of,
)
from mbd_ros.files.body_columns import motion_columns
from mbd_ros.files.table import MAIN, TIME, Column, Result, Table
from mbd_ros.files.text_file import check_place, refuse_overwriting
from mbd_ros.jobs.arguments import about
from mbd_ros.jobs.progress import Say
from mbd_ros.motion.columns import axes_matrix, joint_columns, other_axes, state_topics
from mbd_ros.motion.recordings import Capture, Source, metadata_of, read_capture
from mbd_ros.scene.built_scene import Scene

RESIDUALS = "residuals"
_WIDE = 0.1  # of the size of the cloud of markers: misses that ask for a reason
_AS_GOOD = 1.05  # of the smallest misses: as good
_EXPLAINS = 0.2  # of the misses: what is left with the right axes
_LOOSE = 1.0e-10  # of the largest eigenvalue of a Hessian: a direction that nothing tells of
_TAKES_PART = 0.3  # entry of such a direction
_ROUNDING = 1.0e-9  # rad or m from a limit


def kinematics(
    scene: Scene,
    markers: Source,
    *,
    task: KinematicsTask | str | Path = NO_TASK,
    begin: float | None = None,
    end: float | None = None,
    unit: Literal["m", "mm", "cm"] | None = None,
    axes: str | None = None,
    smoothness: float | None = None,
    limits: bool | None = None,
    say: Say | None = None,
) -> Result:
    """Compute the positions of all joints that fit recorded markers best.

    Args:
        scene: The scene, with markers among its `sensors`.
        markers: Result or file of the markers.
        task: Weights of markers and coordinates: a task, a task file, or a setup file of
            OpenSim's inverse kinematics (.xml).
        begin: First time [s], in place of that of the task.
        end: Last time [s], in place of that of the task.
        unit: Unit of the recorded markers. By default that of the file.
        axes: Recorded axis along each axis of the scene, such as `x,z,-y`; `screen` takes them
            from X_SCREEN and Y_SCREEN of a .c3d. By default the axes are the same.
        smoothness: Ratio of the error of markers to the error of accelerations [m s^2/rad], in
            place of that of the task. Any value above 0 fits all frames together.
        limits: Whether joints keep their limits.
        say: Called with each line for people; without it the lines go to `metadata["remarks"]`.

    Returns:
        Table `samples`: `time` and `<joint>.position` of all joints, also of coupled and locked
        ones; for free bodies `<body>.position.x` and so on. Table `residuals`: `objective`,
        `remainder`, `rms`, `max`, and the distance of each marker, nan where it was not seen.

    Raises:
        DataError: The markers cannot be read or do not fit the scene.
        SolveError: A mechanism with loops does not close.
    """
    asked = read_tasks(scene, task)
    given = {"begin": begin, "end": end, "unit": unit, "axes": axes}
    given |= {"smoothness": smoothness, "limits": limits}
    asked = replace(asked, **{key: one for key, one in given.items() if one is not None})
    remarks: list[str] = []
    found = _fitted(scene, markers, asked, say or remarks.append)
    inputs = {"markers": markers, "task": asked.source or None, **given}
    topics = state_topics(scene.robot, ("position",))
    tables = {
        MAIN: sample_table(scene, found.times, found.fit.q),
        RESIDUALS: residual_table(found.solver, found.times, found.fit, found.seen),
    }
    result = Result(tables, metadata_of("kinematics", scene, inputs, topics))
    if say is None:
        result.metadata["remarks"] = remarks
    return result


def kinematics_to(
    scene: Scene, markers: Path, out: Path, residuals: Path | None, say: Say, **options: Any
) -> None:
    """Read markers, write the motion, and perhaps the residuals.

    Raises:
        MbdError: As `kinematics`, or a place that cannot be written to.
    """
    for place in filter(None, (out, residuals)):
        refuse_overwriting(place, markers)
        check_place(place)
    result = kinematics(scene, markers, say=say, **options)
    result.to(out)
    if residuals is not None:
        Result({MAIN: result[RESIDUALS]}, result.metadata).to(residuals)
    say(f"{result[MAIN].rows} frames -> {out}")


class _Found(NamedTuple):
    solver: MarkerKinematics
    times: Array
    seen: Seen
    fit: Fit


def _fitted(scene: Scene, source: Source, task: KinematicsTask, say: Say) -> _Found:
    capture = read_capture(source, task.unit).between(task.begin, task.end)
    if task.axes is not None:
        capture = turned(capture, task.axes)
    matched = match(scene, capture, task)
    for line in matched.lines:
        say(line)
    capture = _usable(matched, say)
    solver = solver_of(scene, matched.marks, task, capture.where)
    targets = targets_of(scene, task, capture.times)
    seen = solver.seen(capture.places, capture.times, targets)
    with about(capture.where):
        fit = solver.trial(scene.initial.q, seen)
        if task.smoothness:
            from mbd_ros.features.markers.marker_trial import smooth_trial

            fit = smooth_trial(solver.solver, fit, seen, task.smoothness)
        for line in (
            *remarks_of(solver, capture, seen, fit),
            *axes_lines(solver, scene.initial.q, capture, seen, fit),
        ):
            say(line)
    return _Found(solver, capture.times, seen, fit)


def _usable(matched: Matched, say: Say) -> Capture:
    """The frames in which any marker was seen."""
    capture = matched.capture
    seen = np.isfinite(capture.places).all(axis=2).any(axis=1)
    if not seen.any() and matched.marks:
        raise DataError(f"{capture.where}: no frame has a marker of the model")
    if matched.marks and not seen.all():
        gaps = capture.times[~seen]
        say(
            f"warning: left out {len(gaps)} frames without any marker, the first at "
            f"{gaps[0]:.9g} s, the last at {gaps[-1]:.9g} s"
        )
        return capture._replace(times=capture.times[seen], places=capture.places[seen])
    return capture


def sample_table(scene: Scene, times: Array, q: Array) -> Table:
    """Positions of all joints, locked ones too, and poses of free bodies.

    Args:
        times: [s], shape (N,).
        q: Configurations, shape (N, nq).
    """
    robot = scene.robot
    columns = joint_columns(robot.joints, "position", q[:, [joint.q for joint in robot.joints]])
    slides = _locked_slides(robot) if robot.locked else frozenset()
    for name, value in robot.locked.items():
        unit = "m" if name in slides else "rad"
        columns.append(Column(f"{name}.position", np.full(len(times), value), unit))
    for base in robot.bases:
        pose = with_continuous_signs(world_pose(robot, q[:, base.q]))
        columns += motion_columns(BodyMotion(base.name, pose, None, None), base.frame)
    return Table([Column(TIME, times, "s"), *columns])


def _locked_slides(robot: Robot) -> frozenset[str]:
    """Names of locked joints that slide, which the model has no more."""
    found = []
    for model_source in robot.model_sources:
        kinds = joint_kinds(
            parse_urdf(model_source.text, model_source.source, model_source.inertias)
        )
        names = model_source.rename or {}
        found += [
            model_source.scoped(names.get(joint, joint))
            for joint, kind in kinds.items()
            if kind == "prismatic"
        ]
    return frozenset(found)


def residual_table(solver: MarkerKinematics, times: Array, fit: Fit, seen: Seen) -> Table:
    """Objective and distance of each marker.

    Args:
        solver: Has the labels.
        times: [s], shape (N,).
    """
    apart = np.where(seen.weights > 0.0, np.linalg.norm(fit.misses, axis=2), np.nan)
    there = np.isfinite(apart)
    squares, count = np.where(there, apart, 0.0) ** 2, np.maximum(there.sum(axis=1), 1)
    names = [label.replace(".", "_") for label in solver.labels]
    return Table(
        [
            Column(TIME, times, "s"),
            Column("objective", fit.objective, "m^2"),
            Column("remainder", fit.remainder, "rad or m"),
            Column("rms", np.sqrt(squares.sum(axis=1) / count), "m"),
            Column("max", np.where(there, apart, 0.0).max(axis=1, initial=0.0), "m"),
            *(Column(f"{n}.distance", apart[:, i], "m") for i, n in enumerate(names)),
        ]
    )


def remarks_of(solver: MarkerKinematics, capture: Capture, seen: Seen, fit: Fit) -> Iterator[str]:
    """Quality, the marker that misses most, limits, what is not determined, exchanged labels."""
    apart = np.linalg.norm(fit.misses, axis=2) * (seen.weights > 0.0)
    if apart.size:
        frame, marker = np.unravel_index(int(np.argmax(apart)), apart.shape)
        count = max(int((seen.weights > 0.0).sum()), 1)
        yield (
            f"markers miss by {1e3 * np.sqrt((apart**2).sum() / count):.4g} mm rms, most "
            f"{solver.labels[marker]} by {1e3 * apart[frame, marker]:.4g} mm at "
            f"t = {capture.times[frame]:.9g} s"
        )
    steps = fit.remainder[np.isfinite(fit.remainder)]  # others never took a whole step
    if len(steps):
        yield f"last steps at most {steps.max():.3g} rad or m (conditions of the optimum)"
    lost = np.flatnonzero(~fit.settled)
    if len(lost):
        yield (
            f"warning: {len(lost)} frames did not settle, the first at "
            f"t = {capture.times[lost[0]]:.9g} s"
        )
    yield from _at_limits(solver, fit)
    yield from _undetermined(solver, seen, fit)
    for one in exchanged_labels(solver.solver, fit, seen):
        begin, end = (capture.times[frame] for frame in one.frames)
        yield (
            f"warning: labels {solver.labels[one.first]} and {solver.labels[one.second]} seem "
            f"exchanged from {begin:.9g} to {end:.9g} s: the objective would fall from "
            f"{one.before:.3g} to {one.after:.3g} m^2"
        )


def _at_limits(solver: MarkerKinematics, fit: Fit) -> Iterator[str]:
    y, names = fit.q[:, solver.solver.cost.y_of_q], _names(solver)
    for bound, what in ((solver.solver.lower, "lower"), (solver.solver.upper, "upper")):
        there = (np.abs(y - bound) <= _ROUNDING).sum(axis=0)
        for i in np.flatnonzero(there):
            yield f"{names[i]} is at its {what} limit of {bound[i]:.6g} in {there[i]} frames"


def _undetermined(solver: MarkerKinematics, seen: Seen, fit: Fit) -> Iterator[str]:
    """Coordinates that could move in the first frame without any effect."""
    first = slice(0, 1)
    hessian = solver.solver.cost.at(fit.q[first], seen.of(first), np.zeros(1)).hessian[0]
    if solver.solver.loops is not None or not len(hessian):
        return
    values, vectors = np.linalg.eigh(hessian)
    loose = vectors[:, values <= _LOOSE * max(values[-1], 0.0)]
    taking = np.flatnonzero((np.abs(loose) > _TAKES_PART).any(axis=1))
    names = dict.fromkeys(_names(solver)[i] for i in taking)
    if names:
        yield f"warning: markers do not determine {', '.join(names)}, which stay near the start"


def _names(solver: MarkerKinematics) -> list[str]:
    """Of the independent coordinates."""
    robot, v = solver.robot, solver.solver.cost.couplings.v_index
    titles = {joint.v: joint.name for joint in robot.joints} | robot.base_titles
    return [titles[int(i)] for i in v]


def turned(capture: Capture, axes: str) -> Capture:
    """Markers in axes of the scene.

    Args:
        axes: `x,z,-y` or the like; or `screen`: x along X_SCREEN, y along Y_SCREEN.

    Raises:
        DataError: No axes, a mirror image, or a recording that does not say its own.
    """
    R = axes_matrix(f"{capture.where}: --axes", axes, capture.screen)
    return capture._replace(places=capture.places @ R.T)


def axes_lines(
    solver: MarkerKinematics, start: Array, capture: Capture, seen: Seen, fit: Fit
) -> Iterator[str]:
    """A warning where markers miss by far, and other axes of the recording explain it.

    Args:
        start: Default configuration, shape (nq,).
    """
    is_seen = seen.weights > 0.0
    frame = int(is_seen.sum(axis=1).argmax())
    there, one = is_seen[frame], seen.of(slice(frame, frame + 1))
    places = one.places[0, there]
    if not len(places):
        return
    size = _rms(places - places.mean(axis=0))
    before = _rms(fit.misses[frame, there])
    if not before > _WIDE * size:
        return
    axes, after = _best(solver, start, one, there)
    if after < _EXPLAINS * before:
        yield (
            f"warning: the recording seems to have other axes than the scene: at "
            f"t = {capture.times[frame]:.9g} s markers miss by {1e3 * before:.4g} mm rms, by "
            f"{1e3 * after:.4g} mm with --axes {axes}"
        )


def _best(solver: MarkerKinematics, start: Array, seen: Seen, there: Bools) -> tuple[str, float]:
    """Axes of a frame, and by how much its markers miss there.

    A base that can turn along makes several as good: the one nearest to the start is taken.
    """
    found, origin = [], solver.robot.origin
    for axes, R in other_axes():
        places = (seen.places + origin) @ R.T - origin
        fit = solver.first(start, seen._replace(places=places))
        found.append((_rms(fit.misses[0, there]), float(np.abs(fit.q[0] - start).sum()), axes))
    least = min(found)[0]
    good = [one for one in found if one[0] <= _AS_GOOD * least]
    after, _, axes = min(good, key=lambda one: one[1])
    return axes, after


def _rms(vectors: Array) -> float:
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))
