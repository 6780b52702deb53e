"""URDF text -> a frozen robot on a Pinocchio model.

Every joint has one coordinate here. A continuous joint, for which Pinocchio would keep (cos, sin),
is read as a revolute joint without limits, so that its position is an unwrapped angle everywhere.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from mbd_ros.core.urdf import numbers, parse_urdf
from mbd_ros.errors import ModelError

EARTH_GRAVITY = (0.0, 0.0, -9.81)
BASES = ("fixed", "floating")


@dataclass(frozen=True)
class Joint:
    """One joint with one coordinate.

    Attributes:
        name: Name on topics, bags and CSV columns.
        urdf_name: Name in the robot description.
        kind: revolute, continuous or prismatic.
        q: Index of its coordinate in a configuration.
        v: Index of its coordinate in a velocity.
        lower: Lower position limit [rad or m], -inf without one.
        upper: Upper position limit [rad or m], inf without one.
        max_velocity: [rad/s or m/s], inf where the description says 0 or nothing.
        max_effort: [N·m or N].
    """

    name: str
    urdf_name: str
    kind: str
    q: int
    v: int
    lower: float
    upper: float
    max_velocity: float
    max_effort: float

    @property
    def effort_unit(self) -> str:
        """Unit of its effort."""
        return "N" if self.kind == "prismatic" else "N·m"


@dataclass(frozen=True)
class Mimic:
    """A `<mimic>` of the description: joint = factor * parent + offset [rad or m]."""

    joint: str
    parent: str
    factor: float
    offset: float


@dataclass(frozen=True)
class Robot:
    """A robot that passed every check; its model is shared and never written.

    Attributes:
        name: Name in the description.
        model: Pinocchio model with gravity set and locked joints removed.
        joints: Joints in the order of their velocity coordinates.
        mimics: What `<mimic>` says, in topic names.
        floating: Whether the first 7 (6) coordinates of q (v) are those of a free base.
        locked: Position [rad or m] of every joint that was frozen and removed.
        fixed: Names of the joints that never move.
        ignored: What the description holds and this package leaves out.
    """

    name: str
    model: Any
    joints: tuple[Joint, ...]
    mimics: tuple[Mimic, ...]
    floating: bool
    locked: Mapping[str, float]
    fixed: frozenset[str]
    ignored: tuple[str, ...]

    def joint(self, name: str) -> Joint:
        """Joint of that topic name.

        Raises:
            ModelError: There is none, or it is fixed or locked; the message lists what exists.
        """
        for joint in self.joints:
            if joint.name == name:
                return joint
        if name in self.locked:
            raise ModelError(f"joint '{name}' is locked at {self.locked[name]:g}")
        if name in self.fixed:
            raise ModelError(f"joint '{name}' is fixed")
        existing = ", ".join(joint.name for joint in self.joints)
        raise ModelError(f"no joint '{name}'; the robot has {existing}")

    def frame(self, name: str) -> int:
        """Index in the model of the link (or frame) of that name.

        Raises:
            ModelError: There is none; the message lists the links.
        """
        index = int(self.model.getFrameId(name, pin.FrameType.BODY))
        if index == len(self.model.frames):
            index = int(self.model.getFrameId(name))
        if index == len(self.model.frames):
            bodies = [f.name for f in self.model.frames if f.type == pin.FrameType.BODY]
            raise ModelError(f"no frame '{name}'; the links are {', '.join(bodies)}")
        return index


def read_robot(
    text: str,
    *,
    source: str = "robot description",
    gravity: Sequence[float] = EARTH_GRAVITY,
    base: str = "fixed",
    locked: Mapping[str, float] | None = None,
    rename: Mapping[str, str] | None = None,
) -> Robot:
    """Build a robot from a description.

    Args:
        text: URDF.
        source: File or topic of the text, for the messages.
        gravity: Acceleration of gravity in the world frame [m/s^2], shape (3,).
        base: `fixed`, or `floating` for a root link that moves freely.
        locked: Topic name -> position [rad or m] of joints to freeze and remove.
        rename: URDF joint name -> name used on topics.

    Raises:
        ModelError: The description cannot be trusted, or an option names a joint that is not
            there.
    """
    if base not in BASES:
        raise ModelError(f"base '{base}', accepted: {', '.join(BASES)}")
    tree = parse_urdf(text, source)
    names = _topic_names(tree, rename or {}, source)
    locked = dict(locked or {})
    kinds = {e.get("name", ""): e.get("type", "") for e in tree.findall("joint")}
    fixed = frozenset(names[joint] for joint, kind in kinds.items() if kind == "fixed")
    mimics = _mimics(tree, names, source)
    model = _build_model(tree, base == "floating", gravity, source)
    model = _lock(model, locked, names, fixed, source)
    return Robot(
        name=tree.get("name", ""),
        model=model,
        joints=_joints(model, kinds, names, floating=base == "floating"),
        mimics=tuple(mimic for mimic in mimics if mimic.joint not in locked),
        floating=base == "floating",
        locked=locked,
        fixed=fixed,
        ignored=_ignored(tree),
    )


def _topic_names(
    tree: ElementTree.Element, rename: Mapping[str, str], source: str
) -> dict[str, str]:
    urdf_names = [joint.get("name", "") for joint in tree.findall("joint")]
    for name in rename:
        if name not in urdf_names:
            existing = ", ".join(urdf_names)
            raise ModelError(f"{source}: rename: no joint '{name}'; the robot has {existing}")
        if not rename[name]:
            raise ModelError(f"{source}: rename: the new name of '{name}' is empty")
    names = {name: rename.get(name, name) for name in urdf_names}
    taken = list(names.values())
    repeated = sorted({name for name in taken if taken.count(name) > 1})
    if repeated:
        raise ModelError(f"{source}: rename: two joints would be called {', '.join(repeated)}")
    return names


def _mimics(tree: ElementTree.Element, names: Mapping[str, str], source: str) -> list[Mimic]:
    mimics = []
    for joint in tree.findall("joint"):
        element = joint.find("mimic")
        if element is None:
            continue
        name, parent = names[joint.get("name", "")], element.get("joint", "")
        if parent not in names:
            raise ModelError(f"{source}: joint '{name}': mimic of unknown joint '{parent}'")
        factor = numbers(element, "multiplier", "1")[0]
        if factor == 0:
            raise ModelError(f"{source}: joint '{name}': mimic multiplier is 0; lock the joint")
        mimics.append(Mimic(name, names[parent], factor, numbers(element, "offset", "0")[0]))
    return mimics


def _build_model(
    tree: ElementTree.Element, floating: bool, gravity: Sequence[float], source: str
) -> Any:
    root = (pin.JointModelFreeFlyer(),) if floating else ()
    try:
        single = ElementTree.fromstring(ElementTree.tostring(tree))
        for joint in single.findall("joint"):
            if joint.get("type") == "continuous":
                _without_limits(joint)
        model = pin.buildModelFromXML(ElementTree.tostring(single, encoding="unicode"), *root)
    except (ValueError, RuntimeError) as error:
        raise ModelError(f"{source}: {error}") from error
    model.gravity.linear = np.array(gravity, dtype=np.float64)
    return model


def _without_limits(joint: ElementTree.Element) -> None:
    joint.set("type", "revolute")
    limit = joint.find("limit")
    if limit is None:
        limit = ElementTree.SubElement(joint, "limit", {"effort": "0", "velocity": "0"})
    limit.attrib.update({"lower": "-1e300", "upper": "1e300"})
    limit.attrib.setdefault("effort", "0")
    limit.attrib.setdefault("velocity", "0")


def _lock(
    model: Any,
    locked: Mapping[str, float],
    names: Mapping[str, str],
    fixed: frozenset[str],
    source: str,
) -> Any:
    if not locked:
        return model
    urdf_names = {topic: urdf for urdf, topic in names.items()}
    q = pin.neutral(model)
    for name, position in locked.items():
        if name not in urdf_names or name in fixed:
            state = "is fixed already" if name in fixed else "does not exist"
            raise ModelError(f"{source}: locked: joint '{name}' {state}")
        q[model.joints[model.getJointId(urdf_names[name])].idx_q] = position
    ids = [model.getJointId(urdf_names[name]) for name in locked]
    return pin.buildReducedModel(model, ids, q)


def _joints(
    model: Any, kinds: Mapping[str, str], names: Mapping[str, str], *, floating: bool
) -> tuple[Joint, ...]:
    joints = []
    first = 2 if floating else 1  # after the universe and the free base
    pairs = zip(list(model.names)[first:], list(model.joints)[first:], strict=True)
    for urdf_name, joint in pairs:
        kind, q, v = kinds[urdf_name], int(joint.idx_q), int(joint.idx_v)
        bounded = kind != "continuous"
        joints.append(
            Joint(
                name=names[urdf_name],
                urdf_name=urdf_name,
                kind=kind,
                q=q,
                v=v,
                lower=float(model.lowerPositionLimit[q]) if bounded else -math.inf,
                upper=float(model.upperPositionLimit[q]) if bounded else math.inf,
                max_velocity=float(model.upperVelocityLimit[v]) or math.inf,
                max_effort=float(model.upperEffortLimit[v]),
            )
        )
    return tuple(sorted(joints, key=lambda joint: joint.v))


def _ignored(tree: ElementTree.Element) -> tuple[str, ...]:
    rubbed = [
        joint.get("name", "")
        for joint in tree.findall("joint")
        if any(numbers(joint.find("dynamics"), key, "0")[0] for key in ("damping", "friction"))
    ]
    notes = [f"URDF <dynamics> friction and damping of {', '.join(rubbed)}"] if rubbed else []
    if tree.find("transmission") is not None:
        notes.append("URDF <transmission>")
    return tuple(notes)
