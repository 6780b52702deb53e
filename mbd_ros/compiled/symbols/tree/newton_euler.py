"""Forces that a motion needs: recursive Newton-Euler sweeps over a tree.

Every link has an angular velocity w and, of its origin, an acceleration a; with
U = [dw/dt x] + [w x] [w x] a point r of it accelerates by a + U r. Force and torque about the
origin are f = m a + U h and n = h x a + I dw/dt + w x I w.

Source: R. Featherstone, Rigid Body Dynamics Algorithms, 2008, sec. 5.3; U: W. Khalil, E. Dombre,
Modeling, Identification and Control of Robots, 2002, ch. 9.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols.tree import link_rotations as turns
from mbd_ros.compiled.symbols.tree.link_rotations import (
    NO_VECTOR,
    ZERO,
    Matrix,
    Vector,
    by,
    cross,
    dot,
    less,
    more,
    plus,
)
from mbd_ros.compiled.symbols.tree.links import FREE, REVOLUTE, Tree
from mbd_ros.compiled.symbols.tree.moving_tree import Placed

_ROUNDING = 1.0e-15
_NO_U = turns.matrix(np.zeros((3, 3)))


class Needed(NamedTuple):
    """What a link needs to move as it does.

    Attributes:
        force: [N].
        torque: About its origin [N·m].
    """

    force: Vector
    torque: Vector


def needed(tree: Tree, placed: Sequence[Placed], v: Any, a: Any, falls: Vector) -> list[Needed]:
    """Force and torque on every link, gravity counted as an acceleration of the world.

    Args:
        placed: Where they are.
        v: Velocity, one SX scalar an entry.
        a: Acceleration, the same; None for none.
        falls: Acceleration of the world, against that of free fall [m/s^2].
    """
    found: list[Needed] = []
    moves: list[tuple[Vector, Vector, Vector, Matrix]] = []
    for one in placed:
        first = NO_VECTOR, NO_VECTOR, falls, _NO_U
        above = first if one.link.parent < 0 else moves[one.link.parent]
        moves.append(_moved(one, above, v, a))
        found.append(_needed(one, moves[-1]))
    return found


def _moved(one: Placed, above: Any, v: Any, a: Any) -> tuple[Vector, Vector, Vector, Matrix]:
    """Angular velocity, its rate, the acceleration of the origin, and U of a link."""
    link, (spin, turning, linear, U) = one.link, above
    if link.kind == FREE:
        return _freed(one, linear, v[link.v : link.v + 6], a and a[link.v : link.v + 6])
    linear = turns.into(one.turn, plus(linear, turns.through(U, one.offset)))
    spin, turning = turns.into(one.turn, spin), turns.into(one.turn, turning)
    added = turns.times(a[link.v], one.axis) if a else NO_VECTOR
    along = turns.times(v[link.v], one.axis)
    if link.kind == REVOLUTE:
        turning = plus(plus(turning, cross(spin, along)), added)
        spin = plus(spin, along)
        return spin, turning, linear, turns.bend(spin, turning)
    linear = plus(plus(linear, turns.times(ca.SX(2.0), cross(spin, along))), added)
    return spin, turning, linear, turns.bend(spin, turning) if one.turn else U


def _freed(one: Placed, falls: Vector, v: Any, a: Any) -> tuple[Vector, Vector, Vector, Matrix]:
    """The same of a free body, whose velocity stands in its own axes: a = dv/dt + w x v."""
    spin, turning = tuple(v[3:]), NO_VECTOR
    linear = plus(turns.into(one.turn, falls), cross(spin, tuple(v[:3])))
    if a:
        linear, turning = plus(linear, tuple(a[:3])), tuple(a[3:])
    return spin, turning, linear, turns.bend(spin, turning)


def _needed(one: Placed, moved: Any) -> Needed:
    """Force and torque; w x I w is split over U and products of w, which fold where I is plain."""
    w, b, linear, U = moved
    h, about = one.h, one.I
    force = plus(turns.times(turns.known(float(one.link.inertia.m)), linear), turns.through(U, h))
    torque = list(cross(h, linear))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        own, between = about[i][i], less(about[k][k], about[j][j])
        if _same(own, between):
            turned = by(own, U[k][j])
        elif _same(own, less(ZERO, between)):
            turned = less(ZERO, by(own, U[j][k]))
        else:
            turned = more(by(own, b[i]), by(between, by(w[j], w[k])))
        products = less(by(about[i][k], U[j][i]), by(about[i][j], U[k][i]))
        squares = by(about[j][k], less(by(w[j], w[j]), by(w[k], w[k])))
        torque[i] = more(more(more(torque[i], turned), products), squares)
    return Needed(force, tuple(torque))  # type: ignore[arg-type]


def _same(a: Any, b: Any) -> bool:
    """Whether two numbers are the same to rounding, both known."""
    if not (a.is_constant() and b.is_constant()):
        return False
    return abs(float(a) - float(b)) <= _ROUNDING * abs(float(a))


def joint_forces(tree: Tree, placed: Sequence[Placed], on_links: Sequence[Needed]) -> list[Any]:
    """Generalized forces that give links what they need, one SX scalar a velocity."""
    tau, sums = [ZERO] * tree.nv, list(on_links)
    for i in range(len(placed) - 1, -1, -1):
        one, (force, torque) = placed[i], sums[i]
        link = one.link
        if link.kind == FREE:
            tau[link.v : link.v + 6] = [*force, *torque]
            continue
        tau[link.v] = dot(one.axis, torque if link.kind == REVOLUTE else force)
        if link.parent >= 0:
            above = sums[link.parent]
            sums[link.parent] = Needed(*map(plus, above, carried(one, force, torque)))
    return tau


def carried(one: Placed, force: Vector, torque: Vector) -> tuple[Vector, Vector]:
    """A force and a torque about the origin of a link, about that of its parent, in its axes."""
    force, torque = turns.out(one.turn, force), turns.out(one.turn, torque)
    return force, plus(torque, cross(one.offset, force))
