"""Joints that close loops: a body is cut in two halves that a constraint holds together."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import pinocchio as pin

from mbd_ros.scene.models.names import Names
from mbd_ros.scene.models.osim.constraints import placed
from mbd_ros.scene.models.osim.frames import GROUND, Attached
from mbd_ros.scene.models.osim.mechanism import turned_round
from mbd_ros.scene.models.osim.motions import Joint
from mbd_ros.scene.models.urdf_text import Mass

_DIRECT = {"WeldJoint": "full", "BallJoint": "point"}  # which need no second half


class Cut(NamedTuple):
    """Loops that are open.

    Attributes:
        joints: Joints to the second halves, in the order of the file.
        halves: Name of a second half -> the body.
        closures: Name of a joint -> the constraint that closes its loop.
    """

    joints: list[Joint]
    halves: dict[str, str]
    closures: dict[str, dict[str, Any]]


def cut(loops: Sequence[Joint], taken: Sequence[str]) -> Cut:
    """Open loops at the children of the joints that close them.

    Args:
        loops: The joints.
        taken: Names that links have.
    """
    found, names = Cut([], {}, {}), Names(taken)
    for given in loops:
        joint = turned_round(given) if given.child.body == GROUND else given
        closure: dict[str, Any] = {"type": "loop_closure"}
        if joint.item.type in _DIRECT:
            closure["kind"] = _DIRECT[joint.item.type]
            closure |= placed("a", joint.parent) | placed("b", joint.child)
        else:
            half = names.take(f"{joint.child.body}_{joint.name}")
            found.halves[half] = joint.child.body
            found.joints.append(joint._replace(child=Attached(half, joint.child.at)))
            whole, other = (
                Attached(name, pin.SE3.Identity()) for name in (joint.child.body, half)
            )
            closure |= {"kind": "full"} | placed("a", whole) | placed("b", other)
        found.closures[joint.name] = closure
    return found


def shared(masses: dict[str, Mass], halves: dict[str, str]) -> dict[str, Mass]:
    """Masses with each body that is cut shared evenly by its parts."""
    found = dict(masses)
    for body in set(halves.values()):
        parts = [body, *(half for half, whole in halves.items() if whole == body)]
        whole = masses[body]
        moments = [moment / len(parts) for moment in whole.moments]
        found |= dict.fromkeys(parts, Mass(whole.mass / len(parts), whole.centre, moments))
    return found
