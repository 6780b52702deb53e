"""Several robots and bodies in one Pinocchio model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.points import Places
from mbd_ros.core.model.robot import BASE, FAR, WORLD, Base, Joint, Mimic, ModelSource, Robot
from mbd_ros.core.model.urdf import MAX_JOINTS, parse_urdf, root_link
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

_RESERVED = (BASE, WORLD, "universe")


def merged(robots: Sequence[Robot], gravity: Sequence[float]) -> Robot:
    """All robots and bodies of a scene as one `Robot`.

    Joints and links of a member with a name are called `<name>/<joint>`. Its own name is that of
    its root link, too, and of its base if that is free.

    Args:
        robots: Each read by itself, in the order of their coordinates; one may be without a name.
        gravity: Acceleration of gravity in the world frame [m/s^2], shape (3,).

    Raises:
        ModelError: A name stands for two things, or more joints move than are accepted.
    """
    members = _members(robots)
    _check(members)
    origin = _origin(members)
    model = _model(members, origin)
    model.gravity.linear = np.array(gravity, dtype=np.float64)
    return Robot(
        name=", ".join(m.model_source.name or m.robot.name for m in members),
        model=model,
        joints=tuple(_joint(m, joint) for m in members for joint in m.robot.joints),
        mimics=tuple(_mimic(m.model_source, mimic) for m in members for mimic in m.robot.mimics),
        bases=tuple(_base(m, b, model, origin) for m in members for b in m.robot.bases),
        locked=_scoped(members, [robot.locked for robot in robots]),
        fixed=frozenset(m.model_source.scoped(name) for m in members for name in m.robot.fixed),
        inertia_warnings=tuple(
            m.model_source.titled(doubt) for m in members for doubt in m.robot.inertia_warnings
        ),
        joint_friction=_scoped(members, [robot.joint_friction for robot in robots]),
        ignored=tuple(m.model_source.titled(text) for m in members for text in m.robot.ignored),
        origin=origin,
        model_sources=tuple(m.model_source for m in members),
        places=Places(model),
    )


def _members(robots: Sequence[Robot]) -> list[_Member]:
    members, q, v = list[_Member](), 0, 0
    for robot in robots:
        (model_source,) = robot.model_sources
        root = root_link(parse_urdf(model_source.text, model_source.source))
        members.append(_Member(model_source, robot, root, q, v))
        q, v = q + int(robot.model.nq), v + int(robot.model.nv)
    return members


def _check(members: Sequence[_Member]) -> None:
    """Refuse names that stand for two things, and more joints than Pinocchio's data holds."""
    names = [member.model_source.name for member in members]
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
        own.add(member.model_source.name)
        if doubled := sorted((own & taken) - {""}):
            raise ModelError(f"'{doubled[0]}' is the name of two frames")
        taken |= own


def _frame_name(member: _Member, frame: Any) -> str:
    is_link = frame.type == pin.FrameType.BODY
    return member.link(frame.name) if is_link else member.model_source.scoped(frame.name)


def _origin(members: Sequence[_Member]) -> Array:
    """Place of the first joint that stands in the world [m], 0 where it is near."""
    first = next((m for m in members if m.robot.joints and not m.robot.bases), None)
    if first is None:
        return np.zeros(3)
    place: Array = first.robot.model.jointPlacements[1].translation + first.robot.origin
    if first.model_source.pose is not None:
        place = first.model_source.pose.act(place)
    return place if np.linalg.norm(place) > FAR else np.zeros(3)


def _model(members: Sequence[_Member], origin: Array) -> Any:
    model = pin.Model()
    for member in members:
        model_source, own = member.model_source, member.robot.model.copy()
        own.names[:] = ["universe", *(model_source.scoped(name) for name in list(own.names)[1:])]
        for frame in list(own.frames)[1:]:
            frame.name = _frame_name(member, frame)
        model = pin.appendModel(model, own, 0, _placement(member, origin))
        if model_source.name and not model.existFrame(model_source.name):
            root = model.frames[model.getFrameId(member.link(member.root), pin.FrameType.BODY)]
            parent = model.getFrameId(root.name, pin.FrameType.BODY)
            model.addFrame(
                pin.Frame(
                    model_source.name,
                    root.parentJoint,
                    parent,
                    root.placement,
                    pin.FrameType.OP_FRAME,
                )
            )
    model.frames[0].placement = pin.SE3(np.eye(3), -origin)
    return model


def _placement(member: _Member, origin: Array) -> Any:
    """Of the axes in which a member was read, in those of the model; a free one stands in q."""
    if member.robot.bases:
        return pin.SE3.Identity()
    pose = pin.SE3.Identity() if member.model_source.pose is None else member.model_source.pose
    return pin.SE3(pose.rotation, pose.act(member.robot.origin) - origin)


def _joint(member: _Member, joint: Joint) -> Joint:
    scoped = member.model_source.scoped
    return replace(
        joint,
        name=scoped(joint.name),
        urdf_name=scoped(joint.urdf_name),
        q=joint.q + member.q,
        v=joint.v + member.v,
        member=member.model_source.name,
    )


def _mimic(model_source: ModelSource, mimic: Mimic) -> Mimic:
    return replace(
        mimic, joint=model_source.scoped(mimic.joint), parent=model_source.scoped(mimic.parent)
    )


def _base(member: _Member, base: Base, model: Any, origin: Array) -> Base:
    model_source, joint = member.model_source, member.robot.model.names[base.joint]
    start = base.start if model_source.pose is None else pin.SE3ToXYZQUAT(model_source.pose)
    return Base(
        name=model_source.name or base.name,
        q=slice(base.q.start + member.q, base.q.stop + member.q),
        v=slice(base.v.start + member.v, base.v.stop + member.v),
        joint=int(model.getJointId(model_source.scoped(joint))),
        frame=member.link(base.frame),
        start=np.concatenate((start[:3] - origin, start[3:])),
    )


def _scoped(members: Sequence[_Member], given: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    pairs = zip(members, given, strict=True)
    return {m.model_source.scoped(name): value for m, own in pairs for name, value in own.items()}


class _Member(NamedTuple):
    """A robot or body, and where it goes.

    Attributes:
        model_source: What it was read from.
        robot: It by itself.
        root: Its root link.
        q: Where its coordinates begin in a configuration of all.
        v: Where they begin in a velocity of all.
    """

    model_source: ModelSource
    robot: Robot
    root: str
    q: int
    v: int

    def link(self, name: str) -> str:
        """What a link is called in the scene: the root may have the name of the member."""
        model_source = self.model_source
        return name if name == self.root == model_source.name else model_source.scoped(name)
