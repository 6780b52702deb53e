"""Inextensible rope along a path."""

from typing import Annotated

from mbd_ros.core.kinematics.paths.paths import Path
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import OptionalDuration, Restitution, Unit
from mbd_ros.core.rows.constraint import unilateral
from mbd_ros.core.rows.path_rows import PathRow
from mbd_ros.errors import ModelError


class Rope(PathRow):
    """Inextensible rope without mass and friction: g = length - l >= 0, tension >= 0.

    The rope is slack while l < length. When it becomes taut there is an impact with Poisson's
    restitution. A smoothed rope acts as soon as g'' + 2 g' / T + g / T^2 would be negative, so
    that it becomes taut exponentially and without an impact.

    Args:
        path: Route of the rope: the name of a path of the scene, or the entry of a path.
        length: Length of the rope.
        restitution: Poisson's coefficient of restitution, the ratio of the impulse of expansion to
            that of compression.
        smoothed: Whether the rope is solved for in every evaluation instead of switching at
            events, which lowers the order of the integrator; `time_constant` implies it.
        time_constant: Time constant T of a smoothed rope, 0.01 s by default.
    """

    example = {
        "path": {"points": [{"frame": "world", "xyz": [0.1, 0.0, 1.0]}, {"frame": "foot"}]},
        "length": 1.5,
        "restitution": 0.2,
    }

    def __init__(
        self,
        robot: Robot,
        *,
        path: Path,
        length: Annotated[float, Unit("m")],
        restitution: Annotated[Restitution, Unit("-")] = 0.0,
        smoothed: bool = False,
        time_constant: OptionalDuration = None,
    ) -> None:
        super().__init__(path, length)
        self.law = unilateral(restitution)
        self.smoothed = smoothed or time_constant is not None
        T = 0.01 if time_constant is None else time_constant
        self.gains = (1.0 / T**2, 2.0 / T)

    @staticmethod
    def check(restitution: float, smoothed: bool, time_constant: float | None) -> None:
        """Refuse restitution of a smoothed rope."""
        if restitution > 0.0 and (smoothed or time_constant is not None):
            raise ModelError(
                f"restitution {restitution:g} is not accepted with smoothed or time_constant, "
                "since a smoothed rope does not bounce"
            )
