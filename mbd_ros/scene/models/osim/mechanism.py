"""Joints and bodies of a model -> joints and links of a description; loops are cut open."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import pinocchio as pin

from mbd_ros.scene.models.osim.item import GROUND, Attached, Frames, Item, frame_entries
from mbd_ros.scene.models.osim.joints import Coordinate, Joint
from mbd_ros.scene.models.urdf_text import (
    IDENTITY,
    Function,
    Mass,
    Motion,
    Names,
    Step,
    UrdfJoint,
    X,
    Y,
    Z,
    is_identity,
)

_DIRECT = {"WeldJoint": "full", "BallJoint": "point"}  # which need no second half


class Mechanism:
    """The joints and links of a model.

    Args:
        joints: In the order of the tree, each after what carries its parent.
        links: Names of the bodies, ground first.

    Attributes:
        joints: Of the description.
        links: Names of its links, ground first.
        follows: Joint -> what it follows, of those that are no coordinates.
        unused: Coordinates that move nothing.
    """

    def __init__(self, joints: Sequence[Joint], links: Sequence[str]) -> None:
        self.coordinates = {c.name: c for joint in joints for c in joint.coordinates}
        self.joints: list[UrdfJoint] = []
        self.links = list(links)
        self.follows: dict[str, Follows] = {}
        self.unused: list[Coordinate] = []
        self._links = Names(self.links)
        self._names = Names(self.coordinates)
        for joint in joints:
            self._add(joint)

    def carriers(self, fixed: Mapping[str, float]) -> dict[str, str]:
        """Link -> the joint that carries it where some do not move, empty for ground."""
        names = {GROUND: ""}
        for joint in self.joints:
            moves = joint.motion is not None and joint.name not in fixed
            names[joint.child] = joint.name if moves else names[joint.parent]
        return names

    def _add(self, joint: Joint) -> None:
        steps, carriers = joint.all_steps, _carriers(joint)
        if joint.parent.body not in self.links:
            raise joint.item.error(f"its parent '{joint.parent.body}' is not in the tree")
        parent, origin = joint.parent.body, pin.SE3.Identity()
        for i, step in enumerate(steps):
            if not _moves(step):
                origin = origin * _placed(step)
                continue
            assert isinstance(step, Motion)
            is_last = _is_none(steps[i + 1 :])
            child = joint.child.body if is_last else self._link(step.name)
            parent = self._moved(step, carriers, parent, child, origin)
            origin = pin.SE3.Identity()
        if parent != joint.child.body:
            wish = joint.name or joint.child.body
            name = self._names.take(f"{wish}_weld" if wish in self.links else wish, "weld")
            self.joints.append(UrdfJoint(name, parent, joint.child.body, origin))
        self._add_unseen(joint, carriers)

    def _moved(
        self, step: Motion, carriers: Mapping[str, Motion], parent: str, child: str, origin: Any
    ) -> str:
        """Add a joint that moves; the link that it carries."""
        if carriers.get(step.coordinate) is step:
            slope, offset = step.function.slope, step.function.offset
            own = step._replace(axis=step.axis * slope, function=IDENTITY)
            limits = self.coordinates[step.coordinate].limits
            placed = origin * step.at(offset)
            self.joints.append(UrdfJoint(step.coordinate, parent, child, placed, own, limits))
        else:
            name = self._names.take(step.name)
            self.joints.append(UrdfJoint(name, parent, child, origin, step))
            self.follows[name] = Follows(step.coordinate, step.function)
        return child

    def _add_unseen(self, joint: Joint, carriers: Mapping[str, Motion]) -> None:
        """A link without mass for a coordinate that nothing follows one to one."""
        for coordinate in joint.coordinates:
            users = [s for s in joint.steps if _moves(s) and s.coordinate == coordinate.name]
            if not users:
                self.unused.append(coordinate)
            elif coordinate.name not in carriers:
                turns = any(step.turns for step in users)
                motion = Motion("", users[0].axis, turns, IDENTITY, coordinate.name)
                child = self._link(coordinate.name)
                at = UrdfJoint(
                    coordinate.name,
                    joint.parent.body,
                    child,
                    joint.parent.at,
                    motion,
                    coordinate.limits,
                )
                self.joints.append(at)

    def _link(self, wish: str) -> str:
        name = self._links.take(f"{wish}_link")
        self.links.append(name)
        return name


class Follows(NamedTuple):
    """A joint that follows a coordinate by a function."""

    coordinate: str
    function: Function


def _carriers(joint: Joint) -> dict[str, Motion]:
    """Coordinate -> the motion that is the coordinate itself, perhaps backwards, turns first."""
    motion_of: dict[str, Motion] = {}
    motions = [step for step in joint.steps if _moves(step)]
    for step in sorted(motions, key=lambda motion: not motion.turns):
        if step.function.slope in (1.0, -1.0):
            motion_of.setdefault(step.coordinate, step)
    return motion_of


def _moves(step: Step) -> bool:
    return isinstance(step, Motion) and step.function.constant is None


def _placed(step: Step) -> Any:
    return step.at(step.function.constant) if isinstance(step, Motion) else step


def _is_none(rest: Iterable[Step]) -> bool:
    """Whether nothing follows but placements that are none."""
    product = pin.SE3.Identity()
    for step in rest:
        if _moves(step):
            return False
        product = product * _placed(step)
    return is_identity(product)


def in_tree_order(
    joints: Sequence[Joint], frames: Frames, model: Item
) -> tuple[list[Joint], list[Joint]]:
    """Joints from ground outwards, turned round where that is needed, and those that close loops.

    Bodies without any joint move freely.
    """
    left, placed, ordered = list(joints), {GROUND}, list[Joint]()
    while left or len(placed) < len(frames.bodies):
        next_joint = _next(left, placed)
        if next_joint is not None:
            left.remove(next_joint)
            next_joint = (
                next_joint if next_joint.parent.body in placed else turned_round(next_joint)
            )
        else:
            body = _base(left, placed, frames)
            if body is None:
                break
            next_joint = free_joint(body, model)
        ordered.append(next_joint)
        placed.add(next_joint.child.body)
    return ordered, left


def _next(left: Sequence[Joint], placed: set[str]) -> Joint | None:
    """The next joint from a body that is placed to one that is not, else one the other way."""
    ends = [(joint.parent.body in placed, joint.child.body in placed) for joint in left]
    for wish in ((True, False), (False, True)):
        if wish in ends:
            return left[ends.index(wish)]
    return None


def _base(left: Sequence[Joint], placed: set[str], frames: Frames) -> str | None:
    """A body that no joint carries, or one of those that only hang together among themselves."""
    loose = [body for body in frames.bodies if body not in placed]
    carried = {joint.child.body for joint in left}
    return next((body for body in loose if body not in carried), loose[0] if loose else None)


def turned_round(joint: Joint) -> Joint:
    """The same joint from its child to its parent."""
    steps = tuple(step.inverse() for step in reversed(joint.steps))
    return joint._replace(parent=joint.child, child=joint.parent, steps=steps)


def free_joint(body: str, model: Item) -> Joint:
    """Six joints of a body that nothing holds, as OpenSim calls their coordinates."""
    item = Item(model.element.makeelement("FreeJoint", {"name": f"free_{body}"}), model.source)
    names = [f"free_{body}_coord_{i}" for i in range(6)]
    coordinates = tuple(Coordinate(item, name, 0.0, 0.0, None, False) for name in names)
    six = [(axis, False, names[3 + i]) for i, axis in enumerate((X, Y, Z))]
    six += [(axis, True, names[i]) for i, axis in enumerate((X, Y, Z))]
    steps = tuple(Motion(name, axis, turns, IDENTITY, name) for axis, turns, name in six)
    ends = Attached(GROUND, pin.SE3.Identity()), Attached(body, pin.SE3.Identity())
    return Joint(item, item.name, *ends, coordinates, steps)


def open_loops(loops: Sequence[Joint], taken: Sequence[str]) -> Cut:
    """Open loops at the children of the joints that close them.

    Such a body is cut in two halves that a constraint holds together; welds and balls need no
    second half.

    Args:
        loops: The joints that close loops.
        taken: Names that links have.
    """
    cut, names = Cut([], {}, {}), Names(taken)
    for loop in loops:
        joint = turned_round(loop) if loop.child.body == GROUND else loop
        closure: dict[str, Any] = {"type": "loop_closure"}
        if joint.item.type in _DIRECT:
            closure["kind"] = _DIRECT[joint.item.type]
            closure |= frame_entries("a", joint.parent) | frame_entries("b", joint.child)
        else:
            half = names.take(f"{joint.child.body}_{joint.name}")
            cut.halves[half] = joint.child.body
            cut.joints.append(joint._replace(child=Attached(half, joint.child.at)))
            pose, other = (Attached(name, pin.SE3.Identity()) for name in (joint.child.body, half))
            closure |= {"kind": "full"} | frame_entries("a", pose) | frame_entries("b", other)
        cut.closures[joint.name] = closure
    return cut


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


def share_masses(masses: dict[str, Mass], halves: dict[str, str]) -> dict[str, Mass]:
    """Masses with each body that is cut shared evenly by its parts."""
    shares = dict(masses)
    for body in set(halves.values()):
        parts = [body, *(half for half, of_body in halves.items() if of_body == body)]
        of_body = masses[body]
        moments = [moment / len(parts) for moment in of_body.moments]
        shares |= dict.fromkeys(parts, Mass(of_body.mass / len(parts), of_body.centre, moments))
    return shares
