"""Collocation defects: the equations of a phase at points, over intervals and at their ends.

The equations of motion r = 0 of `optimal_control.phase_equations` hold at every point. Over an
interval of width h, with points k and neighbours 0 and 1:

    x_j = x_0 + h sum_k A_jk x'_k,   x_1 = x_0 + h sum_k b_k x'_k + shift

Rows of positions and velocities are enforced at every end: the shifts are J' times multipliers
that vanish with the error of the method. Configurations of free bodies are x_0 (+) d with a step d
in the tangent, whose rate is that of `core.dynamics.chart`. A and b integrate the polynomial
through the rates at the points, x(s) = x_0 + h sum_k x'_k int l_k; `mesh.Collocation` has them.
Sources: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 1996, sec. IV.5 and
VII.4 (projection at ends); J. T. Betts, Practical Methods for Optimal Control, 2010, ch. 4.
"""

from functools import cache, cached_property
from typing import Any

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols.charts import CurvedChart
from mbd_ros.core.state import Array
from mbd_ros.optimal_control.mesh import Collocation, Numbers
from mbd_ros.optimal_control.phase_equations import LETTERS, PhaseEquations
from mbd_ros.optimal_control.phase_motion import BODY, Unknowns
from mbd_ros.optimal_control.sparse_program import Block, Form, Places

COLLOCATION, BODIES, CLOSING, MOTION = "collocation", "bodies", "closing", "motion"  # blocks
_BASE_Q, _BASE_V = 7, 6
_AT_POINTS = "awul"  # unknowns at points only


@cache
def interval_defects(scheme: Collocation, *, has_shifts: bool) -> Form:
    """Return the defects of a coordinate: x_0, x_k, x'_k, x_1, duration, share, and shift."""
    d = scheme.degree
    x0, x1, T, w, shift = (ca.SX.sym(name) for name in ("x0", "x1", "T", "w", "e"))
    x, rates = ca.SX.sym("x", d), ca.SX.sym("r", d)
    h = T * w
    inside = x - x0 - h * (ca.DM(scheme.A) @ rates)
    end = x1 - x0 - h * (ca.DM(scheme.b[None, :]) @ rates)
    arguments = [x0, x, rates, x1, T, w]
    if has_shifts:
        end, arguments = end - shift, [*arguments, shift]
    return Form(ca.vertcat(*arguments), ca.SX(0, 1), ca.vertcat(inside, end))


@cache
def body_defects(scheme: Collocation, *, has_shifts: bool) -> Form:
    """Return the defects of a free body: q_0, v_k, d_k, q_k, d_1, q_1, duration, share, shift."""
    d, chart = scheme.degree, CurvedChart(BODY.model)
    q0, q1 = ca.SX.sym("q0", _BASE_Q), ca.SX.sym("q1", _BASE_Q)
    v, steps = ca.SX.sym("v", _BASE_V, d), ca.SX.sym("d", _BASE_V, d)
    q, last = ca.SX.sym("q", _BASE_Q, d), ca.SX.sym("d1", _BASE_V)
    T, w, shift = ca.SX.sym("T"), ca.SX.sym("w"), ca.SX.sym("e", _BASE_V if has_shifts else 0)
    rates = ca.horzcat(*(chart.rate(steps[:, k], v[:, k]) for k in range(d)))
    inside = steps - T * w * (rates @ ca.DM(scheme.A).T)
    end = last - T * w * (rates @ ca.DM(scheme.b[:, None]))
    end = end - shift if has_shifts else end
    poses = q - ca.horzcat(*(chart.integrate(q0, steps[:, k]) for k in range(d)))
    rows = [ca.vec(inside), ca.vec(poses), end, q1 - chart.integrate(q0, last)]
    arguments = [q0, ca.vec(v), ca.vec(steps), ca.vec(q), last, q1, T, w, shift]
    return Form(ca.vertcat(*arguments), ca.SX(0, 1), ca.vertcat(*rows))


