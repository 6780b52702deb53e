"""Path of constant length."""

from typing import Annotated

from mbd_ros.core.kinematics.paths.paths import Path
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Unit
from mbd_ros.core.rows.path_rows import PathRow


class PathLength(PathRow):
    """Inextensible tendon that never becomes slack: l = length, without friction and mass.

    A path over several joints couples these joints. The tension may be negative, so the tendon can
    push; a `rope` cannot.

    Args:
        path: Route of the tendon: the name of a path of the scene, or the entry of a path.
        length: Length of the path.
    """

    example = {"path": {"joints": {"knee": 0.04, "ankle": -0.03}}, "length": 0.01}

    def __init__(self, robot: Robot, *, path: Path, length: Annotated[float, Unit("m")]) -> None:
        super().__init__(path, length)
