"""External loads as a laboratory writes them, beside a motion: `--external LOADS.xml`."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import DataError, ModelError
from mbd_ros.files.laboratory.external_loads import GROUND, ExternalLoad, read_external_loads
from mbd_ros.scene.built_scene import Scene

_WORLD = "world"


class ExternalLoads:
    """Loads of an .xml, and the scene that carries them.

    Args:
        scene: Its own `external_wrenches` give way to those of the file.
        path: The .xml.

    Attributes:
        scene: The scene with a load of every force.
        remarks: What is odd about their files, for people.

    Raises:
        DataError: A file that cannot be read, or a body that the scene lacks.
    """

    def __init__(self, scene: Scene, path: Path) -> None:
        self._path, self._loads = path, read_external_loads(path)
        told = (f"{load.source}: {text}" for load in self._loads for text in load.remarks)
        self.remarks = list(dict.fromkeys(told))
        self.scene = scene.with_(
            external_wrenches={load.name: _entry(scene, path, load) for load in self._loads}
        )

    def at(self, stamps: NDArray[np.int64]) -> list[Array]:
        """Force and torque about the origin of its frame, for each load, shape (n, 6).

        Forces, points and torques are natural cubic splines of their own, as OpenSim has them.

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
        beyond = np.diff(known).max(initial=0.0)  # a spline goes on for a step of its own
        times = np.clip((stamps - begin) * NANOSECOND, -beyond, known[-1] + beyond)
        whole = np.hstack([load.force, load.point, load.torque])
        if len(known) == 1:
            force, point, torque = np.split(np.repeat(whole, len(stamps), axis=0), 3, axis=1)
        else:
            spline = CubicSpline(known, whole, bc_type="natural")
            force, point, torque = np.split(spline(times), 3, axis=1)
        return np.hstack([force, torque + np.cross(point, force)])

    def _check_times(self, load: ExternalLoad, stamps: NDArray[np.int64]) -> None:
        """Refuse loads that do not reach over the motion, but for a step of one of both."""
        first, last = load.stamps[[0, -1]]
        steps = [np.diff(times).max(initial=0) for times in (load.stamps, stamps)]
        step = max(steps)  # a filter that resamples begins up to a step earlier
        if first - step <= stamps[0] and stamps[-1] <= last + step:
            return
        ours, theirs = (_range(times) for times in (stamps, load.stamps))
        apart = last < stamps[0] or first > stamps[-1]
        what = "the times do not overlap" if apart else "the loads do not cover the motion"
        raise DataError(
            f"{load.source}: loads at {theirs} s, the motion at {ours} s: {what} "
            f"({self._path}: {load.name})"
        )


def _range(stamps: Sequence[int] | NDArray[np.int64]) -> str:
    return f"{stamps[0] * NANOSECOND:.6g} to {stamps[-1] * NANOSECOND:.6g}"


def _entry(scene: Scene, path: Path, load: ExternalLoad) -> dict[str, str]:
    """The load as an entry of `external_wrenches`."""
    places = []
    for body in (load.body, load.frame):
        try:
            scene.robot.frame(body)
        except ModelError as error:
            if body != GROUND:
                raise DataError(f"{path}: ExternalForce {load.name}: {error}") from error
            body = _WORLD
        places.append(body)
    return {"frame": places[0], "expressed_in": places[1]}
