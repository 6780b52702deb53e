"""Tension along a path that is an input."""

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
    """Commanded tension along a path: F = u, at most `limit` in either direction.

    A positive tension shortens the path, a negative one lengthens it. Inertia, friction and delay
    are left out.

    Args:
        path: Route of the force: the name of a path of the scene, or the entry of a path.
        limit: Largest tension; unlimited by default.
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
        """Return the tension F [N]."""
        tension = u[self.u]
        if self._limit < math.inf:
            tension = k.within(tension, -self._limit, self._limit)
        return k.item(tension, 0)

    def columns(self, k: Kinematics, x: State) -> Array:
        """Return the moment arms -J', shape (nv, 1)."""
        _, jacobian = self.path.measured(k, x)
        columns: Array = -jacobian.reshape(-1, 1)
        return columns
