"""Links, joints and functions -> the text of a robot description."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.urdf import is_impossible
from mbd_ros.core.state import Array
from mbd_ros.scene.reading.coupling_entries import one_function

_ODD = re.compile(r"[^\w/-]", re.ASCII)
X, Y, Z = np.eye(3)
Entry = Mapping[str, Any]


def linear(slope: float, offset: float = 0.0) -> Function:
    """f(q) = slope q + offset."""
    if slope == 0.0:
        return constant(offset)
    return Function({"factor": slope, **({"offset": offset} if offset else {})})


class Motion(NamedTuple):
    """A turn about an axis, or a slide along it.

    Attributes:
        name: What it is called where no coordinate gives it a name.
        axis: Of length 1, shape (3,).
        turns: Whether it is a turn.
        function: Angle [rad] or way [m] of the coordinate.
        coordinate: Name of the coordinate, empty where the function is constant.
    """

    name: str
    axis: Array
    turns: bool
    function: Function
    coordinate: str

    def at(self, value: float) -> Any:
        """`pinocchio.SE3` where the function has a value."""
        if self.turns:
            return pin.SE3(pin.AngleAxis(value, self.axis).toRotationMatrix(), np.zeros(3))
        return pin.SE3(np.eye(3), value * self.axis)

    def inverse(self) -> Motion:
        """The motion back."""
        return self._replace(axis=-self.axis)


Step = Motion | pin.SE3
UNLIMITED = 1.0e300
_SAME = 1.0e-14  # of a placement that is none
_MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")  # in the order of `Mass`


def urdf_text(
    name: str,
    links: Iterable[str],
    joints: Iterable[UrdfJoint],
    masses: Mapping[str, Mass],
    titles: Mapping[str, str],
) -> str:
    """The description.

    Args:
        name: Of the robot.
        links: Names of the links.
        masses: By link; a link that is not there has none.
        titles: Name of a joint in the scene -> its name in the description, where they differ.
    """
    robot = Element("robot", {"name": name})
    for link in links:
        _add_link(robot, link, masses.get(link))
    for joint in joints:
        _add_joint(robot, joint, titles.get(joint.name, joint.name))
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode") + "\n"


def _add_link(robot: Element, name: str, mass: Mass | None) -> None:
    link = SubElement(robot, "link", {"name": name})
    if mass is None or not (mass.mass or any(mass.moments)):
        return
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", {"xyz": _words(mass.centre), "rpy": "0 0 0"})
    SubElement(inertial, "mass", {"value": repr(mass.mass)})
    moments = dict(zip(_MOMENTS, map(repr, mass.moments), strict=True))
    SubElement(inertial, "inertia", moments)


def _words(numbers: Iterable[float]) -> str:
    return " ".join(repr(float(number) + 0.0) for number in numbers)


def _add_joint(robot: Element, joint: UrdfJoint, name: str) -> None:
    motion, kind = joint.motion, "fixed"
    if motion is not None:
        kind = "prismatic" if not motion.turns else "revolute" if joint.limits else "continuous"
    element = SubElement(robot, "joint", {"name": name, "type": kind})
    SubElement(element, "parent", {"link": joint.parent})
    SubElement(element, "child", {"link": joint.child})
    at = joint.origin
    origin = {"xyz": _words(at.translation), "rpy": _words(roll_pitch_yaw(at.rotation))}
    SubElement(element, "origin", origin)
    if motion is None:
        return
    SubElement(element, "axis", {"xyz": _words(motion.axis)})
    if kind != "continuous":
        lower, upper = joint.limits or (-UNLIMITED, UNLIMITED)
        numbers = {"lower": lower, "upper": upper, "effort": UNLIMITED, "velocity": 0.0}
        limit = {key: repr(float(number)) for key, number in numbers.items()}
        SubElement(element, "limit", limit)


def roll_pitch_yaw(rotation: Array) -> list[float]:
    """Angles of URDF whose rotation is the given one to rounding, also where they are not unique.

    Roll is taken after yaw is undone, so that both fit each other where pitch is 90 degrees.
    """
    r = rotation
    yaw = float(np.arctan2(r[1, 0], r[0, 0]))
    s, c = np.sin(yaw), np.cos(yaw)
    pitch = float(np.arctan2(-r[2, 0], c * r[0, 0] + s * r[1, 0]))
    roll = float(np.arctan2(s * r[0, 2] - c * r[1, 2], c * r[1, 1] - s * r[0, 1]))
    return [roll + 0.0, pitch + 0.0, yaw + 0.0]


class UrdfJoint(NamedTuple):
    """A joint of the description.

    Attributes:
        name: Its name in the scene.
        origin: `pinocchio.SE3` of the joint in the parent.
        motion: What it does; None for a fixed one.
        limits: Smallest and largest position [rad or m], or None.
    """

    name: str
    parent: str
    child: str
    origin: Any
    motion: Motion | None = None
    limits: tuple[float, float] | None = None


class Mass(NamedTuple):
    """Mass properties of a link.

    Attributes:
        mass: [kg].
        centre: In the axes of the link [m], shape (3,).
        moments: xx, yy, zz, xy, xz, yz about the centre [kg·m^2].
    """

    mass: float
    centre: Sequence[float]
    moments: Sequence[float]

    @property
    def is_impossible(self) -> bool:
        """Whether no body has these moments, whatever the mass."""
        xx, yy, zz, xy, xz, yz = self.moments
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        return is_impossible(self.mass, tensor)


class Names:
    """Names that are taken.

    Args:
        taken: Those that are taken before.
    """

    def __init__(self, taken: Iterable[str] = ()) -> None:
        self._taken = set(taken)
        self._numbers: dict[str, int] = {}  # the next one that a wish gets

    def __contains__(self, name: str) -> bool:
        return name in self._taken

    def take(self, wish: str, ending: str = "") -> str:
        """A name like the wish that nothing else has; it is taken from now on.

        Args:
            ending: What it gets where the wish is taken, before it gets a number.
        """
        if wish in self._taken and ending:
            wish = f"{wish}_{ending}"
        name, number = wish, self._numbers.get(wish, 2)
        while name in self._taken:
            name, number = f"{wish}_{number}", number + 1
        self._taken.add(name)
        self._numbers[wish] = number
        return name

    def part(self, wish: str, ending: str) -> str:
        """Take a name that consists of characters allowed in names of parts."""
        return self.take(plain(wish) or ending, ending)


def plain(name: str) -> str:
    """A name with `_` in place of the characters that a scene does not take."""
    return _ODD.sub("_", name)[:200]


class Function(NamedTuple):
    """A function of one coordinate.

    Attributes:
        entry: As a scene writes it: `factor`, `polynomial`, `simm_spline`, ..
        constant: Its value where it does not depend on the coordinate, else None.
    """

    entry: Entry
    constant: float | None = None

    @property
    def slope(self) -> float | None:
        """Slope of a straight line; None for other functions."""
        return self.entry.get("factor")

    @property
    def offset(self) -> float:
        """Value of a straight line at 0."""
        return float(self.entry.get("offset", 0.0))

    def value(self, q: float, where: str) -> float:
        """f(q).

        Raises:
            SceneError: The numbers of the function are refused; `where` begins the message.
        """
        if self.constant is not None:
            return self.constant
        return float(one_function(where, **self.entry)(float(q))[0])


def constant(value: float) -> Function:
    """f(q) = value."""
    return Function({"polynomial": [value]}, value)


IDENTITY = linear(1.0)


def sine(
    amplitude: float, angular_frequency: float = 1.0, phase: float = 0.0, offset: float = 0.0
) -> Function:
    """f(q) = offset + amplitude sin(angular_frequency q + phase)."""
    if amplitude * angular_frequency == 0.0:
        return constant(amplitude * math.sin(phase) + offset)
    harmonic = {"amplitude": amplitude, "angular_frequency": angular_frequency}
    return Function({"harmonic": {**harmonic, "phase": phase, "offset": offset}})


def joint_titles(links: Sequence[str], joints: Sequence[UrdfJoint]) -> dict[str, str]:
    """Joints that have the name of a link -> what the description calls them.

    Pinocchio tells frames by their names alone where joints are locked.
    """
    taken, known = Names([*links, *(joint.name for joint in joints)]), set(links)
    names = [joint.name for joint in joints if joint.name in known]
    return {name: taken.take(f"{name}_joint") for name in names}


def xyz_rpy(at: Any) -> dict[str, list[float]]:
    """A placement as a scene writes it, without what is 0."""
    pose = {"xyz": at.translation.tolist(), "rpy": roll_pitch_yaw(at.rotation)}
    return {key: value for key, value in pose.items() if any(value)}


def is_identity(at: Any) -> bool:
    """Whether a placement is none, to rounding."""
    return bool(np.abs(at.homogeneous - np.eye(4)).max() <= _SAME)
