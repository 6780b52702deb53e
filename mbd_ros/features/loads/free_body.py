"""Loads on one body that is cut free from its mechanism, and the residual of its equations.

Reactions of joints come from the Newton-Euler recursion of the whole mechanism; those of fixed
joints follow from the force that each side needs. With the mass m, the mass centre c and
the inertia I about the mass centre,

    sum F + m g = m (a + alpha x c + omega x (omega x c))
    sum ((r - c) x F + M) = I alpha + omega x (I omega)

in axes of the body, where a is the acceleration of its origin. The right-hand side depends on the
links of the body alone, so a load that is missing, in other axes or in other units leaves a
residual.

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
RESIDUAL = "residual"  # residual force of a free base
JOINT = "joint"
_LOCAL = pin.LOCAL


class FreeBody:
    """A link with all links that fixed joints tie to it, cut free at its other joints.

    Loads are in the axes of the link, and their points start from its origin. The force of a joint
    acts on this body and includes the forces of actuators, springs, couplings and friction between
    its links.

    An instance owns Pinocchio data, so it must not be shared by threads.

    Args:
        robot: The robot.
        link: Link whose frame is that of the body.
        cuts: Fixed joints at which the body ends, besides the joints that move.

    Attributes:
        links: The links of the body, `link` first.
        joints: Names of the joints at which it is cut.
        inertia: `pinocchio.Inertia` in the axes of the link.
        k: Kinematics, which the caller refreshes to the state before `loads`.

    Raises:
        ModelError: The link or a joint is unknown, or the body has no mass.
    """

    def __init__(self, robot: Robot, link: str, cuts: Collection[str] = ()) -> None:
        self._robot, self._model, self.k = robot, robot.model, Kinematics(robot)
        self._data, self._tree = pin.Data(robot.model), TiedLinks(robot)
        frames, index = robot.model.frames, robot.frame(link)
        if index not in self._tree.edges:
            names = ", ".join(frames[i].name for i in self._tree.edges)
            raise ModelError(f"unknown link '{link}', accepted: {names}")
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
        self.inertia = self._body_inertia()
        self._loads, self._origin = BodyLoads(robot), robot.carrier("universe")
        self._point = robot.point(link)
        self._carrier = robot.carrier(link)

    def loads(
        self, x: State, a: Array, wrenches: Sequence[BodyWrench]
    ) -> tuple[list[BodyLoad], BodyMotion]:
        """Return the loads on the body and its motion.

        Args:
            x: State of all joints, to which `k` was refreshed.
            a: Acceleration of all joints [rad/s^2 or m/s^2], shape (nv,).
            wrenches: Wrenches on all bodies of the mechanism.
        """
        self._loads.set(self.k, ())
        for each in wrenches:
            self._loads.add(self.k, each.wrench)
        pin.rnea(self._model, self._data, x.q, x.v, a, self._loads.forces)
        links = [self._link(each) for each in wrenches]
        needed = self._needed(wrenches, links)
        loads = [self._reaction(edge, needed) for edge in self._edges]
        pairs = zip(wrenches, links, strict=True)
        loads += [self._local(each) for each, link in pairs if link in self._links]
        return loads, self._motion(x, a)

    def _body_inertia(self) -> Any:
        total = pin.Inertia.Zero()
        for link in self._links:
            total = total + self._beside[link]
        if not total.mass > 0.0:
            names = ", ".join(self.links)
            raise ModelError(f"body '{self.link}' has no mass (links: {names})")
        return self._at.actInv(total)

    def _link(self, each: BodyWrench) -> int:
        return self._tree.link_of(self._robot.frame(each.wrench.frame))

    def _needed(self, wrenches: Sequence[BodyWrench], links: Sequence[int]) -> dict[int, Any]:
        """Return the force that each link needs from its fixed joints, in axes of its joint."""
        v, a = self._data.v[self._joint], self._data.a_gf[self._joint]
        needed = {i: Y * a + v.cross(Y * v) for i, Y in self._beside.items()}
        for parent, joint in self._leaving:
            needed[parent] = needed[parent] + self._data.liMi[joint].act(self._data.f[joint])
        for each, link in zip(wrenches, links, strict=True):
            if link in needed:
                force, torque = each.wrench.force, each.wrench.torque
                about_origin = torque + cross(each.wrench.point, force)
                spatial = np.concatenate((force, about_origin))
                on_joint = self.k.transform_wrench(spatial, self._origin, self._carrier)
                needed[link] = needed[link] - pin.Force(on_joint)
        return needed

    def _reaction(self, edge: Edge, needed: dict[int, Any]) -> BodyLoad:
        """Return the load of a joint on the body, about the origin of the joint."""
        frames, data = self._model.frames, self._data
        leads = edge.child in self._links
        if edge.joint and leads:
            force, place = data.f[edge.joint], pin.SE3.Identity()
        elif edge.joint:
            place = self._model.jointPlacements[edge.joint]
            force = -data.liMi[edge.joint].act(data.f[edge.joint])
        else:
            behind, place = self._tree.behind(edge.child), frames[edge.child].placement
            summed = needed.keys() - behind if leads and self._joint else behind
            force = pin.Force.Zero()
            for link in summed:
                force = force + needed[link]
            if summed is not behind:
                force = data.f[self._joint] - force
            elif not leads:
                force = -force
        there = self._at.inverse() * place
        point = there.translation
        load = self._at.actInv(force)
        moment = load.angular - cross(point, load.linear)
        kind = edge.name if edge.name in (WORLD, RESIDUAL) else JOINT
        return BodyLoad(edge.name, kind, np.array(point), np.array(load.linear), moment)

    def _local(self, each: BodyWrench) -> BodyLoad:
        """Express a wrench in the axes of the body."""
        R, wrench = self.k.rotation(self._point), each.wrench
        point = (wrench.point - self.k.position(self._point)).dot(R)
        return BodyLoad(each.name, each.kind, point, wrench.force.dot(R), wrench.torque.dot(R))

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
        name: Name of the joint; `world` for a fixed root link, `residual` for a free base.
        joint: Index of the joint in the model; 0 for a fixed joint.
        parent: Index of the frame of the parent link in the model; 0 for the world.
        child: Index of the frame of the child link in the model.
    """

    name: str
    joint: int
    parent: int
    child: int


