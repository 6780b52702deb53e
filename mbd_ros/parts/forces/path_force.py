"""A tension along a path that is an input."""

import math
from typing import Annotated

from mbd_ros.core.contracts import Channel
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.kinematics.paths.paths import Path
from mbd_ros.core.loads.path_load import PathLoad
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Positive, Unit
from mbd_ros.core.state import Array, State


class PathForce(PathLoad):
    """Tension along a path as it is asked for: F = u, at most `limit` in either direction.

    Positive values shorten the path, negative ones push it apart. No inertia, friction or delay.

    Args:
        path: What it goes over: the name of a path of the scene, or a path of its own.
        limit: Largest tension; without it there is none.
    """

    example = {
        "path": {"points": [{"frame": "world", "xyz": [0.1, 0.0, 1.0]}, {"frame": "foot"}]},
        "limit": 200.0,
    }

    def __init__(
        self, robot: Robot, *, path: Path, limit: Annotated[Positive, Unit("N")] = math.inf
    ) -> None:
        super().__init__(path)
        self._limit = limit
        self.inputs = (Channel("", "N", -limit, limit),)

    def tension(self, k: Kinematics, x: State, u: Array, length: float, speed: float) -> float:
        """The F [N]."""
        asked = u[self.u]
        if self._limit < math.inf:
            asked = k.within(asked, -self._limit, self._limit)
        return k.item(asked, 0)

    def columns(self, k: Kinematics, x: State) -> Array:
        """Moment arms -J', shape (nv, 1)."""
        _, slope = self.path.measured(k, x)
        columns: Array = -slope.reshape(-1, 1)
        return columns
