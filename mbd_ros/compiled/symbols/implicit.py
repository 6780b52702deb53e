"""Equations of motion in implicit form, and derivatives that follow from it.

    r = (G' (M a + h - tau) - J' lam, J y'' + b),   a = G y'' + drift

so that d(y'', lam) = -K^-1 dr with K = (M, -J'; J, 0), whose factors are at hand. Unrolled through
forward dynamics the same derivatives take many times as many operations.

Source: J. Carpentier, N. Mansard, Analytical derivatives of rigid body dynamics algorithms, RSS
2018.
"""

from collections.abc import Sequence
from typing import Any

import casadi as ca

from mbd_ros.compiled.symbols.equations import Equations
from mbd_ros.compiled.symbols.scalar import scalars
from mbd_ros.compiled.symbols.tree.dynamics import TreeDynamics
from mbd_ros.compiled.symbols.tree.link_rotations import ZERO
from mbd_ros.compiled.symbols.tree.moving_tree import rotation_of
from mbd_ros.compiled.symbols.untraceable import Untraceable

_BASE_V = 6
_MOST = 100_000  # operations: more of them gain nothing over differences
_BY = "qvzup"


def residual(
    equations: Equations,
    a: Sequence[Any],
    lam: Sequence[Any],
    dynamics: TreeDynamics | None = None,
) -> Any:
    """The r, a column of size nv + the number of rows that act.

    Args:
        a: The y'', SX scalars.
        lam: Multipliers of the rows that act, SX scalars.
        dynamics: In axes of one's choice; by default those in which accelerations take the fewest
            operations.
    """
    c, rows = equations.coordinates, equations.active_rows
    all_a = [ca.SX(entry) for entry in c.lifted(a)]
    needed = (equations.chosen[0] if dynamics is None else dynamics).needed(all_a)
    left = c.reduced([n - t for n, t in zip(needed, equations.tau, strict=True)])
    ends = list(equations.bias)
    for i, row in enumerate(rows.J):
        for j, value in row.items():
            left[j] = left[j] - value * lam[i]
            ends[i] = ends[i] + value * a[j]
    return ca.vertcat(*left, *ends)


def derivatives(equations: Equations) -> list[Any]:
    """Derivatives of accelerations and rates by q, v, z, u and p, each of shape (nv + nz, ..)."""
    solution, nv, m = equations.chosen[1], equations.nv, len(equations.active_rows.J)
    columns = sum(equations.symbols[letter].shape[0] for letter in _BY)
    count = 8 * columns * nv  # at least, before any is made
    factors = None if count > _MOST else equations.beside(equations.active_rows)
    count = count if factors is None else factors.size * columns
    if factors is None or count > _MOST:
        raise Untraceable(f"its derivatives take some {count} operations, accepted are {_MOST}")
    a, lam = ca.SX.sym("a", nv), ca.SX.sym("lam", m)
    r = residual(equations, scalars(a), scalars(lam))
    tables = []
    for letter in _BY:
        by = equations.symbols[letter]
        slopes = in_tangent(equations, letter, ca.jacobian(r, by))
        rates = in_tangent(equations, letter, ca.jacobian(equations.rates, by))
        values = [ca.vertcat(*solution.a), ca.vertcat(*solution.lam)]
        slopes = ca.substitute([slopes], [a, lam], values)[0]
        columns = [_solved(factors, slopes[:, j], nv, m) for j in range(slopes.shape[1])]
        top = ca.horzcat(*columns) if columns else ca.SX(nv, 0)
        tables.append(ca.vertcat(top, rates))
    return tables


def _solved(factors: Any, slope: Any, nv: int, m: int) -> Any:
    entries = [slope[i] if slope.sparsity().has_nz(i, 0) else ZERO for i in range(nv + m)]
    solved = factors.solve([-entry for entry in entries[:nv]], [-entry for entry in entries[nv:]])
    return ca.vertcat(*solved.a)


def in_tangent(equations: Equations, letter: str, slopes: Any) -> Any:
    """Slopes by steps in the tangent of q; those by anything else as they are."""
    model = equations.system.chart.model
    if letter != "q" or model.nq == model.nv:
        return slopes
    tangent, q = ca.SX(model.nq, model.nv), equations.symbols["q"]
    for joint in model.joints:
        if joint.nv == 1:
            tangent[joint.idx_q, joint.idx_v] = 1.0
        elif joint.nv == _BASE_V:
            at, v = joint.idx_q, joint.idx_v
            x, y, z, w = ca.vertsplit(q[at + 3 : at + 7])
            tangent[at : at + 3, v : v + 3] = _square(rotation_of((x, y, z, w)))
            rates = [[w, -z, y], [z, w, -x], [-y, x, w], [-x, -y, -z]]
            tangent[at + 3 : at + 7, v + 3 : v + 6] = 0.5 * _square(rates)
    return slopes @ tangent


def _square(rows: Any) -> Any:
    return ca.vertcat(*(ca.horzcat(*row) for row in rows))


def balance(equations: Equations) -> list[Any]:
    """The residual force tau - h - M a + J' lam, shape (nv,), and rates of internal states."""
    a, lam = (scalars(equations.symbols[key]) for key in "al")
    return [-residual(equations, a, lam)[: equations.nv], equations.rates]


def balance_slopes(equations: Equations) -> list[Any]:
    """Slopes of `balance`, stacked, by steps of q, by v and by z, each of shape (nv + nz, ..)."""
    both = ca.vertcat(*balance(equations))
    slopes = []
    for letter in "qvz":
        by = ca.jacobian(both, equations.symbols[letter])
        slopes.append(in_tangent(equations, letter, by))
    return slopes


def energy(equations: Equations) -> list[Any]:
    """Kinetic and potential energy [J]."""
    tree, k = equations.tree, equations.k
    kinetic, potential = ZERO, ca.SX(-float(tree.gravity @ tree.ground.h))
    v = ca.vertsplit(equations.column_of_velocity)
    for (i, j), value in equations.chosen[0].mass.items():
        kinetic += (0.5 if i == j else 1.0) * value * v[i] * v[j]
    for number, link in enumerate(tree.links):
        place = k.place_of(number)
        moment = [link.inertia.m * p + h for p, h in zip(*place, strict=True)]
        for g, component in zip(tree.gravity.tolist(), moment, strict=True):
            potential -= g * component
    return [kinetic, potential]