class BodyLoad(NamedTuple):
    """A load on the body, in its axes.

    Attributes:
        name: Name of the joint or part that exerts it.
        kind: joint, world, residual, constraint, contact, force, external wrench or muscle.
        point: Point of action, from the origin of the body [m], shape (3,).
        force: Force [N], shape (3,).
        moment: Moment about `point` [N·m], shape (3,).
    """

    name: str
    kind: str
    point: Array
    force: Array
    moment: Array


class BodyMotion(NamedTuple):
    """Motion of the body, in its axes.

    Attributes:
        gravity: Acceleration of gravity [m/s^2], shape (3,).
        acceleration: Acceleration of the origin of the body [m/s^2], shape (3,).
        angular_velocity: Angular velocity [rad/s], shape (3,).
        angular_acceleration: Angular acceleration [rad/s^2], shape (3,).
    """

    gravity: Array
    acceleration: Array
    angular_velocity: Array
    angular_acceleration: Array


class TiedLinks:
    """Links of a robot as a tree of joints, including the fixed joints.

    Attributes:
        edges: Parent joints of links, by the index of the frame of the link in the model.
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
                fixed = model_source.scoped(name) if parent else WORLD
                title = names[joint] if joint else fixed
                self.edges[below] = Edge(title, joint, above, below)

    def link_of(self, frame: int) -> int:
        """Return the index of the frame of the link that carries a frame; 0 for the world."""
        while frame not in self.edges and frame:
            frame = int(self._frames[frame].parentFrame)
        return frame

    def tied_to(self, link: int, cuts: Collection[str]) -> list[int]:
        """Return a link and the links that fixed joints tie to it.

        Args:
            link: Index of the frame of the link.
            cuts: Names of fixed joints that do not tie.
        """
        ties = [
            (edge.parent, edge.child)
            for edge in self.edges.values()
            if not edge.joint and edge.parent and edge.name not in cuts
        ]
        tied = [link]
        for each in tied:  # grows during the loop
            neighbours = [b if a == each else a for a, b in ties if each in (a, b)]
            tied += [other for other in neighbours if other not in tied]
        return tied

    def behind(self, link: int) -> set[int]:
        """Return a link and its descendants by fixed joints."""
        descendants = [link]
        for each in descendants:  # grows during the loop
            fixed = (c for c, e in self.edges.items() if not e.joint and e.parent == each)
            descendants += list(fixed)
        return set(descendants)

    def around(self, links: Collection[int]) -> list[Edge]:
        """Return the joints between these links and others, the parent joint first."""
        inside = [edge for child, edge in self.edges.items() if child in links]
        leading = [edge for edge in inside if edge.parent not in links]
        outside = [
            edge
            for child, edge in self.edges.items()
            if edge.parent in links and child not in links
        ]
        return [*leading, *outside]

    def check_cuts(self, cuts: Collection[str], links: Collection[int]) -> None:
        """Refuse names that are not joints of a body.

        Raises:
            ModelError: A name is not that of a joint; the message lists the joints.
        """
        known = [
            edge.name
            for child, edge in self.edges.items()
            if (child in links or edge.parent in links) and edge.name not in (WORLD, RESIDUAL)
        ]
        for name in cuts:
            if name not in known:
                accepted = ", ".join(known) or "none"
                raise ModelError(f"joint '{name}' is not one of this body, accepted: {accepted}")


def _joints(model_source: ModelSource) -> Iterator[tuple[str, str, str]]:
    """Yield name, parent and child of every joint of the description; first those of the root.

    The frames of a Pinocchio model do not contain the links of a locked joint.
    """
    tree = parse_urdf(model_source.text, model_source.source)
    root = root_link(tree)

    def full_name(link: str) -> str:
        return (
            model_source.name if link == root and model_source.name else model_source.scoped(link)
        )

    yield "", "", full_name(root)
    for joint in tree.findall("joint"):
        parent, child = (full_name(link_name(joint, end)) for end in ("parent", "child"))
        yield joint.get("name", ""), parent, child


class ActingWrenches:
    """Wrenches of parts on bodies.

    Forces in joints, such as torques of drives and of couplings, are no such wrenches: they are
    part of the reactions of joints.

    Args:
        rows: Constraint rows of the multipliers.
        forces: Force parts.
        loads: External loads by name.
        paths: Paths of muscles by the name of the muscle.
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
    ) -> Iterator[BodyWrench]:
        """Yield the wrenches at a state.

        Args:
            k: Kinematics at the state.
            x: State of all joints.
            multipliers: Multipliers of the rows, shape (m,).
            loads: One (6,) array [N, N·m] for every external load.
            tensions: Tension of every path [N].
        """
        for part, mine in zip(self._rows.parts, self._rows.slices, strict=True):
            kind = CONTACT if part.law.kind is Kind.CONE else CONSTRAINT
            yield from _named(part.name, kind, part.wrenches(k, x, multipliers[mine]))
        for force in self._forces:
            kind = CONTACT if getattr(force, "contact", None) is not None else FORCE
            yield from _named(force.name, kind, force.wrenches(k, x, NONE))
        for (name, load), value in zip(self._loads.items(), loads, strict=True):
            yield from _named(name, EXTERNAL, load.wrenches_of(k, value))
        no_torque = np.zeros(3)
        for (name, path), tension in zip(self._paths.items(), tensions, strict=True):
            pulls = path.pulls(k, x)
            wrenches = (Wrench(p.frame, p.point, p.force * tension, no_torque) for p in pulls)
            yield from _named(name, MUSCLE, wrenches)


