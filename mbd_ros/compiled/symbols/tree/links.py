"""Links in axes in which most numbers are zero.

The z axis of a link is that of its joint, x goes along the common normal to the axis of the next
joint. Source: W. Khalil, J. Kleinfinger, A new geometric notation for open and closed-loop robots,
ICRA 1986.

The part of a mass distribution that a joint cannot move is given to the parent: a distribution on
the axis of a revolute joint, the inertia tensor beyond a prismatic one. The equations of motion
stay the same. Source: W. Khalil, E. Dombre, Modeling, Identification and Control of Robots, 2002,
ch. 9.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array

REVOLUTE, PRISMATIC, FREE = "revolute", "prismatic", "free"
_SNAP = 1.0e-15  # rounding of products of rotations
_PARALLEL = 1.0e-6  # sine between axes whose common normal is not asked for
_FARTHEST = 3.0  # how far along an axis an origin may move, in sizes of the robot


class Tree(NamedTuple):
    """All links, parents before children.

    Attributes:
        ground: What the joints cannot move, in the axes of the world.
        gravity: Acceleration of free fall [m/s^2], shape (3,).
        nq: Size of a configuration.
        nv: Size of a velocity.
    """

    links: tuple[Link, ...]
    ground: Inertia
    gravity: Array
    nq: int
    nv: int


class Link(NamedTuple):
    """A joint, and the link that it moves.

    Attributes:
        joint: Index in the model.
        parent: Index of the parent in the list of links, -1 for the world.
        kind: revolute, prismatic or free.
        q: Where its coordinates begin in a configuration.
        v: Where they begin in a velocity.
        beta: Turn about z of the parent that comes first [rad].
        alpha: Turn about x after it [rad].
        gamma: Turn about z at the position 0 [rad].
        offset: Origin at the position 0, in axes of the parent [m], shape (3,).
        inertia: What is left to it.
        armature: Added to the diagonal of M [kg·m^2 or kg], one number or six.
        seat: Its axes in the frame of its Pinocchio joint: `pinocchio.SE3`.
    """

    joint: int
    parent: int
    kind: str
    q: int
    v: int
    beta: float
    alpha: float
    gamma: float
    offset: Array
    inertia: Inertia
    armature: Sequence[Any]
    seat: Any

    @property
    def nv(self) -> int:
        """Size of its velocity."""
        return 6 if self.kind == FREE else 1


def tree_of(model: Any) -> Tree:
    """The links of a model.

    Args:
        model: Pinocchio model with revolute, prismatic and free joints.
    """
    seats = _seats(model)
    inertias = [Inertia(0.0, np.zeros(3), np.zeros((3, 3)))]
    inertias += [_own_inertia(model, j, seats[j]) for j in range(1, model.njoints)]
    placed = [None] + [_placed(model, seats, j) for j in range(1, model.njoints)]
    for j in range(model.njoints - 1, 0, -1):
        movable, fixed = split(_kind(model.joints[j]), inertias[j])
        R, p = _rotation(placed[j]), placed[j][3]
        inertias[j] = movable
        up = int(model.parents[j])
        inertias[up] = inertias[up].plus(fixed.seen_from(R, p))
    links = []
    for j in range(1, model.njoints):
        joint = model.joints[j]
        armature = model.armature[joint.idx_v : joint.idx_v + joint.nv].tolist()
        where = j, int(model.parents[j]) - 1, _kind(joint), int(joint.idx_q), int(joint.idx_v)
        links.append(Link(*where, *placed[j], clean(inertias[j]), armature, seats[j]))
    gravity = model.gravity.linear.copy()
    return Tree(tuple(links), inertias[0], gravity, int(model.nq), int(model.nv))


def _seats(model: Any) -> list[Any]:
    """Where the axes of every link stand in the frame of its joint."""
    size = max(np.linalg.norm(place.translation) for place in model.jointPlacements)
    seats = [pin.SE3.Identity()]
    for j in range(1, model.njoints):
        if _kind(model.joints[j]) == FREE:
            seats.append(pin.SE3.Identity())
            continue
        z = axis_of(model, j)
        x, slide = _across(model, j, z, _FARTHEST * size)
        moves = _kind(model.joints[j]) == REVOLUTE
        seats.append(pin.SE3(_axes(x, z), z * slide if moves else np.zeros(3)))
    return seats


def _kind(joint: Any) -> str:
    if joint.nv == 6:
        return FREE
    return PRISMATIC if "P" in joint.shortname().removeprefix("JointModel")[:2] else REVOLUTE


def axis_of(model: Any, joint: int) -> Array:
    """Axis of a joint with one coordinate, in its frame, shape (3,)."""
    moves, data = model.joints[joint], model.joints[joint].createData()
    moves.calc(data, pin.neutral(model))
    motion = np.array(data.S).reshape(6)
    along = motion[3:] if _kind(moves) == REVOLUTE else motion[:3]
    return along / np.linalg.norm(along)


def _across(model: Any, j: int, z: Array, farthest: float) -> tuple[Array, float]:
    """Direction of x, and where on its axis the origin of a link stands [m]."""
    children = [c for c in model.children[j] if _kind(model.joints[c]) != FREE]
    if not children:
        h = model.inertias[j].mass * model.inertias[j].lever
        return _perpendicular(h, z), 0.0
    child = max(children, key=lambda c: len(model.subtrees[c]))
    place = model.jointPlacements[child]
    d, o = place.rotation @ axis_of(model, child), place.translation
    normal = np.cross(z, d)
    sine = float(np.linalg.norm(normal))
    if sine <= _PARALLEL:
        return _perpendicular(o, z), 0.0
    slide = float(np.cross(o, d).dot(normal)) / sine**2
    return normal / sine, slide if abs(slide) <= farthest else 0.0


def _perpendicular(v: Array, z: Array) -> Array:
    """The part of a vector across z, or any direction there, shape (3,)."""
    across = v - z * z.dot(v)
    if np.linalg.norm(across) <= _PARALLEL * np.linalg.norm(v) or not v.any():
        basis = np.eye(3)[int(np.argmin(np.abs(z)))]
        across = basis - z * z.dot(basis)
    return across / np.linalg.norm(across)


def _axes(x: Array, z: Array) -> Array:
    return np.column_stack((x, np.cross(z, x), z))


def _own_inertia(model: Any, j: int, seat: Any) -> Inertia:
    """Return the inertia of the links of a joint, in the axes of its `seat`."""
    fixed, back = model.inertias[j], seat.inverse()
    about = fixed.inertia - fixed.mass * (skew(fixed.lever) @ skew(fixed.lever))
    at_joint = Inertia(fixed.mass, fixed.mass * fixed.lever, about)
    return at_joint.seen_from(back.rotation, back.translation)


def skew(v: Array) -> Array:
    """The matrix of v x, shape (3, 3)."""
    x, y, z = v
    return np.array(((0.0 * x, -z, y), (z, 0.0 * x, -x), (-y, x, 0.0 * x)))


def _placed(model: Any, seats: list[Any], j: int) -> tuple[float, float, float, Array]:
    """Turns about z, x and z, and the offset, from the axes of the parent."""
    pose = seats[int(model.parents[j])].inverse() * model.jointPlacements[j] * seats[j]
    R, size = pose.rotation, max(1.0, float(np.abs(pose.translation).max()))
    offset = np.where(np.abs(pose.translation) <= _SNAP * size, 0.0, pose.translation)
    if _kind(model.joints[j]) == FREE:
        return 0.0, 0.0, 0.0, offset
    sine = float(np.hypot(R[0, 2], R[1, 2]))
    alpha, beta = float(np.arctan2(sine, R[2, 2])), 0.0
    if sine > _SNAP:
        beta = float(np.arctan2(R[0, 2], -R[1, 2]))
        if abs(beta) > 0.5 * np.pi + _SNAP:  # the same axis, from the other side
            beta, alpha = beta - float(np.copysign(np.pi, beta)), -alpha
    left = _turn(0, -alpha) @ _turn(2, -beta) @ R
    return beta, alpha, float(np.arctan2(left[1, 0], left[0, 0])), offset


def _turn(axis: int, angle: float) -> Array:
    c, s = cosine_and_sine(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[i, i], R[i, j], R[j, i], R[j, j] = c, -s, s, c
    return R


def cosine_and_sine(angle: float) -> tuple[float, float]:
    """Both, exact at right angles."""
    c, s = float(np.cos(angle)), float(np.sin(angle))
    if abs(c) <= _SNAP:
        return 0.0, float(np.sign(s))
    return (float(np.sign(c)), 0.0) if abs(s) <= _SNAP else (c, s)


def split(kind: str, inertia: Inertia) -> tuple[Inertia, Inertia]:
    """Split an inertia into the part of its link and the part that moves to its parent."""
    nothing = np.zeros(3), np.zeros((3, 3))
    if kind == FREE:
        return inertia, Inertia(0.0, *nothing)
    if kind == PRISMATIC:
        return inertia._replace(I=nothing[1]), Inertia(0.0, nothing[0], inertia.I)
    along = 0.5 * (inertia.I[0, 0] + inertia.I[1, 1] - inertia.I[2, 2])
    h = inertia.h * np.array((0.0, 0.0, 1.0))
    fixed = Inertia(inertia.m, h, np.diag((along, along, 0.0)))
    return Inertia(0.0, inertia.h - h, inertia.I - fixed.I), fixed


def _rotation(placed: Any) -> Array:
    """From the axes of a link at the position 0 to those of its parent, shape (3, 3)."""
    beta, alpha, gamma, _ = placed
    return _turn(2, beta) @ _turn(0, alpha) @ _turn(2, gamma)


def clean(inertia: Inertia) -> Inertia:
    """Without what is rounding beside the rest."""
    h, about = inertia.h, inertia.I
    size = float(np.abs(about).max())
    moment = max(float(np.abs(h).max()), float(np.sqrt(abs(inertia.m) * size)))
    h = np.where(np.abs(h) <= _SNAP * moment, 0.0, h)
    return Inertia(inertia.m, h, np.where(np.abs(about) <= _SNAP * size, 0.0, about))


def with_armature(tree: Tree, armature: Sequence[Any]) -> Tree:
    """The same links with other inertias of drives, one number a velocity."""
    links = (link._replace(armature=armature[link.v : link.v + link.nv]) for link in tree.links)
    return tree._replace(links=tuple(links))


def with_own_inertias(tree: Tree, model: Any) -> Tree:
    """The same links with all of their own mass, for what is asked of wrenches between them."""
    links = (
        link._replace(inertia=clean(_own_inertia(model, link.joint, link.seat)))
        for link in tree.links
    )
    return tree._replace(links=tuple(links))


class Inertia(NamedTuple):
    """Mass distribution about the origin of a link, in its axes.

    Attributes:
        m: Mass [kg].
        h: Mass times mass centre [kg·m], shape (3,).
        I: Inertia about the origin [kg·m^2], shape (3, 3).
    """

    m: Any
    h: Any
    I: Any  # noqa: E741

    def plus(self, other: Inertia) -> Inertia:
        """Both together."""
        return Inertia(self.m + other.m, self.h + other.h, self.I + other.I)

    def seen_from(self, R: Array, p: Array) -> Inertia:
        """In the axes of another link.

        Args:
            R: From these axes to the other ones, shape (3, 3).
            p: This origin in the other axes [m], shape (3,).
        """
        h, P = R @ self.h, skew(p)
        H = skew(h)
        moved = R @ self.I @ R.T - H @ P - P @ H - self.m * (P @ P)
        return Inertia(self.m, h + self.m * p, moved)
