"""Cable that pulls and never pushes."""

from typing import Annotated

import numpy as np

from mbd_ros.core.dynamics.path_load import PathLoad
from mbd_ros.core.events.switching import DiscontinuousForce
from mbd_ros.core.model.kinematics import Kinematics
from mbd_ros.core.model.paths import Path
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Unit
from mbd_ros.core.state import Array, State


class Cable(PathLoad, DiscontinuousForce):
    """Massless elastic cable without friction along a path of length l.

        F = max(0, stiffness s + damping s')  where the stretch s = l - slack_length > 0, else 0

    It is slack at s <= 0. With damping F jumps where the cable becomes taut; `filippov` ends its
    steps there. The damper never pushes: a cable that shortens fast enough carries no force.

    Args:
        robot: Robot of the scene.
        path: What it goes over: the name of a path of the scene, or a path of its own.
        stiffness: Of the whole cable.
        damping: Of the whole cable.
        slack_length: Length below which it is slack.

    Raises:
        ModelError: As the path says.
    """

    example = {
        "path": {
            "points": [
                {"frame": "world", "point": [0.1, 0.0, 1.0]},
                {"frame": "femoral_pylon", "point": [0.05, 0.0, -0.2]},
                {"frame": "foot"},
            ]
        },
        "stiffness": 2000.0,
        "damping": 10.0,
        "slack_length": 0.3,
    }
    surfaces = ("slack",)

    def __init__(
        self,
        robot: Robot,
        *,
        path: Path,
        stiffness: Annotated[NotNegative, Unit("N/m")],
        slack_length: Annotated[float, Unit("m")],
        damping: Annotated[NotNegative, Unit("N·s/m")] = 0.0,
    ) -> None:
        super().__init__(path)
        self._stiffness, self._damping, self._slack = stiffness, damping, slack_length

    def tension(self, k: Kinematics, x: State, u: Array, length: float, speed: float) -> float:
        """The F [N]."""
        return k.where(length > self._slack, self._taut(k, length, speed), 0.0)

    def potential(self, k: Kinematics, x: State) -> float:
        """Energy of the stretch, zero while it is slack [J]."""
        stretch = k.maximum(self.path.length(k, x) - self._slack, 0.0)
        return 0.5 * self._stiffness * stretch * stretch

    def heights(self, k: Kinematics, x: State) -> Array:
        """The stretch s [m], shape (1,)."""
        return np.array([self.path.length(k, x) - self._slack])

    def rates(self, k: Kinematics, x: State, a: Array) -> Array:
        """The s' [m/s], shape (1,)."""
        return np.array([k.dot(self.path.measured(k, x)[1], x.v)])

    def blend(self, k: Kinematics, x: State, signs: Array) -> Array:
        """The (1 + s) / 2 of the force of a taut cable, shape (nv,)."""
        length, slope = self.path.measured(k, x)
        share = 0.5 * (1.0 + signs.item(0))
        tau: Array = slope * (-share * self._taut(k, length, k.dot(slope, x.v)))
        return tau

    def _taut(self, k: Kinematics, length: float, speed: float) -> float:
        pull = self._stiffness * (length - self._slack) + self._damping * speed
        return k.maximum(pull, 0.0)
