"""The links of a tree at symbolic positions, in their own axes or in those of the world."""

from typing import Any, NamedTuple

import casadi as ca

from mbd_ros.compiled.symbols import link_rotations as turns
from mbd_ros.compiled.symbols.inertias import FREE, PRISMATIC
from mbd_ros.compiled.symbols.link_rotations import ONE, ZERO, Matrix, PlaneTurn, Turn, Vector
from mbd_ros.compiled.symbols.links import Link, Tree, cosine_and_sine

_UP: Vector = (ZERO, ZERO, ONE)


class Placed(NamedTuple):
    """A link at a configuration, in the axes that its tree was asked for.

    Attributes:
        link: The link.
        turn: From its axes to those of its parent; none where all are those of the world.
        offset: Its origin from that of its parent, in axes of the parent [m].
        axis: Of its joint, in its axes.
        h: Mass times mass centre [kg·m].
        I: Inertia about its origin [kg·m^2].
        R: From its axes to those of the world; None where nobody needs it.
    """

    link: Link
    turn: Turn
    offset: Vector
    axis: Vector
    h: Vector
    I: Matrix  # noqa: E741
    R: Matrix | None


def placements(tree: Tree, q: Any) -> list[tuple[Turn, Vector]]:
    """Turn to the axes of the parent, and offset there, of every link with one coordinate.

    Args:
        tree: The links.
        q: Configuration, one SX scalar an entry.
    """
    return [_placement(link, q) for link in tree.links]


def _placement(link: Link, q: Any) -> tuple[Turn, Vector]:
    if link.kind == FREE:
        R = rotation_of(q[link.q + 3 : link.q + 7])
        return (turns.MatrixTurn(R),), tuple(q[link.q : link.q + 3])
    position = q[link.q]
    before = [*_constant(2, link.beta), *_constant(0, link.alpha)]
    offset = turns.vector(link.offset)
    if link.kind == PRISMATIC:
        whole = [*before, *_constant(2, link.gamma)]
        way = turns.out(whole, (ZERO, ZERO, position))
        return whole, turns.plus(offset, way)
    return [*before, _about_axis(position, link.gamma)], offset


def _about_axis(angle: Any, offset: float) -> PlaneTurn:
    """A turn about z, of sine and cosine of the angle alone where the offset is a right one."""
    c, s = (turns.known(one) for one in cosine_and_sine(offset))
    if c is not ZERO and s is not ZERO:
        return PlaneTurn(2, ca.cos(angle + offset), ca.sin(angle + offset))
    ahead = PlaneTurn(2, ca.cos(angle), ca.sin(angle)).vector((c, s, ZERO))
    return PlaneTurn(2, ahead[0], ahead[1])


def _constant(axis: int, angle: float) -> Turn:
    c, s = cosine_and_sine(angle)
    return () if (c, s) == (1.0, 0.0) else (PlaneTurn(axis, turns.known(c), turns.known(s)),)


def in_own_axes(tree: Tree, q: Any) -> list[Placed]:
    """Every link in its own axes."""
    found = []
    for link, (turn, offset) in zip(tree.links, placements(tree, q), strict=True):
        inertia = turns.vector(link.inertia.h), turns.matrix(link.inertia.I)
        found.append(Placed(link, turn, offset, _UP, *inertia, None))
    return found


def in_world_axes(tree: Tree, q: Any) -> list[Placed]:
    """Every link in the axes of the world, about its own origin; for trees without free bodies."""
    found: list[Placed] = []
    for link, (turn, offset) in zip(tree.links, placements(tree, q), strict=True):
        before = turns.EYE if link.parent < 0 else found[link.parent].R
        assert before is not None
        R, way = turns.product(before, turn), turns.through(before, offset)
        h = turns.through(R, turns.vector(link.inertia.h))
        about = turns.matrix_tensor(R, turns.matrix(link.inertia.I))
        axis = turns.through(R, _UP)
        found.append(Placed(link, (), way, axis, h, about, R))
    return found


def rotation_of(quaternion: Any) -> Matrix:
    """Rotation matrix of a unit quaternion x, y, z, w."""
    x, y, z, w = quaternion
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
        (2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)),
        (2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
    )
