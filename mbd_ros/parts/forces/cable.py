"""Cable that pulls and never pushes."""

from typing import Annotated

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.kinematics.paths.paths import Path
from mbd_ros.core.loads.path_load import PathLoad
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Unit
from mbd_ros.core.state import Array, State


class Cable(PathLoad):
    """Massless elastic cable without friction along a path of length l.

        F = max(0, stiffness s + damping s')  where the stretch s = l - slack_length > 0, else 0

    It is slack at s <= 0, and the damper never pushes: a cable that shortens fast enough carries
    no force. With damping F jumps where the cable becomes taut.

    Args:
        path: What it goes over: the name of a path of the scene, or a path of its own.
        stiffness: Of the whole cable.
        damping: Of the whole cable.
        slack_length: Length below which it is slack.
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
        """The F [N]."""
        stretch = length - self._slack
        pull = k.maximum(self._stiffness * stretch + self._damping * speed, 0.0)
        return k.where(stretch > 0.0, pull, 0.0)

    def potential(self, k: Kinematics, x: State) -> float:
        """Energy of the stretch, zero while it is slack [J]."""
        stretch = k.maximum(self.path.length(k, x) - self._slack, 0.0)
        return 0.5 * self._stiffness * stretch * stretch
