"""Spring along a path whose damping is proportional to its tension."""

from typing import Annotated

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.kinematics.paths.paths import Path
from mbd_ros.core.loads.path_load import PathLoad
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Unit
from mbd_ros.core.state import Array, State


class PathSpring(PathLoad):
    """Spring along a path of length l that is slack below its resting length.

        F = stiffness s (1 + dissipation l')  where the stretch s = l - resting_length > 0, else 0

    Unlike the force of a `cable` with damping, F is continuous where the spring becomes taut. The
    spring pushes while the path shortens faster than 1 / dissipation.

    Source: OpenSim's PathSpring; A. Seth et al., PLoS Comput. Biol. 14, 2018, e1006223.

    Args:
        path: Route of the spring: the name of a path of the scene, or the entry of a path.
        stiffness: Stiffness of the whole spring.
        resting_length: Length up to which the spring is slack.
        dissipation: Relative increase of the tension per speed of lengthening.
    """

    example = {
        "path": {"points": [{"frame": "world", "xyz": [0.1, 0.0, 1.0]}, {"frame": "foot"}]},
        "stiffness": 2000.0,
        "resting_length": 0.3,
        "dissipation": 0.1,
    }

    def __init__(
        self,
        robot: Robot,
        *,
        path: Path,
        stiffness: Annotated[NotNegative, Unit("N/m")],
        resting_length: Annotated[NotNegative, Unit("m")],
        dissipation: Annotated[NotNegative, Unit("s/m")] = 0.0,
    ) -> None:
        super().__init__(path)
        self._stiffness = stiffness
        self._resting_length = resting_length
        self._dissipation = dissipation

    def tension(self, k: Kinematics, x: State, u: Array, length: float, speed: float) -> float:
        """Return the tension F [N]."""
        stretch = k.maximum(length - self._resting_length, 0.0)
        return self._stiffness * stretch * (1.0 + self._dissipation * speed)

    def potential(self, k: Kinematics, x: State) -> float:
        """Return the elastic energy [J], which is zero while the spring is slack."""
        stretch = k.maximum(self.path.length(k, x) - self._resting_length, 0.0)
        return 0.5 * self._stiffness * stretch * stretch
