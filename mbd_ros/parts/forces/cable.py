"""Elastic cable that pulls and never pushes."""

from typing import Annotated

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.kinematics.paths.paths import Path
from mbd_ros.core.loads.path_load import PathLoad
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Unit
from mbd_ros.core.state import Array, State


class Cable(PathLoad):
    """Elastic cable without mass and friction along a path of length l.

        F = max(0, stiffness s + damping s')  where the stretch s = l - slack_length > 0, else 0

    The cable never pushes: if it shortens fast enough, its damper cancels the tension. With
    damping, F jumps where the cable becomes taut.

    Args:
        path: Route of the cable: the name of a path of the scene, or the entry of a path.
        stiffness: Stiffness of the whole cable.
        damping: Damping of the whole cable.
        slack_length: Length up to which the cable is slack.
    """

    example = {
        "path": {
            "points": [
                {"frame": "world", "xyz": [0.1, 0.0, 1.0]},
                {"frame": "femoral_pylon", "xyz": [0.05, 0.0, -0.2]},
                {"frame": "foot"},
            ]
        },
        "stiffness": 2000.0,
        "damping": 10.0,
        "slack_length": 0.3,
    }

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
        self._stiffness = stiffness
        self._damping = damping
        self._slack = slack_length

    def tension(self, k: Kinematics, x: State, u: Array, length: float, speed: float) -> float:
        """Return the tension F [N]."""
        stretch = length - self._slack
        pull = k.maximum(self._stiffness * stretch + self._damping * speed, 0.0)
        return k.where(stretch > 0.0, pull, 0.0)

    def potential(self, k: Kinematics, x: State) -> float:
        """Return the elastic energy [J], which is zero while the cable is slack."""
        stretch = k.maximum(self.path.length(k, x) - self._slack, 0.0)
        return 0.5 * self._stiffness * stretch * stretch
