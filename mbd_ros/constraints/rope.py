"""A path that gets no longer than its rope."""

from typing import Annotated

from mbd_ros.core.model.paths import Path
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Unit, Within
from mbd_ros.core.row_laws import unilateral
from mbd_ros.core.rows.path_rows import PathRow


class Rope(PathRow):
    """Massless rope without friction that does not stretch: g = length - l >= 0, tension >= 0.

    It is slack while l < length. Where it becomes taut there is an impact. With `time_constant` T
    it is smoothed: the rope acts as soon as g'' + 2 g' / T + g / T^2 would be negative, so that it
    becomes taut exponentially and without an impact.

    Args:
        robot: Robot of the scene.
        path: What it goes over: the name of a path of the scene, or a path of its own.
        length: Length of the rope.
        restitution: Share of the impulse of an impact that its expansion gives back.
        time_constant: T with which it becomes taut; None: exact, with impacts.

    Raises:
        ModelError: As the path says.
    """

    example = {
        "path": {"points": [{"frame": "world", "point": [0.1, 0.0, 1.0]}, {"frame": "foot"}]},
        "length": 1.5,
        "time_constant": 0.02,
    }

    def __init__(
        self,
        robot: Robot,
        *,
        path: Path,
        length: Annotated[float, Unit("m")],
        restitution: Annotated[float, Within(0.0, 1.0), Unit("-")] = 0.0,
        time_constant: Annotated[float | None, Within(1.0e-9, 1.0e9), Unit("s")] = None,
    ) -> None:
        super().__init__(path, length)
        self.law, self.smoothed = unilateral(restitution), time_constant is not None
        if time_constant is not None:
            self.gains = (1.0 / time_constant**2, 2.0 / time_constant)
