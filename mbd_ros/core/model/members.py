"""Several robots and bodies in one Pinocchio model."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.points import Places
from mbd_ros.core.model.robot import BASE, WORLD, Base, Joint, Mimic, Recipe, Robot
from mbd_ros.core.model.robot_reader import EARTH_GRAVITY, FAR, read_recipe, root_link
from mbd_ros.core.model.urdf import MAX_JOINTS, parse_urdf
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

_RESERVED = (BASE, WORLD, "universe")


class _Member(NamedTuple):
    """A robot or body, and where it goes.

    Attributes:
        recipe: What it was read from.
        robot: It by itself.
        root: Its root link.
        q: Where its coordinates begin in a configuration of all.
        v: Where they begin in a velocity of all.
    """

    recipe: Recipe
    robot: Robot
    root: str
    q: int
    v: int

    def link(self, name: str) -> str:
        """What a link is called in the scene: the root may have the name of the member."""
        recipe = self.recipe
        return name if name == self.root == recipe.name else recipe.scoped(name)


def merged(recipes: Sequence[Recipe], gravity: Sequence[float] = EARTH_GRAVITY) -> Robot:
    """All robots and bodies of a scene as one `Robot`.

    Joints and links of a member with a name are called `<name>/<joint>`. Its own name is that of
    its root link, too, and of its base if that is free.

    Args:
        recipes: The members, in the order of their coordinates; one may be without a name.
        gravity: Acceleration of gravity in the world frame [m/s^2], shape (3,).

    Raises:
        ModelError: A description cannot be trusted, or a name stands for two things.
    """
    members = _members(recipes, gravity)
    _check(members)
    origin = _origin(members)
    model = _model(members, origin)
    model.gravity.linear = np.array(gravity, dtype=np.float64)
    robots = [member.robot for member in members]
    return Robot(
        name=", ".join(m.recipe.name or m.robot.name for m in members),
        model=model,
        joints=tuple(_joint(m, joint) for m in members for joint in m.robot.joints),
        mimics=tuple(_mimic(m.recipe, mimic) for m in members for mimic in m.robot.mimics),
        bases=tuple(_base(m, b, model, origin) for m in members for b in m.robot.bases),
        locked=_scoped(members, [robot.locked for robot in robots]),
        fixed=frozenset(m.recipe.scoped(name) for m in members for name in m.robot.fixed),
        doubts=tuple(_told(m.recipe, doubt) for m in members for doubt in m.robot.doubts),
        rubbing=_scoped(members, [robot.rubbing for robot in robots]),
        ignored=tuple(_told(m.recipe, text) for m in members for text in m.robot.ignored),
        origin=origin,
        recipes=tuple(recipes),
        places=Places(model),
    )


def inertias_of_links(recipes: Iterable[Recipe]) -> dict[str, Any]:
    """Link -> `pinocchio.Inertia` in the axes of the link, 0 where it has none."""
    from mbd_ros.core.model.robot_reader import inertias_of

    found = {}
    for recipe in recipes:
        tree = parse_urdf(recipe.text, recipe.source, recipe.inertias)
        root = root_link(tree)
        for link, inertia in inertias_of(tree).items():
            is_named = link == root and bool(recipe.name)
            found[recipe.name if is_named else recipe.scoped(link)] = inertia
    return found


def with_inertias(recipes: Iterable[Recipe], inertias: Mapping[str, Any]) -> list[Recipe]:
    """Recipes with other inertias of some links.

    Args:
        recipes: Of all members.
        inertias: As `Robot.with_inertias` takes them.

    Raises:
        ModelError: There is no such link.
    """
    left, changed = dict(inertias), []
    for recipe in sorted(recipes, key=lambda recipe: not recipe.name):  # those without one last
        start = recipe.scoped("")
        own = {link: left.pop(link) for link in list(left) if link.startswith(start)}
        given = {link.removeprefix(start): inertia for link, inertia in own.items()}
        if recipe.name in left:
            root = root_link(parse_urdf(recipe.text, recipe.source))
            given[root] = left.pop(recipe.name)
        changed.append(recipe._replace(inertias={**(recipe.inertias or {}), **given}))
    if left:
        known = ", ".join(inertias_of_links(recipes))
        raise ModelError(f"no link '{next(iter(left))}'; the links are {known}")
    return [next(c for c in changed if c.name == recipe.name) for recipe in recipes]


def _members(recipes: Iterable[Recipe], gravity: Sequence[float]) -> list[_Member]:
    members, q, v = list[_Member](), 0, 0
    for recipe in recipes:
        try:
            robot = read_recipe(recipe, gravity)
        except ModelError as error:
            raise ModelError(_told(recipe, str(error))) from error
        root = root_link(parse_urdf(recipe.text, recipe.source))
        members.append(_Member(recipe, robot, root, q, v))
        q, v = q + int(robot.model.nq), v + int(robot.model.nv)
    return members


def _check(members: Sequence[_Member]) -> None:
    """Refuse names that stand for two things, and more joints than Pinocchio's data holds."""
    names = [member.recipe.name for member in members]
    for name in names:
        if name in _RESERVED or names.count(name) > 1:
            reason = "stands for something else" if name in _RESERVED else "is given twice"
            raise ModelError(f"name '{name}' {reason}; give robots and bodies names of their own")
    nv = sum(int(member.robot.model.nv) for member in members)
    if nv > MAX_JOINTS:
        raise ModelError(
            f"{nv} joints that move, a free body counts as six; accepted are {MAX_JOINTS} in all"
        )
    taken = set[str]()
    for member in members:
        own = {_frame_name(member, frame) for frame in list(member.robot.model.frames)[1:]}
        own.add(member.recipe.name)
        if doubled := sorted((own & taken) - {""}):
            raise ModelError(f"'{doubled[0]}' is the name of two frames")
        taken |= own