class PhaseForms:
    """Collocation defects of a phase, and forms of other expressions at its points and nodes.

    Forms are built once for all meshes.

    Args:
        phase: Equations of the phase.
        parameters: Indices of the parameters among the unknowns.
    """

    def __init__(self, phase: PhaseEquations, parameters: Numbers) -> None:
        self.phase = phase
        self._p = parameters
        self.begin, self.duration, self.share = (ca.SX.sym(name) for name in ("b", "T", "s"))
        self._time = self.begin + self.duration * self.share
        self._dynamics = self.point_form(phase.residual)

    def blocks(self, unknowns: Unknowns, sizes: Array, rows: Array) -> list[Block]:
        """Return all equations of motion on a mesh.

        Args:
            unknowns: Indices of the unknowns.
            sizes: Characteristic sizes of the unknowns.
            rows: Characteristic sizes of the equations at a point.
        """
        blocks = [self._points(unknowns, rows), *self._intervals(unknowns, sizes)]
        blocks += self._curved(unknowns)
        if self.phase.sizes.m:
            blocks += self._closed(unknowns)
        return blocks

    def point_form(self, rows: Any, cost: Any = None, data: Any = None, more: Any = None) -> Form:
        """Return a form of expressions of `PhaseEquations.symbols` at points.

        Args:
            rows: Expressions of the rows.
            cost: Expression of the cost; None for none.
            data: Symbols of data at a point, besides its share of the duration.
            more: Symbols of unknowns besides those of `point_places`.
        """
        symbols = self.phase.symbols
        unknowns = [*(symbols[key] for key in LETTERS), self.begin, self.duration, symbols["p"]]
        unknowns += [] if more is None else [more]
        all_data = self.share if data is None else ca.vertcat(self.share, data)
        return self._form(ca.vertcat(*unknowns), all_data, rows, cost)

    def point_places(self, unknowns: Unknowns) -> Places:
        """Return the indices of the unknowns of a form at points, shape (.., m)."""
        m = len(unknowns.points["q"])
        shared = [unknowns.begin, unknowns.duration, *self._p]
        point_places = np.hstack([unknowns.points[key] for key in LETTERS])
        return np.vstack((point_places.T, np.repeat(np.array(shared)[:, None], m, axis=1)))

    def node_form(self, rows: Any, cost: Any = None, more: Any = None) -> Form:
        """Return a form of expressions of t, q, v, z, p and `more` at ends of intervals."""
        symbols = self.phase.symbols
        unknowns = [*(symbols[key] for key in "qvz"), self.begin, self.duration, symbols["p"]]
        unknowns += [] if more is None else [more]
        return self._form(ca.vertcat(*unknowns), self.share, rows, cost)

    def node_places(self, unknowns: Unknowns, nodes: Numbers) -> Places:
        """Return the indices of the unknowns of a form at nodes, shape (.., len(nodes))."""
        shared = np.array([unknowns.begin, unknowns.duration, *self._p], dtype=np.intp)
        return np.vstack((unknowns.state[nodes].T, np.repeat(shared[:, None], len(nodes), axis=1)))

    def last_form(self, scheme: Collocation, cost: Any) -> Form:
        """Return a form of a cost at the end, with forces as polynomials of the last interval."""
        symbols, at_end = self.phase.symbols, ca.DM(scheme.values(np.ones(1)).T)
        points = {key: ca.SX.sym(key, symbols[key].numel(), scheme.degree) for key in _AT_POINTS}
        replaced = [symbols[key] for key in points]
        ends = [values @ at_end for values in points.values()]
        (cost,) = ca.substitute([ca.SX(cost)], replaced, ends)
        more = ca.vertcat(*(ca.vec(values) for values in points.values()))
        return self.node_form(ca.SX(0, 1), cost, more)

    def last_places(self, unknowns: Unknowns) -> Places:
        """Return the indices of the unknowns of `last_form`, one column."""
        node_places = self.node_places(unknowns, np.array([unknowns.mesh.intervals]))
        degree = int(unknowns.mesh.degrees[-1])
        points = (unknowns.points[key][-degree:].reshape(-1, 1) for key in _AT_POINTS)
        return np.vstack((node_places, *points))

    def _form(self, unknowns: Any, data: Any, rows: Any, cost: Any = None) -> Form:
        both = [ca.SX(rows), ca.SX(0) if cost is None else ca.SX(cost)]
        g, f = ca.substitute(both, [self.phase.symbols["t"]], [self._time])
        return Form(unknowns, data, g, None if cost is None else f)

    def _points(self, unknowns: Unknowns, rows: Array) -> Block:
        places, shares = self.point_places(unknowns), unknowns.mesh.shares[None, :]
        return Block(MOTION, self._dynamics, places, shares, size=rows)

    def _intervals(self, unknowns: Unknowns, sizes: Array) -> list[Block]:
        blocks = []
        for degree in np.unique(unknowns.mesh.degrees).tolist():
            scheme = unknowns.mesh.scheme_of(degree)
            for shifted in (True, False):
                places = self._flat_places(unknowns, degree, shifted=shifted)
                size = np.repeat(sizes[places[:1]], degree + 1, axis=0)
                form = interval_defects(scheme, has_shifts=shifted and unknowns.sizes.m > 0)
                blocks.append(Block(COLLOCATION, form, places, size=size))
        return blocks

    def _flat_places(self, unknowns: Unknowns, degree: int, *, shifted: bool) -> Places:
        """Return indices for `interval_defects`, a column per coordinate and interval."""
        mesh, (q, v) = unknowns.mesh, self.phase.flat.T
        nodes, points = unknowns.nodes, unknowns.points
        first, last, rate = nodes["z"], points["z"], points["w"]
        if shifted:
            first = np.hstack((nodes["q"][:, q], nodes["v"]))
            last = np.hstack((points["q"][:, q], points["v"]))
            rate = np.hstack((points["v"][:, v], points["a"]))
        chosen = np.flatnonzero(mesh.degrees == degree)
        at = mesh.first_points[chosen][:, None] + np.arange(degree)
        n, width = first.shape[1], unknowns.widths[chosen]
        shared = np.stack((np.full_like(width, unknowns.duration), width), axis=1)
        parts = [
            *(first[chosen][:, None], last[at], rate[at], first[chosen + 1][:, None]),
            np.repeat(shared[:, :, None], n, axis=2),
        ]
        if shifted and unknowns.sizes.m:
            shifts = unknowns.shifts[chosen]
            parts.append(np.hstack((shifts[:, v], shifts[:, unknowns.sizes.nv :]))[:, None])
        places = np.concatenate(parts, axis=1)  # interval, unknown, coordinate
        return places.transpose(1, 0, 2).reshape(places.shape[1], -1)

    def _curved(self, unknowns: Unknowns) -> list[Block]:
        """Return the defects of free bodies, one column per interval."""
        mesh, count = unknowns.mesh, int(unknowns.mesh.degrees.sum())
        blocks = []
        for degree in np.unique(mesh.degrees).tolist():
            chosen = np.flatnonzero(mesh.degrees == degree)
            at = mesh.first_points[chosen][:, None] + np.arange(degree)
            shared = np.stack(
                (np.full(len(chosen), unknowns.duration), unknowns.widths[chosen]), axis=1
            )
            for i, (q, v) in enumerate(unknowns.sizes.bases):
                q_of, v_of = np.arange(q, q + _BASE_Q), np.arange(v, v + _BASE_V)
                steps = unknowns.steps[:, 6 * i : 6 * i + 6]
                poses, nodes = unknowns.points["q"][:, q_of], unknowns.nodes["q"][:, q_of]
                speeds = unknowns.points["v"][:, v_of]
                parts = [
                    nodes[chosen],
                    *(places[at].reshape(len(at), -1) for places in (speeds, steps, poses)),
                ]
                parts += [steps[count + chosen], nodes[chosen + 1], shared]
                if unknowns.sizes.m:
                    parts.append(unknowns.shifts[chosen][:, v_of])
                form = body_defects(mesh.scheme_of(degree), has_shifts=unknowns.sizes.m > 0)
                blocks.append(Block(BODIES, form, np.hstack(parts).T))
        return blocks

    def _closed(self, unknowns: Unknowns) -> list[Block]:
        """Return the rows at ends of intervals, and the shifts that satisfy them."""
        later = np.arange(1, unknowns.mesh.intervals + 1)
        node_places = self.node_places(unknowns, later)
        places = np.vstack((node_places, unknowns.shifts.T, unknowns.pulls.T))
        return [Block(CLOSING, self._closing, places, unknowns.mesh.knots[None, 1:])]

    @cached_property
    def _closing(self) -> Form:
        """Form of g = 0, g' = 0, and shifts along J' of as many multipliers."""
        phase, sizes = self.phase, self.phase.sizes
        shifts = ca.SX.sym("e", 2 * sizes.nv)
        of_positions, of_all = (ca.SX.sym("k", count) for count in (sizes.mg, sizes.mk))
        J_of_positions, J_of_all = phase.jacobians
        along = ca.vertcat(J_of_positions.T @ of_positions, J_of_all.T @ of_all)
        rows = ca.vertcat(phase.positions, phase.velocities, shifts - along)
        return self.node_form(rows, more=ca.vertcat(shifts, of_positions, of_all))
