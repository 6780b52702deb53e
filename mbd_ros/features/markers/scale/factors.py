"""Factors of segments: distances of markers in a static trial over those in the model."""

from collections.abc import Iterator, Mapping

import numpy as np

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, ModelError
from mbd_ros.features.markers.matching import markers_of
from mbd_ros.features.markers.scale_task import ScaleTask
from mbd_ros.motion.marker_recording import Capture
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.schema.nearest import nearest

_SANE = (0.2, 5.0)  # factors that a person may have
_AXES = "xyz"


def factors_of(scene: Scene, capture: Capture, task: ScaleTask) -> dict[str, Array]:
    """Link -> factors along its axes, shape (3,).

    Args:
        scene: The scene; distances of its markers are those at its start.
        capture: The static trial; distances are means over its frames.
        task: What is measured.

    Raises:
        DataError: An unknown link or marker, a marker that was not seen, or a factor that no
            person has.
    """
    shown, seen = _shown(scene), _seen(capture)
    factors = {}
    for link, measurements in task.segments.items():
        try:
            scene.robot.frame(link)
        except ModelError as error:
            raise DataError(f"scale: {error}") from error
        factor = np.ones(3)
        for one in measurements:
            value = one.factor
            if value is None:
                ratios = [_ratio(capture.where, shown, seen, *pair) for pair in one.pairs]
                value = float(np.mean(ratios))
            if not _SANE[0] <= value <= _SANE[1]:
                raise DataError(
                    f"{capture.where}: {link} would be scaled by {value:.4g}, accepted: "
                    f"{_SANE[0]:g} .. {_SANE[1]:g}; is the unit right?"
                )
            factor[[_AXES.index(axis) for axis in one.axes]] = value
        factors[link] = factor
    return factors


def factor_lines(factors: Mapping[str, Array]) -> Iterator[str]:
    """A line a link, for people."""
    for link, (x, y, z) in factors.items():
        yield f"{link}: x {x:.6g}, y {y:.6g}, z {z:.6g}"


def _shown(scene: Scene) -> dict[str, Array]:
    """Label -> place in the model at the start."""
    k, x = Kinematics(scene.robot), scene.initial
    k.refresh(x.q, x.v)
    return {m.title: np.array(k.position(m.point)) for m in markers_of(scene)}


def _seen(capture: Capture) -> dict[str, Array]:
    """Label -> places, shape (N, 3)."""
    return {label: capture.places[:, i] for i, label in enumerate(capture.labels)}


def _ratio(
    where: str, shown: Mapping[str, Array], seen: Mapping[str, Array], a: str, b: str
) -> float:
    for label in (a, b):
        for known, what in ((shown, "the scene"), (seen, where)):
            if label not in known:
                close = nearest(label, known, 1)
                hint = f"; the nearest is {close[0]}" if close else ""
                raise DataError(f"scale: no marker {label} in {what}{hint}")
    apart = np.linalg.norm(seen[a] - seen[b], axis=1)
    apart = apart[np.isfinite(apart)]
    own = float(np.linalg.norm(shown[a] - shown[b]))
    if not len(apart) or own < 1.0e-6:
        why = "are never seen together" if not len(apart) else "are at one place in the scene"
        raise DataError(f"{where}: markers {a} and {b} {why}")
    return float(apart.mean()) / own
