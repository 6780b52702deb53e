"""Recordings that a motion tracks."""

from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.features.prediction.recording import Recording
from mbd_ros.files.formats import read_result
from mbd_ros.files.table import MAIN
from mbd_ros.files.times import TIME
from mbd_ros.motion.marker_recording import Capture, read_capture
from mbd_ros.motion.recordings import read_columns
from mbd_ros.optimal_control.free_body_names import body_names
from mbd_ros.optimal_control.problem import Goal
from mbd_ros.parts.sensors.marker import Marker
from mbd_ros.scene.built_scene import Scene

_SAMPLES = 501  # of a recording that a search begins with
_SMOOTH = (".position", ".velocity")  # what has no kinks: splines; straight lines for the rest
_FEWEST = 4  # samples of a spline


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


class References:
    """What goals track, from files.

    Args:
        scene: The scene.
        recording: Of the motion, whose clock all files have; None without one: each begins with
            the motion then.
        motion: Its file.
        begin: Where the motion begins in the time of the scene [s].
    """

    def __init__(
        self, scene: Scene, recording: Recording | None, motion: Path | None, begin: float
    ) -> None:
        self._scene, self._recording, self._motion = scene, recording, motion
        self._begin = begin
        self._captures = dict[Path, Capture]()

    def __call__(self, goal: Goal, names: Sequence[str], times: Array) -> Array:
        """What quantities should be, shape (len(names), len(times)), NaN where nothing is known.

        Args:
            goal: Of type `tracking`.
            names: Of quantities.
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
        table = read_columns(file, (TIME, *names), joints, robot.sliding)
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