def _named(
    name: str, kind: str, wrenches: Iterator[Wrench] | tuple[Wrench, ...]
) -> Iterator[BodyWrench]:
    return (BodyWrench(name, kind, wrench) for wrench in wrenches)


class BodyWrench(NamedTuple):
    """A wrench of a part on a body.

    Attributes:
        name: Name of the part.
        kind: constraint, contact, force, external wrench or muscle.
        wrench: The wrench.
    """

    name: str
    kind: str
    wrench: Wrench


def balance(loads: Sequence[BodyLoad], inertia: Any, motion: BodyMotion) -> Balance:
    """Return the residual of the equations of a body under its loads.

    Args:
        loads: Loads in axes of the body.
        inertia: `pinocchio.Inertia` of the body in its axes.
        motion: Motion of the body in its axes.
    """
    point, force, moment = (np.array([a[i] for a in loads]).reshape(-1, 3) for i in (2, 3, 4))
    return balances(point, force, moment, inertia, motion)


def balances(
    point: Array, force: Array, moment: Array, inertia: Any, motion: BodyMotion
) -> Balance:
    """Return the residuals of the equations of a body in many samples.

    Args:
        point: Points of action [m], shape (.., loads, 3).
        force: Forces [N], shape (.., loads, 3).
        moment: Moments about the points [N·m], shape (.., loads, 3).
        inertia: `pinocchio.Inertia` of the body.
        motion: Vectors of shape (.., 3).
    """
    inertial, twist = inertial_load(inertia, motion)
    weight = inertia.mass * motion.gravity
    arm = point - inertia.lever
    moment_of_force = np.cross(arm, force)
    gyration = math.sqrt(max(float(np.trace(inertia.inertia)), 0.0) / inertia.mass)
    size = np.maximum(_largest(arm), gyration)
    forces = [_largest(force), *(np.linalg.norm(w, axis=-1) for w in (weight, inertial - weight))]
    moments = [_largest(moment), _largest(moment_of_force), np.linalg.norm(twist, axis=-1)]
    largest = np.maximum(np.max(forces, axis=0), _ratio(np.max(moments, axis=0), size))
    residual = force.sum(axis=-2) + inertial
    total = (moment + moment_of_force).sum(axis=-2)
    return Balance(residual, total + twist, largest, size)


