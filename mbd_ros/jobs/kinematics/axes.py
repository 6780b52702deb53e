"""Axes of a recording: written as `x,z,-y`, the recorded axis along each axis of the scene."""

from collections.abc import Iterator
from itertools import permutations, product

import numpy as np

from mbd_ros.core.estimation.marker_cost import Seen
from mbd_ros.core.estimation.marker_fit import Bools, Fit
from mbd_ros.core.estimation.marker_kinematics import MarkerKinematics
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.files.markers import SCREEN
from mbd_ros.jobs.kinematics.capture import Capture

_AS_RECORDED = "x,y,z"
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
    if axes == SCREEN:
        if not capture.screen:
            raise DataError(f"{capture.where}: --axes screen: it has no POINT:X_SCREEN, Y_SCREEN")
        axes = _right_handed(capture.where, capture.screen)
    return capture._replace(places=capture.places @ _matrix(capture.where, axes).T)


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
    for axes in _every():
        places = (seen.places + origin) @ _rows(axes.split(",")).T - origin
        fit = solver.first(start, seen._replace(places=places))
        found.append((_rms(fit.misses[0, there]), float(np.abs(fit.q[0] - start).sum()), axes))
    least = min(found)[0]
    good = [one for one in found if one[0] <= _AS_GOOD * least]
    after, _, axes = min(good, key=lambda one: one[1])
    return axes, after


def _rms(vectors: Array) -> float:
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))


def _every() -> Iterator[str]:
    """All turns by right angles but none."""
    for order, signs in product(permutations("xyz"), product(("", "-"), repeat=3)):
        axes = ",".join(sign + axis for sign, axis in zip(signs, order, strict=True))
        if axes != _AS_RECORDED and np.linalg.det(_rows(axes.split(","))) > 0.0:
            yield axes


def _rows(names: list[str]) -> Array:
    """A unit vector a name."""
    rows = np.zeros((3, 3))
    for i, name in enumerate(names):
        rows[i, "xyz".index(name[-1])] = -1.0 if name.startswith("-") else 1.0
    return rows


def _matrix(where: str, axes: str) -> Array:
    """From recorded axes to those of the scene."""
    names = [name.strip().lower().removeprefix("+") for name in axes.split(",")]
    accepted = "accepted: three of x, y, z, -x, -y, -z, as x,z,-y, or screen"
    if sorted(name.removeprefix("-") for name in names) != ["x", "y", "z"]:
        raise DataError(f"{where}: --axes {axes}: {accepted}")
    rows = _rows(names)
    if np.linalg.det(rows) < 0.0:
        raise DataError(f"{where}: --axes {axes} is a mirror image; {accepted}")
    return rows


def _right_handed(where: str, screen: tuple[str, str]) -> str:
    """Three axes, the last one square to what a screen shows."""
    names = [name.strip().lower().removeprefix("+") for name in screen]
    if not {name.removeprefix("-") for name in names} < set("xyz") or len(set(names)) < 2:
        told = ", ".join(screen)
        raise DataError(f"{where}: POINT:X_SCREEN, Y_SCREEN are {told}, accepted: as +X, +Z")
    (last,) = set("xyz") - {name.removeprefix("-") for name in names}
    axes = [*names, last]
    sign = "" if np.linalg.det(_rows(axes)) > 0.0 else "-"
    return ",".join([*names, sign + last])
