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
    """Force and torque that the motion of a link requires.

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
    needed_forces: list[Needed] = []
    moves: list[tuple[Vector, Vector, Vector, Matrix]] = []
    for body in placed:
        first = NO_VECTOR, NO_VECTOR, falls, _NO_U
        above = first if body.link.parent < 0 else moves[body.link.parent]
        moves.append(_moved(body, above, v, a))
        needed_forces.append(_needed(body, moves[-1]))
    return needed_forces


def _moved(body: Placed, above: Any, v: Any, a: Any) -> tuple[Vector, Vector, Vector, Matrix]:
    """Angular velocity, its rate, the acceleration of the origin, and U of a link."""
    link, (spin, turning, linear, U) = body.link, above
    if link.kind == FREE:
        return _freed(body, linear, v[link.v : link.v + 6], a and a[link.v : link.v + 6])
    linear = turns.into(body.turn, plus(linear, turns.through(U, body.offset)))
    spin, turning = turns.into(body.turn, spin), turns.into(body.turn, turning)
    added = turns.times(a[link.v], body.axis) if a else NO_VECTOR
    along = turns.times(v[link.v], body.axis)
    if link.kind == REVOLUTE:
        turning = plus(plus(turning, cross(spin, along)), added)
        spin = plus(spin, along)
        return spin, turning, linear, turns.bend(spin, turning)
    linear = plus(plus(linear, turns.times(ca.SX(2.0), cross(spin, along))), added)
    return spin, turning, linear, turns.bend(spin, turning) if body.turn else U


def _freed(body: Placed, falls: Vector, v: Any, a: Any) -> tuple[Vector, Vector, Vector, Matrix]:
    """The same of a free body, whose velocity stands in its own axes: a = dv/dt + w x v."""
    spin, turning = tuple(v[3:]), NO_VECTOR
    linear = plus(turns.into(body.turn, falls), cross(spin, tuple(v[:3])))
    if a:
        linear, turning = plus(linear, tuple(a[:3])), tuple(a[3:])
    return spin, turning, linear, turns.bend(spin, turning)


def _needed(body: Placed, moved: Any) -> Needed:
    """Force and torque; w x I w is split over U and products of w, which fold where I is plain."""
    w, b, linear, U = moved
    h, about = body.h, body.I
    force = plus(turns.times(turns.known(float(body.link.inertia.m)), linear), turns.through(U, h))
    torque = list(cross(h, linear))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        diagonal, between = about[i][i], less(about[k][k], about[j][j])
        if _same(diagonal, between):
            gyroscopic = by(diagonal, U[k][j])
        elif _same(diagonal, less(ZERO, between)):
            gyroscopic = less(ZERO, by(diagonal, U[j][k]))
        else:
            gyroscopic = more(by(diagonal, b[i]), by(between, by(w[j], w[k])))
        products = less(by(about[i][k], U[j][i]), by(about[i][j], U[k][i]))
        squares = by(about[j][k], less(by(w[j], w[j]), by(w[k], w[k])))
        torque[i] = more(more(more(torque[i], gyroscopic), products), squares)
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
        body, (force, torque) = placed[i], sums[i]
        link = body.link
        if link.kind == FREE:
            tau[link.v : link.v + 6] = [*force, *torque]
            continue
        tau[link.v] = dot(body.axis, torque if link.kind == REVOLUTE else force)
        if link.parent >= 0:
            above = sums[link.parent]
            sums[link.parent] = Needed(*map(plus, above, carried(body, force, torque)))
    return tau


def carried(body: Placed, force: Vector, torque: Vector) -> tuple[Vector, Vector]:
    """A force and a torque about the origin of a link, about that of its parent, in its axes."""
    force, torque = turns.out(body.turn, force), turns.out(body.turn, torque)
    return force, plus(torque, cross(body.offset, force))
