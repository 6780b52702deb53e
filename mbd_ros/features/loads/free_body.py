"""Loads on one body that is cut free from its mechanism, and whether they explain its motion.

Reactions of joints come from the Newton-Euler recursion of the whole mechanism; between links
that fixed joints tie they follow from what each side needs. With the mass m, the mass centre c and
the inertia I about the mass centre,

    sum F + m g = m (a + alpha x c + omega x (omega x c))
    sum ((r - c) x F + M) = I alpha + omega x (I omega)

in axes of the body, a the acceleration of its origin. The right-hand side comes from the links of
the body alone: a load that is missing, in other axes or in other units does not stay hidden.
Source: R. Featherstone, Rigid Body Dynamics Algorithms, 2008, sec. 2.13 to 2.15 and 5.3.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.contracts import Load, Wrench
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.kinematics.paths.paths import Path
from mbd_ros.core.kinematics.poses import cross
from mbd_ros.core.loads.external_loads import ExternalWrench
from mbd_ros.core.loads.loads import BodyLoads
from mbd_ros.core.model.robot import WORLD, ModelSource, Robot
from mbd_ros.core.model.robot_reader import root_link
from mbd_ros.core.model.urdf import link_name, parse_urdf
from mbd_ros.core.rows.constraint import Kind
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import NONE, Array, State
from mbd_ros.errors import ModelError

CONSTRAINT, CONTACT, FORCE = "constraint", "contact", "force"
EXTERNAL, MUSCLE = "external wrench", "muscle"
RESIDUAL = "residual"  # what nothing carries of a free base
JOINT = "joint"
_LOCAL = pin.LOCAL


class FreeBody:
    """A link with all that fixed joints tie to it, cut free at its other joints.

    Loads stand in the axes of the link and about points that count from its origin. The force of
    a joint is that on this body; it includes what actuators, springs, couplings and friction of
    the joint exert between its links.

    One instance owns its Pinocchio data: not for two threads.

    Args:
        link: Its frame is that of the body.
        cuts: Fixed joints at which the body ends too; joints that move need no mention.

    Attributes:
        links: The links of the body, `link` first.
        joints: Names of the joints that it is cut at.
        inertia: `pinocchio.Inertia` in the axes of the link.
        k: Kinematics, refreshed to the state that `loads` is asked at by the caller.

    Raises:
        ModelError: Unknown link or joint, or a body without mass.
    """

    def __init__(self, robot: Robot, link: str, cuts: Collection[str] = ()) -> None:
        self._robot, self._model, self.k = robot, robot.model, Kinematics(robot)
        self._data, self._tree = pin.Data(robot.model), TiedLinks(robot)
        frames, index = robot.model.frames, robot.frame(link)
        if index not in self._tree.edges:
            names = ", ".join(frames[i].name for i in self._tree.edges)
            raise ModelError(f"no link '{link}'; the links are {names}")
        self.link, self._frame = link, index
        self._tree.check_cuts(cuts, self._tree.tied_to(index, ()))
        self._links = self._tree.tied_to(index, cuts)
        self.links = tuple(frames[i].name for i in self._links)
        self._joint, self._at = int(frames[index].parentJoint), frames[index].placement
        self._edges = self._tree.around(self._links)
        self.joints = tuple(edge.name for edge in self._edges)
        inertias = robot.inertias()
        self._beside = {
            i: frames[i].placement.act(inertias.get(frames[i].name, pin.Inertia.Zero()))
            for i in self._tree.edges
            if frames[i].parentJoint == self._joint
        }
        self._leaving = [
            (edge.parent, edge.joint)
            for edge in self._tree.edges.values()
            if edge.joint and edge.parent in self._beside
        ]
        self.inertia = self._own_inertia()
        self._loads, self._origin = BodyLoads(robot), robot.carrier("universe")
        self._point = robot.point(link)
        self._carrier = robot.carrier(link)

    def loads(
        self, x: State, a: Array, acting: Sequence[Named]
    ) -> tuple[list[BodyLoad], BodyMotion]:
        """Loads on the body and its motion.

        Args:
            x: State of all joints, which `k` was refreshed to.
            a: Acceleration of all joints [rad/s^2 or m/s^2], shape (nv,).
            acting: What acts on bodies of the whole mechanism.
        """
        self._loads.set(self.k, ())
        for one in acting:
            self._loads.add(self.k, one.wrench)
        pin.rnea(self._model, self._data, x.q, x.v, a, self._loads.forces)
        beside = [self._link(one) for one in acting]
        needed = self._needed(acting, beside)
        found = [self._reaction(edge, needed) for edge in self._edges]
        mine = set(self._links)
        found += [
            self._seen(one) for one, link in zip(acting, beside, strict=True) if link in mine
        ]
        return found, self._motion(x, a)

    def _own_inertia(self) -> Any:
        total = pin.Inertia.Zero()
        for link in self._links:
            total = total + self._beside[link]
        if not total.mass > 0.0:
            names = ", ".join(self.links)
            raise ModelError(f"body '{self.link}' has no mass (links: {names})")
        return self._at.actInv(total)

    def _link(self, one: Named) -> int:
        return self._tree.link_of(self._robot.frame(one.wrench.frame))

    def _needed(self, acting: Sequence[Named], beside: Sequence[int]) -> dict[int, Any]:
        """What each link of the same joint needs from its fixed joints, in axes of the joint."""
        v, a = self._data.v[self._joint], self._data.a_gf[self._joint]
        needed = {i: Y * a + v.cross(Y * v) for i, Y in self._beside.items()}
        for parent, joint in self._leaving:
            needed[parent] = needed[parent] + self._data.liMi[joint].act(self._data.f[joint])
        for one, link in zip(acting, beside, strict=True):
            if link in needed:
                force, torque = one.wrench.force, one.wrench.torque
                about = torque + cross(one.wrench.point, force)
                whole = np.concatenate((force, about))
                carried = self.k.transform_wrench(whole, self._origin, self._carrier)
                needed[link] = needed[link] - pin.Force(carried)
        return needed

    def _reaction(self, edge: Edge, needed: dict[int, Any]) -> BodyLoad:
        """What a joint exerts on the body, about its origin."""
        frames, data = self._model.frames, self._data
        leads = edge.child in self._links
        if edge.joint and leads:
            whole, place = data.f[edge.joint], pin.SE3.Identity()
        elif edge.joint:
            place = self._model.jointPlacements[edge.joint]
            whole = -data.liMi[edge.joint].act(data.f[edge.joint])
        else:
            behind, place = self._tree.behind(edge.child), frames[edge.child].placement
            rest = needed.keys() - behind if leads and self._joint else behind
            whole = pin.Force.Zero()
            for link in rest:
                whole = whole + needed[link]
            if rest is not behind:
                whole = data.f[self._joint] - whole
            elif not leads:
                whole = -whole
        there = self._at.inverse() * place
        point = there.translation
        load = self._at.actInv(whole)
        moment = load.angular - cross(point, load.linear)
        kind = edge.name if edge.name in (WORLD, RESIDUAL) else JOINT
        return BodyLoad(edge.name, kind, np.array(point), np.array(load.linear), moment)

    def _seen(self, one: Named) -> BodyLoad:
        R, wrench = self.k.rotation(self._point), one.wrench
        point = (wrench.point - self.k.position(self._point)).dot(R)
        return BodyLoad(one.name, one.kind, point, wrench.force.dot(R), wrench.torque.dot(R))

    def _motion(self, x: State, a: Array) -> BodyMotion:
        model, data, frame = self._model, self._data, self._frame
        pin.forwardKinematics(model, data, x.q, x.v, a)
        gravity = model.gravity.linear.dot(self.k.rotation(self._point))
        if not self._joint:
            return BodyMotion(gravity, np.zeros(3), np.zeros(3), np.zeros(3))
        velocity = pin.getFrameVelocity(model, data, frame, _LOCAL)
        push = pin.getFrameClassicalAcceleration(model, data, frame, _LOCAL)
        return BodyMotion(
            gravity, np.array(push.linear), np.array(velocity.angular), np.array(push.angular)
        )


class Edge(NamedTuple):
    """A joint between two links.

    Attributes:
        name: Of the joint; `world` where a link stands still, `residual` where it moves freely.
        joint: Its index in the model, 0 where it does not move.
        parent: Index in the model of the frame of the link before it, 0 for the world.
        child: The same of the link behind it.
    """

    name: str
    joint: int
    parent: int
    child: int


class BodyLoad(NamedTuple):
    """A load on the body, in its axes.

    Attributes:
        name: Of the joint or part that it comes from.
        kind: joint, world, residual, constraint, contact, force, external wrench or muscle.
        point: Where it acts, from the origin of the body [m], shape (3,).
        force: [N], shape (3,).
        moment: About `point` [N·m], shape (3,).
    """

    name: str
    kind: str
    point: Array
    force: Array
    moment: Array


class BodyMotion(NamedTuple):
    """How the body moves, in its axes.

    Attributes:
        gravity: Acceleration of gravity [m/s^2], shape (3,).
        acceleration: Of the origin of the body [m/s^2], shape (3,).
        angular_velocity: [rad/s], shape (3,).
        angular_acceleration: [rad/s^2], shape (3,).
    """

    gravity: Array
    acceleration: Array
    angular_velocity: Array
    angular_acceleration: Array


class TiedLinks:
    """Links of a robot as a tree of joints, those that never move among them.

    Attributes:
        edges: Joint that leads to a link, by the index of the frame of the link in the model.
    """

    def __init__(self, robot: Robot) -> None:
        self._frames = robot.model.frames
        by_v = {joint.v: joint.name for joint in robot.joints}
        names = {i: by_v.get(int(j.idx_v), RESIDUAL) for i, j in enumerate(robot.model.joints)}
        self.edges: dict[int, Edge] = {}
        for model_source in robot.model_sources:
            for name, parent, child in _joints(model_source):
                above = robot.frame(parent) if parent else 0
                below = robot.frame(child)
                joint = int(self._frames[below].parentJoint)
                if joint == int(self._frames[above].parentJoint):
                    joint = 0
                called = names[joint] if joint else model_source.scoped(name) if parent else WORLD
                self.edges[below] = Edge(called, joint, above, below)

    def link_of(self, frame: int) -> int:
        """Index of the frame of the link that carries a frame, 0 for the world."""
        while frame not in self.edges and frame:
            frame = int(self._frames[frame].parentFrame)
        return frame

    def tied_to(self, link: int, cuts: Collection[str]) -> list[int]:
        """The links that fixed joints tie to a link, itself the first of them.

        Args:
            link: Index of its frame.
            cuts: Names of fixed joints that tie nothing.
        """
        ties = [
            (edge.parent, edge.child)
            for edge in self.edges.values()
            if not edge.joint and edge.parent and edge.name not in cuts
        ]
        tied = [link]
        for one in tied:  # grows while it is gone through
            beside = [b if a == one else a for a, b in ties if one in (a, b)]
            tied += [other for other in beside if other not in tied]
        return tied

    def behind(self, link: int) -> set[int]:
        """The links that fixed joints tie behind a link, itself included."""
        found = [link]
        for one in found:  # grows while it is gone through
            found += [c for c, e in self.edges.items() if not e.joint and e.parent == one]
        return set(found)

    def around(self, links: Collection[int]) -> list[Edge]:
        """The joints between some links and others, that which leads to them first."""
        inside = [edge for child, edge in self.edges.items() if child in links]
        leading = [edge for edge in inside if edge.parent not in links]
        outside = [
            edge
            for child, edge in self.edges.items()
            if edge.parent in links and child not in links
        ]
        return [*leading, *outside]

    def check_cuts(self, cuts: Collection[str], links: Collection[int]) -> None:
        """Refuse names that are no joints of a body.

        Raises:
            ModelError: Names the joint and those that there are.
        """
        known = [
            edge.name
            for child, edge in self.edges.items()
            if (child in links or edge.parent in links) and edge.name not in (WORLD, RESIDUAL)
        ]
        for name in cuts:
            if name not in known:
                there = ", ".join(known) or "none"
                raise ModelError(f"joint '{name}' is none of this body; its joints are {there}")


def _joints(model_source: ModelSource) -> Iterator[tuple[str, str, str]]:
    """Every joint as described, the link before it and that behind it; first the root by itself.

    The frames of a Pinocchio model do not tell what a locked joint joined.
    """
    tree = parse_urdf(model_source.text, model_source.source)
    root = root_link(tree)

    def called(link: str) -> str:
        return (
            model_source.name if link == root and model_source.name else model_source.scoped(link)
        )

    yield "", "", called(root)
    for joint in tree.findall("joint"):
        parent, child = (called(link_name(joint, end)) for end in ("parent", "child"))
        yield joint.get("name", ""), parent, child


class ActingWrenches:
    """Wrenches of parts on bodies.

    What acts in joints, such as torques of drives and of couplings, is none of them: it goes
    through the reactions of joints.

    Args:
        rows: The rows that multipliers are given for.
        loads: External loads by name.
        paths: What muscles pull along, by the name of the muscle.
    """

    def __init__(
        self,
        rows: ConstraintRows,
        forces: Sequence[Load],
        loads: Mapping[str, ExternalWrench],
        paths: Mapping[str, Path],
    ) -> None:
        self._rows, self._forces = rows, tuple(forces)
        self._loads, self._paths = dict(loads), dict(paths)

    def at(
        self,
        k: Kinematics,
        x: State,
        multipliers: Array,
        loads: Sequence[Array],
        tensions: Sequence[float],
    ) -> Iterator[Named]:
        """The wrenches at a state.

        Args:
            x: State of all joints.
            multipliers: Of the rows, shape (m,).
            loads: One (6,) array [N, N·m] for every external load.
            tensions: One for every path [N].
        """
        for part, mine in zip(self._rows.parts, self._rows.slices, strict=True):
            kind = CONTACT if part.law.kind is Kind.CONE else CONSTRAINT
            yield from _named(part.name, kind, part.wrenches(k, x, multipliers[mine]))
        for force in self._forces:
            kind = CONTACT if getattr(force, "contact", None) is not None else FORCE
            yield from _named(force.name, kind, force.wrenches(k, x, NONE))
        for (name, load), value in zip(self._loads.items(), loads, strict=True):
            yield from _named(name, EXTERNAL, load.wrenches_of(k, value))
        free = np.zeros(3)
        for (name, path), tension in zip(self._paths.items(), tensions, strict=True):
            pulls = path.pulls(k, x)
            pulled = (Wrench(p.frame, p.point, p.force * tension, free) for p in pulls)
            yield from _named(name, MUSCLE, pulled)


def _named(
    name: str, kind: str, wrenches: Iterator[Wrench] | tuple[Wrench, ...]
) -> Iterator[Named]:
    return (Named(name, kind, wrench) for wrench in wrenches)


class Named(NamedTuple):
    """A wrench on a body, and whose it is.

    Attributes:
        name: Of the part.
        kind: constraint, contact, force, external wrench or muscle.
    """

    name: str
    kind: str
    wrench: Wrench


def balance(loads: Sequence[BodyLoad], inertia: Any, motion: BodyMotion) -> Balance:
    """Whether loads explain the motion of a body.

    Args:
        loads: In axes of the body.
        inertia: `pinocchio.Inertia` in the same.
        motion: In the same.
    """
    point, force, moment = (np.array([a[i] for a in loads]).reshape(-1, 3) for i in (2, 3, 4))
    return balances(point, force, moment, inertia, motion)


def balances(
    point: Array, force: Array, moment: Array, inertia: Any, motion: BodyMotion
) -> Balance:
    """The same of many samples.

    Args:
        point: Where loads act [m], shape (.., loads, 3).
        force: [N], shape (.., loads, 3).
        moment: About the points [N·m], shape (.., loads, 3).
        inertia: `pinocchio.Inertia` of the body.
        motion: Vectors of shape (.., 3).
    """
    inertial, twist = inertial_load(inertia, motion)
    weight = inertia.mass * motion.gravity
    arm = point - inertia.lever
    turning = np.cross(arm, force)
    gyration = math.sqrt(max(float(np.trace(inertia.inertia)), 0.0) / inertia.mass)
    size = np.maximum(_largest(arm), gyration)
    forces = [_largest(force), *(np.linalg.norm(w, axis=-1) for w in (weight, inertial - weight))]
    moments = [_largest(moment), _largest(turning), np.linalg.norm(twist, axis=-1)]
    largest = np.maximum(np.max(forces, axis=0), _ratio(np.max(moments, axis=0), size))
    left = force.sum(axis=-2) + inertial
    return Balance(left, (moment + turning).sum(axis=-2) + twist, largest, size)


def inertial_load(inertia: Any, motion: BodyMotion) -> tuple[Array, Array]:
    """Weight less what the motion needs: force, and moment about the mass centre.

    Args:
        inertia: With `mass`, `lever` and `inertia`, as `pinocchio.Inertia` of the body.
        motion: Its motion, vectors of shape (.., 3).

    Returns:
        [N] and [N·m], shape (.., 3) each.
    """
    turn, spin, c = motion.angular_acceleration, motion.angular_velocity, inertia.lever
    of_centre = motion.acceleration + np.cross(turn, c) + np.cross(spin, np.cross(spin, c))
    force: Array = inertia.mass * (motion.gravity - of_centre)
    moment: Array = -turn @ inertia.inertia - np.cross(spin, spin @ inertia.inertia)
    return force, moment


def _largest(vectors: Array) -> Array:
    largest: Array = np.linalg.norm(vectors, axis=-1).max(axis=-1, initial=0.0)
    return largest


def _ratio(part: Array, whole: Array) -> Array:
    """The quotient, 0 where the whole is 0."""
    part, whole = np.asarray(part), np.asarray(whole)
    ratio: Array = np.divide(part, whole, out=np.zeros(np.shape(part)), where=whole != 0.0)
    return ratio


class Balance(NamedTuple):
    """What is left of the equations of a body, and the largest of their terms.

    Attributes:
        force: Left of the forces [N], shape (.., 3).
        moment: Left of the moments about the mass centre [N·m], shape (.., 3).
        largest: Force of the largest term [N], shape (..); a moment counts divided by `size`.
        size: Length that compares moments with forces: the largest arm of a load about the mass
            centre, or the radius of gyration of the body where that is more [m], shape (..).
    """

    force: Array
    moment: Array
    largest: Array
    size: Array

    @property
    def off(self) -> Array:
        """What is left as a share of the largest term [-], shape (..); 0 where nothing acts."""
        turning = _ratio(np.linalg.norm(self.moment, axis=-1), self.size)
        left = np.maximum(np.linalg.norm(self.force, axis=-1), turning)
        return _ratio(left, self.largest)
