"""The search of paths that wrap, in native code where it can be compiled."""

from collections.abc import Callable, Sequence
from typing import Any

from mbd_ros.core.kinematics.paths.paths import Path
from mbd_ros.core.kinematics.paths.wrap_surface import Placed
from mbd_ros.core.kinematics.paths.wrapped_path import Taut, taut
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array
from mbd_ros.scene.runs.compiling import Impossible, attempted


class QuickestSearch:
    """Taut paths by native code, by numpy where there is no compiler; made when one is asked for.

    Both find the same paths to rounding.
    """

    def __init__(self) -> None:
        self._native: Any = None
        self._is_tried = False

    def prepare(self) -> None:
        """Compile what is not yet."""
        if not self._is_tried:
            self._native, self._is_tried = _native(_search), True

    def __call__(self, path: Any, points: Array, places: Sequence[Placed]) -> Taut:
        """Return the taut path of a `WrappedPath`, see `wrapping.taut.taut`."""
        self.prepare()
        if self._native is None:
            return taut(points, path.reaches, places)
        found: Taut = self._native(path, points, places)
        return found


def state_paths(
    robot: Robot, data: Any, couplings: Couplings, paths: Sequence[Path], width: int
) -> Any:
    """A `compiled.runs.paths.StatePaths`, or None where there cannot be one."""

    def take() -> Any:
        from mbd_ros.compiled.runs.paths import StatePaths, is_known

        known = all(map(is_known, paths))
        return StatePaths(robot, data, couplings, paths, width) if known else None

    return _native(take)


def _search() -> Any:
    from mbd_ros.compiled.runs.paths import PathSearch

    return PathSearch()


def _native(take: Callable[[], Any]) -> Any:
    try:
        return attempted(take)
    except Impossible:  # numpy does the same
        return None
