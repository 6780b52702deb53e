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
_WIDE = 0.1  # of the size of the cloud of markers: residuals that need a reason
_AS_GOOD = 1.05  # of the smallest misses: as good
_EXPLAINS = 0.2  # of the residuals: those that the right axes may leave
_LOOSE = 1.0e-10  # of the largest eigenvalue of a Hessian: an undetermined direction
_TAKES_PART = 0.3  # entry of an undetermined coordinate in that direction
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
    options = {"begin": begin, "end": end, "unit": unit, "axes": axes}
    options |= {"smoothness": smoothness, "limits": limits}
    changes = {key: value for key, value in options.items() if value is not None}
    order = replace(read_tasks(scene, task), **changes)
    remarks: list[str] = []
    trial = _fit(scene, markers, order, say or remarks.append)
    inputs = {"markers": markers, "task": order.source or None, **options}
    topics = state_topics(scene.robot, ("position",))
    tables = {
        MAIN: sample_table(scene, trial.times, trial.fit.q),
        RESIDUALS: residual_table(trial.solver, trial.times, trial.fit, trial.seen),
    }
    result = Result(tables, metadata_of("kinematics", scene, inputs, topics))
    if say is None:
        result.metadata["remarks"] = remarks
    return result


def kinematics_to(
    scene: Scene, markers: Path, out: Path, residuals: Path | None, say: Say, **options: Any
) -> None:
    """Read markers, and write the motion and perhaps the residuals.

    Raises:
        MbdError: An error of `kinematics`, or a file that cannot be written.
    """
    for place in filter(None, (out, residuals)):
        refuse_overwriting(place, markers)
        check_place(place)
    result = kinematics(scene, markers, say=say, **options)
    result.to(out)
    if residuals is not None:
        Result({MAIN: result[RESIDUALS]}, result.metadata).to(residuals)
    say(f"{result[MAIN].rows} frames -> {out}")


class _FittedTrial(NamedTuple):
    solver: MarkerKinematics
    times: Array
    seen: Seen
    fit: Fit


def _fit(scene: Scene, source: Source, task: KinematicsTask, say: Say) -> _FittedTrial:
    capture = read_capture(source, task.unit).between(task.begin, task.end)
    if task.axes is not None:
        capture = with_axes(capture, task.axes)
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
    return _FittedTrial(solver, capture.times, seen, fit)


def _usable(matched: Matched, say: Say) -> Capture:
    """Return the frames in which any marker was seen."""
    capture = matched.capture
    seen = np.isfinite(capture.places).all(axis=2).any(axis=1)
    if not seen.any() and matched.marks:
        raise DataError(f"{capture.where}: no frame has a marker of the scene")
    if matched.marks and not seen.all():
        gaps = capture.times[~seen]
        say(
            f"warning: left out {len(gaps)} frames without any marker, the first at "
            f"{gaps[0]:.9g} s, the last at {gaps[-1]:.9g} s"
        )
        return capture._replace(times=capture.times[seen], places=capture.places[seen])
    return capture


