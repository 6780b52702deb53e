"""Dynamics of a tree of links in one choice of axes, without rows and loads.

The mass matrix comes from composite inertias of the links beyond every joint, M a + h from Newton
and Euler, and forward dynamics, in a time linear in the links, from articulated-body inertias.
What velocities and gravity do is in the forces that links need to move on without joint
accelerations there: the sweep is linear.

Source: R. Featherstone, Rigid Body Dynamics Algorithms, 2008, sec. 6.2 and 7.3.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols.sparse_ldl import Entries, SparseLdl
from mbd_ros.compiled.symbols.tree import link_rotations as turns
from mbd_ros.compiled.symbols.tree.link_rotations import (
    NO_VECTOR,
    ZERO,
    Matrix,
    Vector,
    combined,
    cross,
    dot,
    minus,
    plus,
    vector,
)
from mbd_ros.compiled.symbols.tree.links import FREE, REVOLUTE, Link, Tree
from mbd_ros.compiled.symbols.tree.moving_tree import Placed, in_own_axes, in_world_axes
from mbd_ros.compiled.symbols.tree.newton_euler import Needed, carried, joint_forces, needed

LONG = 24  # velocities from which an open chain has one form
Place = Callable[[Tree, Sequence[Any]], Sequence[Placed]]
Composite = tuple[Any, Vector, Matrix]  # mass, mass times mass centre, inertia about the origin


class TreeDynamics:
    """Dynamics of all joints.

    Args:
        q: Configuration, one SX scalar an entry.
        place: Gives where the links are, in axes of its choice.
    """

    def __init__(self, tree: Tree, q: Sequence[Any], v: Sequence[Any], place: Place) -> None:
        self._tree, self._q, self._v, self._place = tree, q, v, place

    @cached_property
    def _placed(self) -> Sequence[Placed]:
        return self._place(self._tree, self._q)

    @cached_property
    def mass(self) -> Entries:
        """The lower triangle of M."""
        return mass_matrix(self._tree, self._placed)

    def forces(self, a: Sequence[Any] | None = None) -> list[Any]:
        """M a + h but for what armature takes, SX scalars.

        Args:
            a: Accelerations, SX scalars; None for none.
        """
        on_links = needed(self._tree, self._placed, self._v, a, vector(-self._tree.gravity))
        return joint_forces(self._tree, self._placed, on_links)

    def needed(self, a: Sequence[Any]) -> list[Any]:
        """M a + h."""
        torques = self.forces(a)
        for link in self._tree.links:
            for i, armature in enumerate(link.armature, link.v):
                if not (isinstance(armature, float) and armature == 0.0):
                    torques[i] = torques[i] + armature * a[i]
        return torques

    def articulated(self, tau: Sequence[Any]) -> list[Any]:
        """Accelerations under joint forces, in a time linear in the links."""
        tree, placed = self._tree, self._placed
        on_links = needed(tree, placed, self._v, None, vector(-tree.gravity))
        return forward_dynamics(tree, placed, on_links, tau)


def choices(
    tree: Tree, q: Sequence[Any], v: Sequence[Any], *, has_rows: bool
) -> list[TreeDynamics]:
    """The same dynamics in axes of the links and in those of the world, where that may pay.

    Args:
        q: Configuration, SX scalars.
        v: Velocity, SX scalars.
        has_rows: Whether rows of frames stand in axes of the world.
    """
    forms = [TreeDynamics(tree, q, v, in_own_axes)]
    if all(link.kind != FREE for link in tree.links) and (has_rows or tree.nv <= LONG):
        forms.append(TreeDynamics(tree, q, v, in_world_axes))
    return forms


def mass_matrix(tree: Tree, placed: Sequence[Placed]) -> dict[tuple[int, int], Any]:
    """Entries of the lower triangle of M, armature included; what is absent is zero."""
    beyond: list[Composite] = [(ca.SX(p.link.inertia.m), p.h, p.I) for p in placed]
    M: dict[tuple[int, int], Any] = {}
    for i in range(len(placed) - 1, -1, -1):
        body, link = placed[i], placed[i].link
        for diagonal, (force, torque) in enumerate(_columns(body, beyond[i])):
            _fill(M, placed, i, link.v + diagonal, force, torque)
        if link.parent >= 0:
            m, h, about = beyond[link.parent]
            more = _composite_above(body, *beyond[i])
            total = m + more[0], plus(h, more[1]), combined(about, more[2])
            beyond[link.parent] = total
    for link in tree.links:
        for diagonal, armature in enumerate(link.armature):
            M[link.v + diagonal, link.v + diagonal] += armature
    return M


def _columns(body: Placed, beyond: Composite) -> list[tuple[Vector, Vector]]:
    """Force and torque that a unit acceleration of every own coordinate takes."""
    (m, h, about), axes = beyond, turns.matrix(((1, 0, 0), (0, 1, 0), (0, 0, 1)))
    if body.link.kind == REVOLUTE:
        return [(cross(body.axis, h), turns.through(about, body.axis))]
    directions = axes if body.link.kind == FREE else (body.axis,)
    columns = [(turns.times(m, axis), cross(h, axis)) for axis in directions]
    if body.link.kind == FREE:
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
        body = placed[i]
        link = body.link
        if link.kind == FREE:
            for row, value in enumerate((*force, *torque), link.v):
                M[max(row, column), min(row, column)] = value
            return
        value = dot(body.axis, torque if link.kind == REVOLUTE else force)
        M[max(link.v, column), min(link.v, column)] = value
        if link.parent < 0:
            return
        force, torque = carried(body, force, torque)
        i = link.parent


def _composite_above(body: Placed, m: Any, h: Vector, about: Matrix) -> Composite:
    """A composite inertia about the origin of the parent, in its axes."""
    h, about = turns.out(body.turn, h), turns.tensor_out(body.turn, about)
    p, moved = body.offset, plus(h, turns.times(m, body.offset))
    # I - [p x] [h x] - [h' x] [p x] with h' = h + m p; [a x] [b x] = b a' - (a . b) 1
    across = dot(p, h) + dot(moved, p)
    upper = {
        (i, j): about[i][j] - h[i] * p[j] - p[i] * moved[j] + (across if i == j else 0.0)
        for i in range(3)
        for j in range(i, 3)
    }
    rows = (tuple(upper[min(i, j), max(i, j)] for j in range(3)) for i in range(3))
    return m, moved, tuple(rows)  # type: ignore[return-value]


def forward_dynamics(
    tree: Tree, placed: Sequence[Placed], on_links: Sequence[Needed], tau: Any
) -> list[Any]:
    """Joint accelerations, one SX scalar a velocity.

    Args:
        placed: Where they are.
        on_links: What they need without joint accelerations.
        tau: Generalized forces, one SX scalar a velocity.
    """
    inertias, forces = [_rigid(body) for body in placed], list(on_links)
    pivots: list[_Pivot | None] = [None] * len(placed)
    a = [ZERO] * tree.nv
    for i in range(len(placed) - 1, -1, -1):
        body, link = placed[i], placed[i].link
        if link.kind == FREE:
            at = slice(link.v, link.v + 6)
            a[at] = _freed(link, inertias[i], forces[i], tau[at])
            continue
        pivot = pivots[i] = _pivot(body, inertias[i], forces[i], tau[link.v])
        if link.parent >= 0:
            left = _left(body, inertias[i], pivot)
            push = pivot.share * pivot.residual
            on = forces[i]
            needs = (
                plus(on.force, turns.times(push, pivot.force)),
                plus(on.torque, turns.times(push, pivot.torque)),
            )
            above = forces[link.parent]
            forces[link.parent] = Needed(*map(plus, above, carried(body, *needs)))
            inertias[link.parent] = inertias[link.parent].plus(_articulated_above(body, left))
    return _forward(placed, pivots, a)


def _rigid(body: Placed) -> Articulated:
    m, (x, y, z) = ca.SX(body.link.inertia.m), body.h
    A = (m, ZERO, ZERO), (ZERO, m, ZERO), (ZERO, ZERO, m)
    return Articulated(A, ((ZERO, z, -y), (-z, ZERO, x), (y, -x, ZERO)), body.I)


class Articulated(NamedTuple):
    """Force and torque about the origin: f = A a + B b, n = B' a + D b.

    Attributes:
        A: By the acceleration of the origin, symmetric [kg].
        B: By the angular acceleration [kg·m].
        D: Symmetric [kg·m^2].
    """

    A: Matrix
    B: Matrix
    D: Matrix

    def plus(self, other: Articulated) -> Articulated:
        """Both together."""
        return Articulated(*map(combined, self, other))


class _Pivot(NamedTuple):
    """Results of the backward sweep for the forward one, of a joint with one coordinate.

    Attributes:
        force: Force that a unit of joint acceleration takes, part of U.
        torque: Torque that it takes, the other part.
        share: 1 / (S' U + armature).
        residual: Joint force that is left, less what links need.
    """

    force: Vector
    torque: Vector
    share: Any
    residual: Any


def _freed(link: Link, inertia: Articulated, on: Needed, tau: Any) -> list[Any]:
    """Accelerations of a free body: all six of them at once."""
    A, B, D = inertia
    upper = np.block([[np.array(A), np.array(B)], [np.array(B).T, np.array(D)]])
    entries = {(i, j): upper[i, j] for i in range(6) for j in range(i + 1)}
    for i in range(6):
        entries[i, i] = entries[i, i] + link.armature[i]
    right = [t - needs for t, needs in zip(tau, (*on.force, *on.torque), strict=True)]
    return SparseLdl(entries, range(6)).solve(right)


def _pivot(body: Placed, inertia: Articulated, on: Needed, tau: Any) -> _Pivot:
    axis, (A, B, D) = body.axis, inertia
    if body.link.kind == REVOLUTE:
        force, torque = turns.through(B, axis), turns.through(D, axis)
        diagonal, needs = dot(axis, torque), dot(axis, on.torque)
    else:
        force, torque = turns.through(A, axis), turns.through(turns.transposed(B), axis)
        diagonal, needs = dot(axis, force), dot(axis, on.force)
    return _Pivot(force, torque, 1.0 / (diagonal + body.link.armature[0]), tau - needs)


def _left(body: Placed, inertia: Articulated, pivot: _Pivot) -> Articulated:
    """Return the articulated inertia that a parent feels: I - U U' / d."""
    fs, ts = turns.times(pivot.share, pivot.force), turns.times(pivot.share, pivot.torque)
    A = _less(inertia.A, pivot.force, fs)
    B = combined(inertia.B, _outer(pivot.force, ts), -1)
    D = _less(inertia.D, pivot.torque, ts)
    along = [i for i in range(3) if (body.axis[i] * body.axis[i] - 1.0).is_zero()]
    if not along:
        return Articulated(A, B, D)
    # along a known axis a joint carries what its armature takes, and nothing without one
    k, retained = along[0], body.link.armature[0] * pivot.share
    if body.link.kind == REVOLUTE:
        D = _with_cross(D, k, [retained * inertia.D[k][i] for i in range(3)])
        column = [retained * inertia.B[i][k] for i in range(3)]
        B = tuple(  # type: ignore[assignment]
            tuple(column[i] if j == k else B[i][j] for j in range(3)) for i in range(3)
        )
    else:
        A = _with_cross(A, k, [retained * inertia.A[k][i] for i in range(3)])
        row = tuple(retained * inertia.B[k][j] for j in range(3))
        B = tuple(row if i == k else B[i] for i in range(3))  # type: ignore[assignment]
    return Articulated(A, B, D)


def _less(A: Matrix, a: Vector, b: Vector) -> Matrix:
    """A - a b', symmetric."""
    upper = {(i, j): A[i][j] - a[i] * b[j] for i in range(3) for j in range(i, 3)}
    return _symmetric(upper)


def _symmetric(upper: dict[tuple[int, int], Any]) -> Matrix:
    return tuple(  # type: ignore[return-value]
        tuple(upper[min(i, j), max(i, j)] for j in range(3)) for i in range(3)
    )


def _outer(a: Vector, b: Vector) -> Matrix:
    return turns.times(a[0], b), turns.times(a[1], b), turns.times(a[2], b)


def _with_cross(A: Matrix, k: int, values: Sequence[Any]) -> Matrix:
    """A symmetric matrix with another row and column k."""
    upper = {(i, j): A[i][j] for i in range(3) for j in range(i, 3)}
    upper |= {(min(i, k), max(i, k)): values[i] for i in range(3)}
    return _symmetric(upper)


def _articulated_above(body: Placed, inertia: Articulated) -> Articulated:
    """An articulated inertia about the origin of the parent, in its axes."""
    A, B, D = (turns.tensor_out(body.turn, part) for part in inertia)
    x, y, z = body.offset
    P: Matrix = ((ZERO, -z, y), (z, ZERO, -x), (-y, x, ZERO))
    moved = combined(B, _product(A, P), -1)
    PB, PBt = _product(P, moved), _product(P, B)
    D = tuple(  # type: ignore[assignment]  # D - B' P + P (B - A P), (B' P)' = -P B
        tuple(D[i][j] + PB[min(i, j)][max(i, j)] + PBt[max(i, j)][min(i, j)] for j in range(3))
        for i in range(3)
    )
    return Articulated(A, moved, D)


def _product(A: Matrix, B: Matrix) -> Matrix:
    columns = turns.transposed(B)
    return tuple(tuple(dot(row, column) for column in columns) for row in A)  # type: ignore[return-value]


def _forward(placed: Sequence[Placed], pivots: Sequence[_Pivot | None], a: list[Any]) -> list[Any]:
    moves: list[tuple[Vector, Vector]] = []
    for body, pivot in zip(placed, pivots, strict=True):
        link = body.link
        if pivot is None:
            moves.append((tuple(a[link.v : link.v + 3]), tuple(a[link.v + 3 : link.v + 6])))
            continue
        linear, angular = (NO_VECTOR, NO_VECTOR) if link.parent < 0 else moves[link.parent]
        linear = turns.into(body.turn, minus(linear, cross(body.offset, angular)))
        angular = turns.into(body.turn, angular)
        carried_on = dot(pivot.force, linear) + dot(pivot.torque, angular)
        a[link.v] = pivot.share * (pivot.residual - carried_on)
        added = turns.times(a[link.v], body.axis)
        if link.kind == REVOLUTE:
            angular = plus(angular, added)
        else:
            linear = plus(linear, added)
        moves.append((linear, angular))
    return a