def inertial_load(inertia: Any, motion: BodyMotion) -> tuple[Array, Array]:
    """Return weight less inertial force, and the inertial moment about the mass centre.

    Args:
        inertia: Inertia of the body, with `mass`, `lever` and `inertia` of `pinocchio.Inertia`.
        motion: Motion of the body, vectors of shape (.., 3).

    Returns:
        Force [N] and moment [N·m], shape (.., 3) each.
    """
    turn, spin, c = motion.angular_acceleration, motion.angular_velocity, inertia.lever
    of_centre = motion.acceleration + np.cross(turn, c) + np.cross(spin, np.cross(spin, c))
    force: Array = inertia.mass * (motion.gravity - of_centre)
    moment: Array = -turn @ inertia.inertia - np.cross(spin, spin @ inertia.inertia)
    return force, moment


def _largest(vectors: Array) -> Array:
    largest: Array = np.linalg.norm(vectors, axis=-1).max(axis=-1, initial=0.0)
    return largest


def _ratio(part: Array, total: Array) -> Array:
    """Return the quotient, which is 0 where the total is 0."""
    part, total = np.asarray(part), np.asarray(total)
    ratio: Array = np.divide(part, total, out=np.zeros(np.shape(part)), where=total != 0.0)
    return ratio


class Balance(NamedTuple):
    """Residual of the equations of a body, and the largest of their terms.

    Attributes:
        force: Residual force [N], shape (.., 3).
        moment: Residual moment about the mass centre [N·m], shape (.., 3).
        largest: Force of the largest term [N], shape (..); a moment is divided by `size`.
        size: Length that makes moments comparable with forces: the largest arm of a load about
            the mass centre, but at least the radius of gyration of the body [m], shape (..).
    """

    force: Array
    moment: Array
    largest: Array
    size: Array

    @property
    def off(self) -> Array:
        """Residual as a share of the largest term [-], shape (..); 0 without any load."""
        moment = _ratio(np.linalg.norm(self.moment, axis=-1), self.size)
        residual = np.maximum(np.linalg.norm(self.force, axis=-1), moment)
        return _ratio(residual, self.largest)