def _frame_name(member: _Member, frame: Any) -> str:
    is_link = frame.type == pin.FrameType.BODY
    return member.link(frame.name) if is_link else member.recipe.scoped(frame.name)


def _origin(members: Sequence[_Member]) -> Array:
    """Place of the first joint that stands in the world [m], 0 where it is near."""
    first = next((m for m in members if m.robot.joints and not m.robot.bases), None)
    if first is None:
        return np.zeros(3)
    place: Array = first.robot.model.jointPlacements[1].translation + first.robot.origin
    if first.recipe.pose is not None:
        place = first.recipe.pose.act(place)
    return place if np.linalg.norm(place) > FAR else np.zeros(3)


def _model(members: Sequence[_Member], origin: Array) -> Any:
    model = pin.Model()
    for member in members:
        recipe, own = member.recipe, member.robot.model.copy()
        own.names[:] = ["universe", *(recipe.scoped(name) for name in list(own.names)[1:])]
        for frame in list(own.frames)[1:]:
            frame.name = _frame_name(member, frame)
        model = pin.appendModel(model, own, 0, _placement(member, origin))
        if recipe.name and not model.existFrame(recipe.name):
            root = model.frames[model.getFrameId(member.link(member.root), pin.FrameType.BODY)]
            parent = model.getFrameId(root.name, pin.FrameType.BODY)
            model.addFrame(
                pin.Frame(
                    recipe.name, root.parentJoint, parent, root.placement, pin.FrameType.OP_FRAME
                )
            )
    model.frames[0].placement = pin.SE3(np.eye(3), -origin)
    return model


def _placement(member: _Member, origin: Array) -> Any:
    """Of the axes in which a member was read, in those of the model; a free one stands in q."""
    if member.robot.bases:
        return pin.SE3.Identity()
    pose = pin.SE3.Identity() if member.recipe.pose is None else member.recipe.pose
    return pin.SE3(pose.rotation, pose.act(member.robot.origin) - origin)


def _joint(member: _Member, joint: Joint) -> Joint:
    scoped = member.recipe.scoped
    return replace(
        joint,
        name=scoped(joint.name),
        urdf_name=scoped(joint.urdf_name),
        q=joint.q + member.q,
        v=joint.v + member.v,
        member=member.recipe.name,
    )


def _mimic(recipe: Recipe, mimic: Mimic) -> Mimic:
    return replace(mimic, joint=recipe.scoped(mimic.joint), parent=recipe.scoped(mimic.parent))


def _base(member: _Member, base: Base, model: Any, origin: Array) -> Base:
    recipe, joint = member.recipe, member.robot.model.names[base.joint]
    start = base.start if recipe.pose is None else pin.SE3ToXYZQUAT(recipe.pose)
    return Base(
        name=recipe.name or base.name,
        q=slice(base.q.start + member.q, base.q.stop + member.q),
        v=slice(base.v.start + member.v, base.v.stop + member.v),
        joint=int(model.getJointId(recipe.scoped(joint))),
        frame=member.link(base.frame),
        start=np.concatenate((start[:3] - origin, start[3:])),
    )


def _scoped(members: Sequence[_Member], given: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    pairs = zip(members, given, strict=True)
    return {m.recipe.scoped(name): value for m, own in pairs for name, value in own.items()}


def _told(recipe: Recipe, text: str) -> str:
    return f"{recipe.name}: {text}" if recipe.name else text
