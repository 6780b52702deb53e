"""External loads of a recorded motion."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from mbd_ros.core.model.wrenches import at_stamps
from mbd_ros.core.state import NANOSECOND, Array, WrenchSamples
from mbd_ros.errors import DataError
from mbd_ros.files.formats import is_bag, read_result
from mbd_ros.files.markers import SCREEN
from mbd_ros.files.table import Result
from mbd_ros.motion.recorded_axes import axes_matrix
from mbd_ros.motion.recordings import Source, name_of, read_wrenches
from mbd_ros.scene.built_scene import Scene

WRENCH_MAX_AGE = 0.1  # s


def read_loads(
    scene: Scene, motion: Source, wrenches: Source | None, axes: str | None = None
) -> tuple[dict[str, WrenchSamples], Counter[str]]:
    """Samples of the loads of a scene, and messages left out, counted by reason.

    Args:
        scene: The scene.
        motion: Result, file or bag of the motion; a bag carries its wrenches itself.
        wrenches: Result, file or bag of the wrenches, or None.
        axes: Recorded axis along each axis of the scene, see `recorded_axes`; None: the same.

    Raises:
        DataError: A file that cannot be read or that the scene has no use for, or a wrench in
            another frame than that of the scene.
    """
    refuse_unused(scene, wrenches)
    dropped: Counter[str] = Counter()
    if not scene.wrenches:
        return {}, dropped
    source = motion if wrenches is None else wrenches
    if wrenches is None and (isinstance(source, Result) or not is_bag(source)):
        raise DataError(
            f"{scene.name}: external_wrenches {', '.join(scene.wrenches)}: a table of joints does "
            "not carry them; give --wrenches FILE"
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
        loads = {name: _turned(samples, source, axes) for name, samples in loads.items()}
    return loads, dropped


def _turned(samples: WrenchSamples, source: Source, axes: str) -> WrenchSamples:
    """A load in axes of the scene."""
    screen: Sequence[str] = ()
    if axes == SCREEN and (isinstance(source, Result) or not is_bag(source)):
        result = source if isinstance(source, Result) else read_result(source)
        screen = result.metadata.get(SCREEN, ())
    R = axes_matrix(f"{name_of(source)}: --wrench-axes", axes, screen)
    parts = samples.wrench.reshape(-1, 2, 3) @ R.T
    return samples._replace(wrench=parts.reshape(-1, 6))


def refuse_unused(scene: Scene, wrenches: Source | None) -> None:
    """Refuse a file of loads for a scene without any.

    Raises:
        DataError: The scene has no `external_wrenches`.
    """
    if wrenches is not None and not scene.wrenches:
        raise DataError(
            f"--wrenches {name_of(wrenches)}: {scene.name} has no external_wrenches to take it"
        )


def wrench_at(name: str, samples: WrenchSamples, stamps: np.ndarray) -> Array:
    """A load at the stamps of a motion, shape (n, 6).

    Raises:
        DataError: It does not cover the motion.
    """
    wrench = at_stamps(samples, stamps, round(WRENCH_MAX_AGE / NANOSECOND))
    lacking = np.flatnonzero(np.isnan(wrench[:, 0]))
    if len(lacking):
        raise DataError(
            f"wrench '{name}' covers {samples.stamps[0] / 1e9} to {samples.stamps[-1] / 1e9} s, "
            f"not the motion at {stamps[lacking[0]] / 1e9} s"
        )
    return wrench
