"""URDF text -> a frozen robot on a Pinocchio model.

Every joint has one coordinate. A continuous joint, for which Pinocchio would keep (cos, sin), is
read as a revolute joint without limits, so that its position is an unwrapped angle everywhere.
"""

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.points import Places
from mbd_ros.core.model.robot import BASE, Base, Joint, Mimic, Recipe, Robot, Rubbing
from mbd_ros.core.model.urdf import (
    check_inertias,
    has_effort_limit,
    joint_kinds,
    link_name,
    numbers,
    parse_urdf,
)
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

# ---- far base ---------------------------------------------------------------------------------
# A fixed base far from the world's origin, read as if it stood at the origin.
#
# Placements, Jacobians and distances in world axes lose a digit with every power of ten between
# the
# robot and the origin. A constant offset changes no acceleration.


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


# ---- robot reader -----------------------------------------------------------------------------
# URDF text -> a frozen robot on a Pinocchio model.


EARTH_GRAVITY = (0.0, 0.0, -9.81)
BASES = ("fixed", "floating")
_BASE_V = 6  # velocities of a free base


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
    """Build a robot from a description.

    Args:
        text: URDF.
        source: File or topic of the text, for the messages.
        gravity: Acceleration of gravity in the world frame [m/s^2], shape (3,).
        base: `fixed`, or `floating` for a root link that moves freely.
        locked: Topic name -> position [rad or m] of joints to freeze and remove.
        rename: URDF joint name -> name used on topics.
        inertias: Of links, in place of those of the text, see `Robot.with_inertias`.

    Raises:
        ModelError: The description cannot be trusted, or an option names a joint that is not
            there.
    """
    return read_recipe(Recipe(text, source, base, locked, rename, inertias), gravity)


def read_recipe(recipe: Recipe, gravity: Sequence[float] = EARTH_GRAVITY) -> Robot:
    """One robot or body by itself, its links and joints called as in its description.

    Args:
        recipe: What it is read from; its name and pose are those of a scene, and left aside.
        gravity: As for `read_robot`.

    Raises:
        ModelError: As `read_robot`.
    """
    text, source, base = recipe[:3]
    if base not in BASES:
        raise ModelError(f"base '{base}', accepted: {', '.join(BASES)}")
    tree = parse_urdf(text, source, recipe.inertias)
    doubts = check_inertias(tree, source, recipe.any_inertias)
    names = _topic_names(tree, recipe.rename or {}, source)
    locked = dict(recipe.locked or {})
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
        doubts=doubts,
        rubbing=_rubbing(tree, names),
        ignored=("URDF <transmission>",) if tree.find("transmission") is not None else (),
        origin=origin,
        recipes=(recipe,),
        places=Places(model),
    )


def read_robots(recipes: Sequence[Recipe], gravity: Sequence[float] = EARTH_GRAVITY) -> Robot:
    """The only robot of a scene, or all robots and bodies as one.

    Args:
        recipes: The robots and bodies, in the order of their coordinates.
        gravity: As for `read_robot`.

    Raises:
        ModelError: As `read_robot`, or a name stands for two things.
    """
    if len(recipes) == 1 and not recipes[0].name and recipes[0].pose is None:
        return read_recipe(recipes[0], gravity)
    from mbd_ros.core.model.members import merged

    return merged(recipes, gravity)


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
        single = copy.deepcopy(tree)
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
    try:
        return pin.buildReducedModel(model, ids, q)
    except (ValueError, RuntimeError) as error:  # a link and a fixed joint of one name, for one
        raise ModelError(f"{source}: locked: {str(error).splitlines()[0]}") from error


def _bases(model: Any, link: str) -> tuple[Base, ...]:
    """The free base that the root link may have."""
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


def _joints(model: Any, tree: ElementTree.Element, names: Mapping[str, str]) -> tuple[Joint, ...]:
    joints, kinds = [], joint_kinds(tree)
    limited = {e.get("name", "") for e in tree.iterfind("joint") if has_effort_limit(e)}
    pairs = zip(list(model.names)[1:], list(model.joints)[1:], strict=True)  # but the universe
    for urdf_name, joint in pairs:
        if joint.nv == _BASE_V:
            continue
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
                max_effort=float(model.upperEffortLimit[v]) if urdf_name in limited else math.inf,
            )
        )
    return tuple(sorted(joints, key=lambda joint: joint.v))


