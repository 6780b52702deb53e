"""External loads of a recorded motion, at the samples of the motion."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.loads.external_loads import at_stamps
from mbd_ros.core.state import NANOSECOND, Array, WrenchSamples
from mbd_ros.errors import DataError, ModelError
from mbd_ros.files.formats import is_bag
from mbd_ros.files.laboratory.external_loads import GROUND, ExternalLoad, read_external_loads
from mbd_ros.files.laboratory.markers import SCREEN
from mbd_ros.files.table import Result, read_result
from mbd_ros.motion.columns import axes_matrix
from mbd_ros.motion.recordings import Source, name_of, read_wrenches
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.variants import with_sections

_WORLD = "world"
WRENCH_MAX_AGE = 0.1  # [s], for which the last sample of a wrench is held


class ExternalLoads:
    """External loads of an OpenSim .xml file.

    Args:
        scene: The scene; the loads of the file replace its `external_wrenches`.
        path: The .xml file.

    Attributes:
        scene: The scene with an external wrench for every load.
        remarks: Remarks on irregularities of the files.

    Raises:
        DataError: A file cannot be read, or the scene has no body of a load.
    """

    def __init__(self, scene: Scene, path: Path) -> None:
        self._path = path
        self._loads = read_external_loads(path)
        remarks = (f"{load.source}: {text}" for load in self._loads for text in load.remarks)
        self.remarks = list(dict.fromkeys(remarks))
        self.scene = with_sections(
            scene, external_wrenches={load.name: _entry(scene, path, load) for load in self._loads}
        )

    def at(self, stamps: NDArray[np.int64]) -> list[Array]:
        """Return force and torque about the origin of its frame for each load, shape (n, 6).

        Forces, points and torques are interpolated by separate natural cubic splines, as in
        OpenSim.

        Args:
            stamps: Times of the motion [ns], shape (n,).

        Raises:
            DataError: The loads do not cover the motion.
        """
        return [self._samples(load, stamps) for load in self._loads]

    def _samples(self, load: ExternalLoad, stamps: NDArray[np.int64]) -> Array:
        from scipy.interpolate import CubicSpline  # only where there are such loads

        self._check_times(load, stamps)
        begin = load.stamps[0]
        known = (load.stamps - begin) * NANOSECOND
        margin = np.diff(known).max(initial=0.0)  # extrapolate by at most one step
        times = np.clip((stamps - begin) * NANOSECOND, -margin, known[-1] + margin)
        values = np.hstack([load.force, load.point, load.torque])
        if len(known) == 1:
            force, point, torque = np.split(np.repeat(values, len(stamps), axis=0), 3, axis=1)
        else:
            spline = CubicSpline(known, values, bc_type="natural")
            force, point, torque = np.split(spline(times), 3, axis=1)
        return np.hstack([force, torque + np.cross(point, force)])

    def _check_times(self, load: ExternalLoad, stamps: NDArray[np.int64]) -> None:
        """Refuse loads that do not cover the motion, with a tolerance of one step."""
        first, last = load.stamps[[0, -1]]
        steps = [np.diff(times).max(initial=0) for times in (load.stamps, stamps)]
        step = max(steps)  # a filter that resamples may start up to one step earlier
        if first - step <= stamps[0] and stamps[-1] <= last + step:
            return
        is_disjoint = last < stamps[0] or first > stamps[-1]
        reason = "the times do not overlap" if is_disjoint else "the loads do not cover the motion"
        raise DataError(
            f"{load.source}: loads at {_range(load.stamps)} s, the motion at {_range(stamps)} s: "
            f"{reason} ({self._path}: {load.name})"
        )


def _entry(scene: Scene, path: Path, load: ExternalLoad) -> dict[str, str]:
    """Return the load as an entry of `external_wrenches`."""
    frames = []
    for body in (load.body, load.frame):
        try:
            scene.robot.frame(body)
        except ModelError as error:
            if body != GROUND:
                raise DataError(f"{path}: ExternalForce {load.name}: {error}") from error
            body = _WORLD
        frames.append(body)
    return {"frame": frames[0], "expressed_in": frames[1]}


def _range(stamps: Sequence[int] | NDArray[np.int64]) -> str:
    return f"{stamps[0] * NANOSECOND:.6g} to {stamps[-1] * NANOSECOND:.6g}"


def read_loads(
    scene: Scene, motion: Source, wrenches: Source | None, axes: str | None = None
) -> tuple[dict[str, WrenchSamples], Counter[str]]:
    """Read the samples of the external loads of a scene.

    Args:
        scene: The scene.
        motion: Result, file or bag of the motion; a bag contains its wrenches itself.
        wrenches: Result, file or bag of the wrenches, or None.
        axes: Recorded axis along each axis of the scene, see `axes_matrix`; by default the axes
            are the same.

    Returns:
        The samples, and the number of messages left out, by reason.

    Raises:
        DataError: A file cannot be read or has no use, or a wrench is in another frame than that
            of the scene.
    """
    refuse_unused(scene, wrenches)
    dropped: Counter[str] = Counter()
    if not scene.wrenches:
        return {}, dropped
    source = motion if wrenches is None else wrenches
    if wrenches is None and (isinstance(source, Result) or not is_bag(source)):
        raise DataError(
            f"{scene.name}: external_wrenches {', '.join(scene.wrenches)}: a table of joints does "
            "not contain them; give --wrenches FILE"
        )
    topics = {name: wrench.topic for name, wrench in scene.wrenches.items()}
    loads = read_wrenches(source, topics, dropped=dropped)
    for name, samples in loads.items():
        expected = scene.wrenches[name].expressed_in
        if samples.frame_id not in ("", expected):
            raise DataError(
                f"{name_of(source)}: wrench '{name}' is in frame '{samples.frame_id}', the scene "
                f"expects '{expected}'"
            )
    if axes is not None:
        loads = {name: _in_scene_axes(samples, source, axes) for name, samples in loads.items()}
    return loads, dropped


def _in_scene_axes(samples: WrenchSamples, source: Source, axes: str) -> WrenchSamples:
    """Return a load in the axes of the scene."""
    screen: Sequence[str] = ()
    if axes == SCREEN and (isinstance(source, Result) or not is_bag(source)):
        result = source if isinstance(source, Result) else read_result(source)
        screen = result.metadata.get(SCREEN, ())
    R = axes_matrix(f"{name_of(source)}: --wrench-axes", axes, screen)
    parts = samples.wrench.reshape(-1, 2, 3) @ R.T
    return samples._replace(wrench=parts.reshape(-1, 6))


def wrench_at(where: str, name: str, samples: WrenchSamples, stamps: np.ndarray) -> Array:
    """Return a load at the stamps of a motion, shape (n, 6).

    Args:
        where: File, for the message.
        name: Name of the load.
        samples: Samples of the load.
        stamps: Stamps of the motion [ns], shape (n,).

    Raises:
        DataError: The samples do not cover the motion.
    """
    wrench = at_stamps(samples, stamps, round(WRENCH_MAX_AGE / NANOSECOND))
    uncovered = np.flatnonzero(np.isnan(wrench[:, 0]))
    if len(uncovered):
        raise DataError(
            f"{where}: wrench '{name}' covers {samples.stamps[0] / 1e9} to "
            f"{samples.stamps[-1] / 1e9} s, not the motion at {stamps[uncovered[0]] / 1e9} s"
        )
    return wrench


def refuse_unused(scene: Scene, wrenches: Source | None) -> None:
    """Refuse a file of loads for a scene that has no external loads.

    Raises:
        DataError: The scene has no `external_wrenches`.
    """
    if wrenches is not None and not scene.wrenches:
        raise DataError(
            f"--wrenches {name_of(wrenches)}: {scene.name} has no external_wrenches to take it"
        )
