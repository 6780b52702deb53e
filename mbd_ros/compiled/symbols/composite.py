"""Mass matrix by composite inertias of the links beyond every joint.

Source: R. Featherstone, Rigid Body Dynamics Algorithms, 2008, sec. 6.2.
"""

from collections.abc import Sequence
from typing import Any

import casadi as ca

from mbd_ros.compiled.symbols import link_rotations as turns
from mbd_ros.compiled.symbols.inertias import FREE, REVOLUTE
from mbd_ros.compiled.symbols.link_rotations import Matrix, Vector, combined, cross, dot, plus
from mbd_ros.compiled.symbols.links import Tree
from mbd_ros.compiled.symbols.moving_tree import Placed
from mbd_ros.compiled.symbols.tree_forces import carried

Composite = tuple[Any, Vector, Matrix]  # mass, mass times mass centre, inertia about the origin


def mass_matrix(tree: Tree, placed: Sequence[Placed]) -> dict[tuple[int, int], Any]:
    """Entries of the lower triangle of M, armature included; what is absent is zero."""
    beyond: list[Composite] = [(ca.SX(p.link.inertia.m), p.h, p.I) for p in placed]
    M: dict[tuple[int, int], Any] = {}
    for i in range(len(placed) - 1, -1, -1):
        one, link = placed[i], placed[i].link
        for own, (force, torque) in enumerate(_columns(one, beyond[i])):
            _fill(M, placed, i, link.v + own, force, torque)
        if link.parent >= 0:
            m, h, about = beyond[link.parent]
            more = _above(one, *beyond[i])
            total = m + more[0], plus(h, more[1]), combined(about, more[2])
            beyond[link.parent] = total
    for link in tree.links:
        for own, armature in enumerate(link.armature):
            M[link.v + own, link.v + own] += armature
    return M


def _columns(one: Placed, beyond: Composite) -> list[tuple[Vector, Vector]]:
    """Force and torque that a unit acceleration of every own coordinate takes."""
    (m, h, about), axes = beyond, turns.matrix(((1, 0, 0), (0, 1, 0), (0, 0, 1)))
    if one.link.kind == REVOLUTE:
        return [(cross(one.axis, h), turns.through(about, one.axis))]
    directions = axes if one.link.kind == FREE else (one.axis,)
    columns = [(turns.times(m, axis), cross(h, axis)) for axis in directions]
    if one.link.kind == FREE:
        columns += [(cross(axis, h), turns.through(about, axis)) for axis in axes]
    return columns


def _fill(
    M: dict[tuple[int, int], Any],
    placed: Sequence[Placed],
    i: int,
    column: int,
    force: Vector,
    torque: Vector,
) -> None:
    """Entries of a column: of its own link, and of all below it."""
    while True:
        one = placed[i]
        link = one.link
        if link.kind == FREE:
            for row, value in enumerate((*force, *torque), link.v):
                M[max(row, column), min(row, column)] = value
            return
        value = dot(one.axis, torque if link.kind == REVOLUTE else force)
        M[max(link.v, column), min(link.v, column)] = value
        if link.parent < 0:
            return
        force, torque = carried(one, force, torque)
        i = link.parent


def _above(one: Placed, m: Any, h: Vector, about: Matrix) -> Composite:
    """A composite inertia about the origin of the parent, in its axes."""
    h, about = turns.out(one.turn, h), turns.tensor_out(one.turn, about)
    p, moved = one.offset, plus(h, turns.times(m, one.offset))
    # I - [p x] [h x] - [h' x] [p x] with h' = h + m p; [a x] [b x] = b a' - (a . b) 1
    across = dot(p, h) + dot(moved, p)
    upper = {
        (i, j): about[i][j] - h[i] * p[j] - p[i] * moved[j] + (across if i == j else 0.0)
        for i in range(3)
        for j in range(i, 3)
    }
    rows = (tuple(upper[min(i, j), max(i, j)] for j in range(3)) for i in range(3))
    return m, moved, tuple(rows)  # type: ignore[return-value]
