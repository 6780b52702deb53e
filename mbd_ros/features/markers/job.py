"""Motion from recorded markers: `mbd-ros kinematics`."""

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.features.markers.axes import axes_lines, turned
from mbd_ros.features.markers.kinematics_task import KinematicsTask
from mbd_ros.features.markers.marker_cost import Seen
from mbd_ros.features.markers.marker_fit import Fit
from mbd_ros.features.markers.marker_kinematics import MarkerKinematics
from mbd_ros.features.markers.matching import Matched, match
from mbd_ros.features.markers.remarks import remarks_of
from mbd_ros.features.markers.solver import NO_TASK, read_tasks, solver_of, targets_of
from mbd_ros.features.markers.tables import RESIDUALS, residual_table, sample_table
from mbd_ros.files.replacing import check_place, refuse_overwriting
from mbd_ros.files.table import MAIN, Result
from mbd_ros.jobs.error_source import about
from mbd_ros.jobs.lines import Say
from mbd_ros.motion.columns import state_topics
from mbd_ros.motion.marker_recording import Capture, read_capture
from mbd_ros.motion.recordings import Source
from mbd_ros.motion.result_metadata import metadata_of
from mbd_ros.scene.built_scene import Scene


def kinematics(
    scene: Scene,
    markers: Source,
    *,
    task: KinematicsTask | str | Path = NO_TASK,
    begin: float | None = None,
    end: float | None = None,
    unit: str | None = None,
    axes: str | None = None,
    smoothness: float | None = None,
    limits: bool | None = None,
    say: Say | None = None,
) -> Result:
    """Positions of all joints that fit recorded markers best.

    Args:
        scene: The scene, with markers among its `sensors`.
        markers: Result or file of the markers.
        task: Weights of markers and coordinates: a task, a task file, or a set-up of OpenSim's
            inverse kinematics (.xml).
        begin: First time [s], in place of that of the task.
        end: Last time [s], likewise.
        unit: Of the places: m, mm or cm.
        axes: Recorded axis along each axis of the scene, as `x,z,-y`; `screen` where a .c3d says
            them.
        smoothness: In place of that of the task; 0 fits frames alone.
        limits: Whether joints keep their limits.
        say: Is called with each line for people; without it the lines are
            `metadata["remarks"]`.

    Returns:
        Table `samples`: `time`, `<joint>.position` of all joints, coupled and locked ones too; of
        free bodies `<body>.position.x` and so on. Table `residuals`: `objective`, `remainder`,
        `rms`, `max`, and the distance of each marker, nan where it was not seen.

    Raises:
        DataError: Markers that cannot be read or do not fit the scene.
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
            from mbd_ros.features.markers.smooth_trial import smooth_trial  # loads scipy

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