def sample_table(scene: Scene, times: Array, q: Array) -> Table:
    """Return positions of all joints, also locked ones, and poses of free bodies.

    Args:
        scene: The scene.
        times: Times of the frames [s], shape (N,).
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
    """Return the names of locked prismatic joints, which are not in the model."""
    names_of_slides = []
    for model_source in robot.model_sources:
        kinds = joint_kinds(
            parse_urdf(model_source.text, model_source.source, model_source.inertias)
        )
        names = model_source.rename or {}
        names_of_slides += [
            model_source.scoped(names.get(joint, joint))
            for joint, kind in kinds.items()
            if kind == "prismatic"
        ]
    return frozenset(names_of_slides)


def residual_table(solver: MarkerKinematics, times: Array, fit: Fit, seen: Seen) -> Table:
    """Return the objective and the distance of each marker.

    Args:
        solver: Solver with the labels.
        times: Times of the frames [s], shape (N,).
        fit: Fitted motion.
        seen: Measured markers.
    """
    distances = np.where(seen.weights > 0.0, np.linalg.norm(fit.misses, axis=2), np.nan)
    there = np.isfinite(distances)
    squares, count = np.where(there, distances, 0.0) ** 2, np.maximum(there.sum(axis=1), 1)
    names = [label.replace(".", "_") for label in solver.labels]
    return Table(
        [
            Column(TIME, times, "s"),
            Column("objective", fit.objective, "m^2"),
            Column("remainder", fit.remainder, "rad or m"),
            Column("rms", np.sqrt(squares.sum(axis=1) / count), "m"),
            Column("max", np.where(there, distances, 0.0).max(axis=1, initial=0.0), "m"),
            *(Column(f"{n}.distance", distances[:, i], "m") for i, n in enumerate(names)),
        ]
    )


def remarks_of(solver: MarkerKinematics, capture: Capture, seen: Seen, fit: Fit) -> Iterator[str]:
    """Yield lines about residuals, limits, undetermined coordinates and exchanged labels."""
    distances = np.linalg.norm(fit.misses, axis=2) * (seen.weights > 0.0)
    if distances.size:
        frame, marker = np.unravel_index(int(np.argmax(distances)), distances.shape)
        count = max(int((seen.weights > 0.0).sum()), 1)
        yield (
            f"markers miss by {1e3 * np.sqrt((distances**2).sum() / count):.4g} mm rms, most "
            f"{solver.labels[marker]} by {1e3 * distances[frame, marker]:.4g} mm at "
            f"t = {capture.times[frame]:.9g} s"
        )
    steps = fit.remainder[np.isfinite(fit.remainder)]  # others never took a whole step
    if len(steps):
        yield f"last steps at most {steps.max():.3g} rad or m (optimality conditions)"
    lost = np.flatnonzero(~fit.settled)
    if len(lost):
        yield (
            f"warning: {len(lost)} frames did not settle, the first at "
            f"t = {capture.times[lost[0]]:.9g} s"
        )
    yield from _at_limits(solver, fit)
    yield from _undetermined(solver, seen, fit)
    for exchange in exchanged_labels(solver.solver, fit, seen):
        begin, end = (capture.times[frame] for frame in exchange.frames)
        yield (
            f"warning: labels {solver.labels[exchange.first]} and "
            f"{solver.labels[exchange.second]} seem exchanged from {begin:.9g} to {end:.9g} s: "
            f"the objective would fall from {exchange.before:.3g} to {exchange.after:.3g} m^2"
        )


def _at_limits(solver: MarkerKinematics, fit: Fit) -> Iterator[str]:
    y, names = fit.q[:, solver.solver.cost.y_of_q], _names(solver)
    for bound, side in ((solver.solver.lower, "lower"), (solver.solver.upper, "upper")):
        there = (np.abs(y - bound) <= _ROUNDING).sum(axis=0)
        for i in np.flatnonzero(there):
            yield f"{names[i]} is at its {side} limit of {bound[i]:.6g} in {there[i]} frames"


def _undetermined(solver: MarkerKinematics, seen: Seen, fit: Fit) -> Iterator[str]:
    """Yield a warning about coordinates that markers of the first frame do not determine."""
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
    """Return the names of the independent coordinates."""
    robot, v = solver.robot, solver.solver.cost.couplings.v_index
    titles = {joint.v: joint.name for joint in robot.joints} | robot.base_titles
    return [titles[int(i)] for i in v]


def with_axes(capture: Capture, axes: str) -> Capture:
    """Return markers in the axes of the scene.

    Args:
        capture: Recorded markers.
        axes: Recorded axis along each axis of the scene, such as `x,z,-y`; `screen` takes x along
            X_SCREEN and y along Y_SCREEN.

    Raises:
        DataError: The axes are not valid or a mirror image, or the recording has no X_SCREEN.
    """
    R = axes_matrix(f"{capture.where}: --axes", axes, capture.screen)
    return capture._replace(places=capture.places @ R.T)


def axes_lines(
    solver: MarkerKinematics, start: Array, capture: Capture, seen: Seen, fit: Fit
) -> Iterator[str]:
    """Yield a warning if residuals are large and other axes of the recording explain them.

    Args:
        solver: Solver of the frames.
        start: Default configuration, shape (nq,).
        capture: Recorded markers.
        seen: Measured markers.
        fit: Fitted motion.
    """
    is_seen = seen.weights > 0.0
    frame = int(is_seen.sum(axis=1).argmax())
    there, frame_seen = is_seen[frame], seen.of(slice(frame, frame + 1))
    places = frame_seen.places[0, there]
    if not len(places):
        return
    size = _rms(places - places.mean(axis=0))
    before = _rms(fit.misses[frame, there])
    if not before > _WIDE * size:
        return
    axes, after = _best_axes(solver, start, frame_seen, there)
    if after < _EXPLAINS * before:
        yield (
            f"warning: the recording seems to have other axes than the scene: at "
            f"t = {capture.times[frame]:.9g} s markers miss by {1e3 * before:.4g} mm rms, by "
            f"{1e3 * after:.4g} mm with --axes {axes}"
        )


def _best_axes(
    solver: MarkerKinematics, start: Array, seen: Seen, there: Bools
) -> tuple[str, float]:
    """Return the axes that fit a frame best, and the rms distance of its markers.

    Among axes that are equally good, since the base can turn, the nearest to the start is chosen.
    """
    candidates, origin = [], solver.robot.origin
    for axes, R in other_axes():
        places = (seen.places + origin) @ R.T - origin
        fit = solver.first(start, seen._replace(places=places))
        distance = float(np.abs(fit.q[0] - start).sum())
        candidates.append((_rms(fit.misses[0, there]), distance, axes))
    least = min(candidates)[0]
    good = [candidate for candidate in candidates if candidate[0] <= _AS_GOOD * least]
    after, _, axes = min(good, key=lambda candidate: candidate[1])
    return axes, after


def _rms(vectors: Array) -> float:
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))
