"""Names of independent velocities, for messages to people."""

from collections.abc import Iterable

from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot


def coordinate_names(robot: Robot, couplings: Couplings) -> list[str]:
    """Joints, and of a free base its name and axis, in the order of y'."""
    return velocity_names(robot, couplings.v_index)


def velocity_names(robot: Robot, chosen: Iterable[int]) -> list[str]:
    """The same of some velocities."""
    names = {int(joint.v): joint.name for joint in robot.joints}
    for base in robot.bases:
        words = (f"{kind}_{axis}" for kind in ("linear", "angular") for axis in "xyz")
        names |= {base.v.start + i: f"{base.name}.{word}" for i, word in enumerate(words)}
    return [names[int(v)] for v in chosen]
