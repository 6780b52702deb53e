"""Read a URDF description into an immutable robot with a Pinocchio model.

Every joint has one coordinate. A continuous joint, which Pinocchio represents by (cos, sin), is
read as a revolute joint without limits, so that its position is an unwrapped angle everywhere. A
fixed base far from the origin is read as if it stood at the origin, see `centred`.
"""

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.points import Places
from mbd_ros.core.model.robot import (
    BASE,
    FAR,
    Base,
    FrictionCoefficients,
    Joint,
    Mimic,
    ModelSource,
    Robot,
)
from mbd_ros.core.model.urdf import (
    check_inertias,
    has_effort_limit,
    joint_kinds,
    link_name,
    numbers,
    parse_urdf,
    root_link,
)
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

EARTH_GRAVITY = (0.0, 0.0, -9.81)
BASES = ("fixed", "floating")
_BASE_V = 6  # number of velocities of a free base


def read_robot(
    text: str,
    *,
    source: str = "robot description",
    gravity: Sequence[float] = EARTH_GRAVITY,
    base: str = "fixed",
    locked: Mapping[str, float] | None = None,
    rename: Mapping[str, str] | None = None,
    inertias: Mapping[str, Any] | None = None,
) -> Robot:
    """Build a robot from a URDF description.

    Args:
        text: URDF text.
        source: File or topic of the text, for messages.
        gravity: Acceleration of gravity in the world frame [m/s^2], shape (3,).
        base: `fixed`, or `floating` for a root link with a free joint.
        locked: Topic name -> position [rad or m] of joints to lock and remove.
        rename: URDF joint name -> topic name.
        inertias: Inertias of links that replace those of the text, see `with_inertias`.

    Raises:
        ModelError: The description is not valid, or an option names an unknown joint.
    """
    return read_model_source(ModelSource(text, source, base, locked, rename, inertias), gravity)


