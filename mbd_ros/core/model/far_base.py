"""A fixed base far from the world's origin, read as if it stood at the origin.

Placements, Jacobians and distances in world axes lose a digit with every power of ten between the
robot and the origin. A constant offset changes no acceleration.
"""

import copy
from collections.abc import Callable
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.urdf_reading import link_name, numbers
from mbd_ros.core.state import Array

FAR = 2.0  # m; nearer robots keep the world's origin, and lose no digit that counts


def centred(
    build: Callable[[ElementTree.Element], Any], tree: ElementTree.Element
) -> tuple[Any, Array]:
    """A model with a fixed base, and the origin that its positions are counted from.

    Args:
        build: Makes a model of a checked description.
        tree: The description.

    Returns:
        The model, and the place of its first joint in the world [m], or 0 if that is near,
        shape (3,). Frames of the world and of the root link stand in it at minus that place.
    """
    model, near = build(tree), np.zeros(3)
    if model.njoints == 1:
        return model, near
    origin: Array = model.jointPlacements[1].translation.copy()
    if np.linalg.norm(origin) <= FAR:
        return model, near
    root = root_link(tree)
    model = build(_moved(tree, root, origin))
    for index in {0, int(model.getFrameId(root, pin.FrameType.BODY))}:
        frame = model.frames[index]
        frame.placement = pin.SE3(frame.placement.rotation, frame.placement.translation - origin)
    return model, origin


def _moved(tree: ElementTree.Element, root: str, origin: Array) -> ElementTree.Element:
    """The description with everything on its root link moved by -origin.

    The text is changed, before anything is added to the large numbers.
    """
    tree = copy.deepcopy(tree)
    for joint in tree.findall("joint"):
        if link_name(joint, "parent") != root:
            continue
        place = joint.find("origin")
        if place is None:
            place = ElementTree.SubElement(joint, "origin")
        at = np.array(numbers(place, "xyz", "0 0 0")) - origin
        place.set("xyz", " ".join(repr(float(value)) for value in at))
    return tree


def root_link(tree: ElementTree.Element) -> str:
    """Name of the link that no joint carries."""
    carried = {link_name(joint, "child") for joint in tree.findall("joint")}
    names = (link.get("name", "") for link in tree.findall("link"))
    return next(name for name in names if name not in carried)
