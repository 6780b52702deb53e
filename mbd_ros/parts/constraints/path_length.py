"""A path that keeps its length."""

from typing import Annotated

from mbd_ros.core.kinematics.paths.paths import Path
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Unit
from mbd_ros.core.rows.path_rows import PathRow


class PathLength(PathRow):
    """Inextensible tendon that is always taut: l = length, without friction and mass.

    Over several joints it couples them; over points it is a bar that bends. A negative tension
    pushes: this is no rope.

    Args:
        path: What it goes over: the name of a path of the scene, or a path of its own.
        length: Of the path.
    """

    example = {"path": {"joints": {"knee": 0.04, "ankle": -0.03}}, "length": 0.01}

    def __init__(self, robot: Robot, *, path: Path, length: Annotated[float, Unit("m")]) -> None:
        super().__init__(path, length)