def read_model_source(
    model_source: ModelSource, gravity: Sequence[float] = EARTH_GRAVITY
) -> Robot:
    """Read one robot or body, with the names of links and joints in its description.

    Args:
        model_source: Description and options; name and pose, which belong to a scene, have no
            effect here.
        gravity: Acceleration of gravity in the world frame [m/s^2], shape (3,).

    Raises:
        ModelError: The description is not valid, or an option names an unknown joint.
    """
    text, source, base = model_source[:3]
    if base not in BASES:
        raise ModelError(f"base is '{base}', accepted: {', '.join(BASES)}")
    tree = parse_urdf(text, source, model_source.inertias)
    inertia_warnings = check_inertias(tree, source, model_source.any_inertias)
    names = _topic_names(tree, model_source.rename or {}, source)
    locked = dict(model_source.locked or {})
    kinds = joint_kinds(tree)
    fixed = frozenset(names[joint] for joint, kind in kinds.items() if kind == "fixed")
    mimics = _mimics(tree, names, source)

    def build(tree: ElementTree.Element) -> Any:
        model = _build_model(tree, base == "floating", gravity, source)
        return _lock(model, locked, names, fixed, source)

    model, origin = (build(tree), np.zeros(3)) if base == "floating" else centred(build, tree)
    return Robot(
        name=tree.get("name", ""),
        model=model,
        joints=_joints(model, tree, names),
        mimics=tuple(mimic for mimic in mimics if mimic.joint not in locked),
        bases=_bases(model, root_link(tree)),
        locked=locked,
        fixed=fixed,
        inertia_warnings=inertia_warnings,
        joint_friction=_joint_friction(tree, names),
        ignored=("URDF <transmission>",) if tree.find("transmission") is not None else (),
        origin=origin,
        model_sources=(model_source,),
        places=Places(model),
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
    topic_names = list(names.values())
    repeated = sorted({name for name in topic_names if topic_names.count(name) > 1})
    if repeated:
        raise ModelError(f"{source}: rename: two joints would have the name {', '.join(repeated)}")
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
            raise ModelError(
                f"{source}: joint '{name}': mimic multiplier is 0; lock the joint instead"
            )
        mimics.append(Mimic(name, names[parent], factor, numbers(element, "offset", "0")[0]))
    return mimics


def _build_model(
    tree: ElementTree.Element, floating: bool, gravity: Sequence[float], source: str
) -> Any:
    root = (pin.JointModelFreeFlyer(),) if floating else ()
    try:
        urdf = copy.deepcopy(tree)
        for joint in urdf.findall("joint"):
            if joint.get("type") == "continuous":
                _make_revolute(joint)
        model = pin.buildModelFromXML(ElementTree.tostring(urdf, encoding="unicode"), *root)
    except (ValueError, RuntimeError) as error:
        raise ModelError(f"{source}: {error}") from error
    model.gravity.linear = np.array(gravity, dtype=np.float64)
    return model


def _make_revolute(joint: ElementTree.Element) -> None:
    """Turn a continuous joint into a revolute joint without limits, in place."""
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
    try:
        return pin.buildReducedModel(model, ids, q)
    except (
        ValueError,
        RuntimeError,
    ) as error:  # such as a link and a fixed joint of the same name
        raise ModelError(f"{source}: locked: {str(error).splitlines()[0]}") from error


def centred(
    build: Callable[[ElementTree.Element], Any], tree: ElementTree.Element
) -> tuple[Any, Array]:
    """Build a model with a fixed base, and choose the origin of its positions.

    A fixed base far from the origin of the world is read as if it stood at the origin. Otherwise
    placements, Jacobians and distances would lose one digit with every power of ten between the
    robot and the origin, whereas a constant offset changes no acceleration.

    Args:
        build: Function that builds a model of a checked description.
        tree: The checked description.

    Returns:
        The model; and its origin, which is the position of its first joint in the world [m], or 0
        if that is near 0, shape (3,). The frames of the world and of the root link are shifted by
        minus the origin.
    """
    model, no_offset = build(tree), np.zeros(3)
    if model.njoints == 1:
        return model, no_offset
    origin: Array = model.jointPlacements[1].translation.copy()
    if np.linalg.norm(origin) <= FAR:
        return model, no_offset
    root = root_link(tree)
    model = build(_shifted(tree, root, origin))
    for index in {0, int(model.getFrameId(root, pin.FrameType.BODY))}:
        frame = model.frames[index]
        frame.placement = pin.SE3(frame.placement.rotation, frame.placement.translation - origin)
    return model, origin


def _shifted(tree: ElementTree.Element, root: str, origin: Array) -> ElementTree.Element:
    """Return the description with everything on its root link shifted by -origin.

    The offset is subtracted in the text, before it has caused any rounding error.
    """
    tree = copy.deepcopy(tree)
    for joint in tree.findall("joint"):
        if link_name(joint, "parent") != root:
            continue
        element = joint.find("origin")
        if element is None:
            element = ElementTree.SubElement(joint, "origin")
        position = np.array(numbers(element, "xyz", "0 0 0")) - origin
        element.set("xyz", " ".join(repr(float(value)) for value in position))
    return tree


def _joints(model: Any, tree: ElementTree.Element, names: Mapping[str, str]) -> tuple[Joint, ...]:
    joints, kinds = [], joint_kinds(tree)
    limited = {e.get("name", "") for e in tree.iterfind("joint") if has_effort_limit(e)}
    pairs = zip(list(model.names)[1:], list(model.joints)[1:], strict=True)  # without the universe
    for urdf_name, joint in pairs:
        if joint.nv == _BASE_V:
            continue
        kind, q, v = kinds[urdf_name], int(joint.idx_q), int(joint.idx_v)
        has_limits = kind != "continuous"
        joints.append(
            Joint(
                name=names[urdf_name],
                urdf_name=urdf_name,
                kind=kind,
                q=q,
                v=v,
                lower=float(model.lowerPositionLimit[q]) if has_limits else -math.inf,
                upper=float(model.upperPositionLimit[q]) if has_limits else math.inf,
                max_velocity=float(model.upperVelocityLimit[v]) or math.inf,
                max_effort=float(model.upperEffortLimit[v]) if urdf_name in limited else math.inf,
            )
        )
    return tuple(sorted(joints, key=lambda joint: joint.v))


def _bases(model: Any, link: str) -> tuple[Base, ...]:
    """Return the free base of the root link, if it has one."""
    return tuple(
        Base(
            BASE,
            slice(joint.idx_q, joint.idx_q + joint.nq),
            slice(joint.idx_v, joint.idx_v + joint.nv),
            int(joint.id),
            link,
            pin.neutral(model)[joint.idx_q : joint.idx_q + joint.nq],
        )
        for joint in model.joints
        if joint.nv == _BASE_V
    )


def _joint_friction(
    tree: ElementTree.Element, names: Mapping[str, str]
) -> dict[str, FrictionCoefficients]:
    """Return the `<dynamics>` of joints that are not zero, by topic name."""
    joint_friction = {}
    for joint in tree.findall("joint"):
        element = joint.find("dynamics")
        coefficients = FrictionCoefficients(
            numbers(element, "friction", "0")[0], numbers(element, "damping", "0")[0]
        )
        if any(coefficients):
            joint_friction[names[joint.get("name", "")]] = coefficients
    return joint_friction


def read_robots(
    model_sources: Sequence[ModelSource], gravity: Sequence[float] = EARTH_GRAVITY
) -> Robot:
    """Read all robots and bodies of a scene into one `Robot`.

    Args:
        model_sources: Their descriptions, in the order of their coordinates.
        gravity: Acceleration of gravity in the world frame [m/s^2], shape (3,).

    Raises:
        ModelError: A description is not valid, or a name is used twice.
    """
    if len(model_sources) == 1 and not model_sources[0].name and model_sources[0].pose is None:
        return read_model_source(model_sources[0], gravity)
    from mbd_ros.core.model.members import merged

    robots = []
    for model_source in model_sources:
        try:
            robots.append(read_model_source(model_source, gravity))
        except ModelError as error:
            raise ModelError(model_source.titled(str(error))) from error
    return merged(robots, gravity)


def with_inertias(robot: Robot, inertias: Mapping[str, Any]) -> Robot:
    """Return the robot with other inertias of some links, checked as those of a description.

    Args:
        robot: The robot.
        inertias: Link -> `pinocchio.Inertia` or (mass [kg], mass centre [m], shape (3,), inertia
            about the mass centre [kg·m^2], shape (3, 3)), both in the axes of the link. Links on
            fixed and locked joints are accepted too.

    Raises:
        ModelError: There is no such link, or the inertia is physically impossible.
    """
    remaining, model_sources = dict(inertias), dict[str, ModelSource]()
    # The source without a name comes last, since its empty prefix matches all remaining links.
    for source in sorted(robot.model_sources, key=lambda source: not source.name):
        prefix = source.scoped("")
        links = [link for link in remaining if link.startswith(prefix)]
        replaced = {link.removeprefix(prefix): remaining.pop(link) for link in links}
        if source.name in remaining:
            root = root_link(parse_urdf(source.text, source.source))
            replaced[root] = remaining.pop(source.name)
        model_sources[source.name] = source._replace(
            inertias={**(source.inertias or {}), **replaced}
        )
    if remaining:
        known = ", ".join(robot.inertias())
        raise ModelError(f"no link '{next(iter(remaining))}'; the links are {known}")
    ordered = [model_sources[source.name] for source in robot.model_sources]
    new_robot = read_robots(ordered, robot.model.gravity.linear.tolist())
    new_robot.model.armature = robot.model.armature.copy()  # rotor inertias, not in descriptions
    return new_robot
