"""Merge several robots and bodies into one Pinocchio model."""

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
    """Merge all robots and bodies of a scene into one `Robot`.

    Joints and links of a robot with a name become `<name>/<joint>` and `<name>/<link>`. The name
    itself also denotes the root link, and the base if that is free.

    Args:
        robots: Robots and bodies, in the order of their coordinates; one may have no name.
        gravity: Acceleration of gravity in the world frame [m/s^2], shape (3,).

    Raises:
        ModelError: A name is used twice, or there are too many joints.
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
    """Refuse ambiguous names, and more joints than fit into the memory of a Pinocchio `Data`."""
    names = [member.model_source.name for member in members]
    for name in names:
        if name in _RESERVED or names.count(name) > 1:
            reason = "is reserved" if name in _RESERVED else "is used twice"
            raise ModelError(
                f"name '{name}' {reason}; every robot and body needs a name of its own"
            )
    nv = sum(int(member.robot.model.nv) for member in members)
    if nv > MAX_JOINTS:
        raise ModelError(
            f"there are {nv} moving joints, where a free body counts as six; at most {MAX_JOINTS} "
            "are accepted"
        )
    names_so_far = set[str]()
    for member in members:
        frames = {_frame_name(member, frame) for frame in list(member.robot.model.frames)[1:]}
        frames.add(member.model_source.name)
        if repeated := sorted((frames & names_so_far) - {""}):
            raise ModelError(f"two frames have the name '{repeated[0]}'")
        names_so_far |= frames


def _frame_name(member: _Member, frame: Any) -> str:
    is_link = frame.type == pin.FrameType.BODY
    return member.link(frame.name) if is_link else member.model_source.scoped(frame.name)


def _origin(members: Sequence[_Member]) -> Array:
    """Return the position of the first joint of a fixed base [m], or 0 if it is near 0, (3,)."""
    first = next((m for m in members if m.robot.joints and not m.robot.bases), None)
    if first is None:
        return np.zeros(3)
    position: Array = first.robot.model.jointPlacements[1].translation + first.robot.origin
    if first.model_source.pose is not None:
        position = first.model_source.pose.act(position)
    return position if np.linalg.norm(position) > FAR else np.zeros(3)


def _model(members: Sequence[_Member], origin: Array) -> Any:
    model = pin.Model()
    for member in members:
        model_source, member_model = member.model_source, member.robot.model.copy()
        member_model.names[:] = [
            "universe",
            *(model_source.scoped(name) for name in list(member_model.names)[1:]),
        ]
        for frame in list(member_model.frames)[1:]:
            frame.name = _frame_name(member, frame)
        model = pin.appendModel(model, member_model, 0, _placement(member, origin))
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
    """Return the placement of a member in the merged model; that of a free one is part of q."""
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


def _scoped(members: Sequence[_Member], values: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Merge mappings by joint, one per member, with the names of joints in the scene."""
    pairs = zip(members, values, strict=True)
    return {
        m.model_source.scoped(name): value for m, each in pairs for name, value in each.items()
    }


class _Member(NamedTuple):
    """A robot or body, and its position among the others.

    Attributes:
        model_source: Description that it was read from.
        robot: The robot or body alone.
        root: Name of its root link.
        q: Index of its first coordinate in the merged configuration.
        v: Index of its first coordinate in the merged velocity.
    """

    model_source: ModelSource
    robot: Robot
    root: str
    q: int
    v: int

    def link(self, name: str) -> str:
        """Return the name of a link in the scene; a root link may have the name of its member."""
        model_source = self.model_source
        return name if name == self.root == model_source.name else model_source.scoped(name)
