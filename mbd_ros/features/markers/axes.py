"""Markers in other axes than the scene: turned, or recognised."""

from collections.abc import Iterator

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.features.markers.marker_cost import Seen
from mbd_ros.features.markers.marker_fit import Bools, Fit
from mbd_ros.features.markers.marker_kinematics import MarkerKinematics
from mbd_ros.motion.marker_recording import Capture
from mbd_ros.motion.recorded_axes import axes_matrix, other_axes

_WIDE = 0.1  # of the size of the cloud of markers: misses that ask for a reason
_AS_GOOD = 1.05  # of the smallest misses: as good
_EXPLAINS = 0.2  # of the misses: what is left with the right axes


def turned(capture: Capture, axes: str) -> Capture:
    """Markers in axes of the scene.

    Args:
        capture: As recorded.
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
        solver: The solver.
        start: Default configuration, shape (nq,).
        capture: The recording.
        seen: What was seen.
        fit: What was found.
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