def _rubbing(tree: ElementTree.Element, names: Mapping[str, str]) -> dict[str, Rubbing]:
    found = {}
    for joint in tree.findall("joint"):
        element = joint.find("dynamics")
        rub = Rubbing(numbers(element, "friction", "0")[0], numbers(element, "damping", "0")[0])
        if any(rub):
            found[names[joint.get("name", "")]] = rub
    return found


# ---- other inertias ---------------------------------------------------------------------------
# Inertias of links in place of those of a description, and what a description says of them.


_AXES = "xyz"
_PAIRS = [(i, j) for i in range(3) for j in range(i, 3)]
_ASYMMETRIC = 1.0e-9  # of the largest entry
_EXPECTED = (
    "expected a pinocchio.Inertia, or mass [kg], mass centre [m] of 3 numbers and inertia about "
    "it [kg·m^2] of 3 x 3"
)


def place_inertias(robot: ElementTree.Element, inertias: Mapping[str, Any], source: str) -> None:
    """Put inertias into a description; its checks come afterwards.

    Args:
        robot: The `<robot>` element, changed in place.
        inertias: Link -> `pinocchio.Inertia` or (mass [kg], mass centre [m], shape (3,), inertia
            about the mass centre [kg·m^2], shape (3, 3)), both in the axes of the link.
        source: File or topic of the description, for the messages.

    Raises:
        ModelError: There is no such link, or the numbers have another shape.
    """
    links = {link.get("name", ""): link for link in robot.findall("link")}
    for name, inertia in inertias.items():
        if name not in links:
            raise ModelError(f"{source}: no link '{name}'; the links are {', '.join(links)}")
        mass, centre, tensor = _numbers(inertia, f"{source}: link '{name}'")
        link = links[name]
        for old in link.findall("inertial"):
            link.remove(old)
        inertial = ElementTree.SubElement(link, "inertial")
        words = " ".join(repr(float(value)) for value in centre)
        ElementTree.SubElement(inertial, "origin", {"xyz": words})
        ElementTree.SubElement(inertial, "mass", {"value": repr(mass)})
        moments = {f"i{_AXES[i]}{_AXES[j]}": repr(float(tensor[i, j])) for i, j in _PAIRS}
        ElementTree.SubElement(inertial, "inertia", moments)


def inertias_of(robot: ElementTree.Element) -> dict[str, Any]:
    """Link -> `pinocchio.Inertia` of a checked description, 0 where it says nothing."""
    found = {}
    for link in robot.findall("link"):
        inertial = link.find("inertial")
        if inertial is None:
            found[link.get("name", "")] = pin.Inertia.Zero()
            continue
        place, given = inertial.find("origin"), inertial.find("inertia")
        turned = pin.rpy.rpyToMatrix(np.array(numbers(place, "rpy", "0 0 0")))
        tensor = np.zeros((3, 3))
        for i, j in _PAIRS:
            tensor[i, j] = tensor[j, i] = numbers(given, f"i{_AXES[i]}{_AXES[j]}", "0")[0]
        mass = numbers(inertial.find("mass"), "value", "0")[0]
        centre = np.array(numbers(place, "xyz", "0 0 0"))
        found[link.get("name", "")] = pin.Inertia(mass, centre, turned @ tensor @ turned.T)
    return found


def _numbers(inertia: Any, where: str) -> tuple[float, Array, Array]:
    if isinstance(inertia, pin.Inertia):
        inertia = (inertia.mass, inertia.lever, inertia.inertia)
    try:
        mass, centre, tensor = (np.array(value, dtype=np.float64) for value in inertia)
    except (TypeError, ValueError) as error:
        raise ModelError(f"{where}: {_EXPECTED}") from error
    if (mass.shape, centre.shape, tensor.shape) != ((), (3,), (3, 3)):
        raise ModelError(f"{where}: {_EXPECTED}")
    if np.abs(tensor - tensor.T).max() > _ASYMMETRIC * np.abs(tensor).max():
        raise ModelError(f"{where}: inertia is not symmetric")
    return float(mass), centre, tensor
