"""The equations of a phase as residuals at collocation points: defects, redundant rows, sizes.

Over an interval of width h, with points k and neighbours 0 and 1:

    x_j = x_0 + h sum_k A_jk x'_k,   x_1 = x_0 + h sum_k b_k x'_k + shift

Rows of positions and velocities are closed again at every end: the shifts are J' times multipliers
that vanish with the error of the method. Configurations of free bodies are x_0 (+) d with a step d
in the tangent, whose rate is that of `core.dynamics.chart`.
"""

from collections.abc import Mapping
from functools import cache, cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols.charts import CurvedChart
from mbd_ros.compiled.symbols.equations import Equations
from mbd_ros.compiled.symbols.implicit import residual
from mbd_ros.compiled.symbols.rows import Rows
from mbd_ros.compiled.symbols.scalar import column, scalars
from mbd_ros.core.rows.constraint import Level
from mbd_ros.core.state import Array, State
from mbd_ros.errors import SolveError
from mbd_ros.optimal_control.collocation import Collocation
from mbd_ros.optimal_control.mesh import Numbers
from mbd_ros.optimal_control.sparse_program import Block, Form, Places
from mbd_ros.optimal_control.unknowns import BODY, PhaseMotion, Sizes, Unknowns

# ---- redundant rows ---------------------------------------------------------------------------
# Rows that follow from others wherever these hold, such as those of a foot at several points.
#
# What they say is said already, and no equation tells their multipliers from those of the others.
# They are zero then: the sums over rows on which a motion depends are the same for all choices.


class Dependence(NamedTuple):
    """Rows that depend on others.

    Attributes:
        rows: Their numbers among those that act.
        null: Multipliers that push nothing, one line each of them, shape (.., m).
        q: A configuration in which the rows hold.
    """

    rows: tuple[int, ...]
    null: Array
    q: Array


NO_DEPENDENCE = Dependence((), np.zeros((0, 0)), np.zeros(0))


# ---- phase equations --------------------------------------------------------------------------
# The equations of a phase as a residual of symbols, for collocation.
#
#     r = (M a + h - loads - J' lam, J a + b, z' - rates)
#
# Rates that solve an equation, such as those of fibres beside a tendon, are stated as that
# equation.
# No mass matrix is factorised: accelerations, multipliers and rates are unknowns beside the state.


LETTERS = "qvzawul"  # what is unknown at a point
_PHASE_EQUATIONS_BASE_Q = 7


class PhaseEquations:
    """Expressions of a system in one mode.

    Args:
        equations: Of the system.
        dependence: Of its rows; multipliers of dependent ones are zero.

    Attributes:
        equations: As given, as `dependence`.
        symbols: Letter -> column: t, p and `LETTERS`.
        sizes: Of the system.
    """

    def __init__(self, equations: Equations, dependence: Dependence = NO_DEPENDENCE) -> None:
        self.equations, self.dependence, e = equations, dependence, equations
        self.symbols = {key: e.symbols[key] for key in "tpqvzual"}
        self.symbols["w"] = ca.SX.sym("w", e.nz)
        joints = e.system.chart.model.joints
        bases = tuple(
            (int(j.idx_q), int(j.idx_v)) for j in joints if j.nq == _PHASE_EQUATIONS_BASE_Q
        )
        counts = (len(one.g) for one in (e.acting, self._closing, self._kept))
        self.sizes = Sizes(e.nq, e.nv, e.nz, e.nu, *counts, bases)

    @cached_property
    def residual(self) -> Any:
        """The r, a column of size nv + m + nz."""
        return ca.vertcat(self._motion, self._balance)

    @cached_property
    def _balance(self) -> Any:
        """What is zero where w are the rates of internal states, a column."""
        return self.equations.balance(self.symbols["w"])

    @cached_property
    def _motion(self) -> Any:
        """The r but for internal states."""
        e = self.equations
        a, lam = (scalars(self.symbols[key]) for key in "al")
        found = residual(e, a, lam, e.dynamics[-1 if e.mh else 0])
        for i in self.dependence.rows:
            found[e.nv + i] = lam[i]
        return found

    @cached_property
    def positions(self) -> Any:
        """G of rows that state positions, a column of size mg."""
        return ca.vertcat(ca.SX(0, 1), *self._closing.g)

    @cached_property
    def velocities(self) -> Any:
        """G' of rows but for dependent ones, or what rows of velocities state, of size mk."""
        return ca.vertcat(ca.SX(0, 1), *self._kept.velocities(scalars(self.symbols["v"])))

    @cached_property
    def jacobians(self) -> tuple[Any, Any]:
        """J of rows of positions and of all that are kept, shapes (mg, nv) and (mk, nv)."""
        return self._dense(self._closing), self._dense(self._kept)

    @cached_property
    def _kept(self) -> Rows:
        """Rows that depend on no others."""
        every = range(len(self.equations.acting.g))
        return self.equations.acting.only([i for i in every if i not in self.dependence.rows])

    @cached_property
    def has_pieces(self) -> bool:
        """Whether couplings are made of pieces, so that slopes of the equations may jump."""
        e = self.equations
        both = ca.vertcat(*(column(one) for one in (e.coordinates.q, e.coordinates.v)))
        coupled = ca.Function("coupled", [self.symbols["q"], self.symbols["v"]], [both])
        operations = map(coupled.instruction_id, range(coupled.n_instructions()))
        return ca.OP_IF_ELSE_ZERO in operations

    @property
    def _closing(self) -> Rows:
        """Rows of positions but for those along which nothing is said, such as tangents."""
        rows = self._kept.of(Level.POSITION)
        return rows.only([i for i, g in enumerate(rows.g) if not ca.SX(g).is_constant()])

    def _dense(self, rows: Rows) -> Any:
        found = ca.SX(len(rows.J), self.equations.nv)
        for i, row in enumerate(rows.J):
            for j, value in row.items():
                found[i, j] = value
        return found

    @cached_property
    def flat(self) -> np.ndarray:
        """Pairs of places in q and v of coordinates that add up, shape (.., 2)."""
        joints = self.equations.system.chart.model.joints
        found = [(j.idx_q, j.idx_v) for j in joints if j.nq == 1 and j.idx_q >= 0]
        return np.array(found, dtype=np.intp).reshape(-1, 2)

    @property
    def _arguments(self) -> list[Any]:
        return [self.symbols[key] for key in ("t", *LETTERS, "p")]

    @cached_property
    def _slopes(self) -> Any:
        """(t, q, v, z, a, w, u, l, p) -> r, linear in w, and its slopes by (a, l, w), dense."""
        by = ca.vertcat(*(self.symbols[key] for key in "alw"))
        r = ca.vertcat(self._motion, self.symbols["w"] - self.equations.rates)
        results = [ca.densify(r), ca.densify(ca.jacobian(r, by))]
        return ca.Function("slopes", self._arguments, ca.cse(results))

    def answers(self, values: Mapping[str, Array], times: Array, p: Array) -> tuple[Array, Array]:
        """The r and its slopes by (a, l, w), shapes (n, rows) and (n, rows, rows).

        Args:
            values: Letter -> values, shape (n, ..); of what is not there, zeros.
            times: [s], shape (n,).
            p: Parameters.
        """
        n, absent = len(times), set(LETTERS).difference(values)
        zeros = {key: np.zeros((n, int(self.symbols[key].numel()))) for key in absent}
        r, K = self._slopes.map(n)(*_columns({**values, **zeros}, times, p))
        r, K = _full(r).T, _full(K).T
        return r, K.reshape(n, r.shape[1], r.shape[1]).transpose(0, 2, 1)

    @cached_property
    def _pushes(self) -> Any:
        """(t, q, v, z, a, w, u, l, p) -> r, and its slopes by (u, l), dense."""
        by, r = ca.vertcat(self.symbols["u"], self.symbols["l"]), self.residual
        results = [ca.densify(r), ca.densify(ca.jacobian(r, by))]
        return ca.Function("pushes", self._arguments, ca.cse(results))

    def pushed(
        self, values: Mapping[str, Array], times: Array, p: Array, given: Array
    ) -> dict[str, Array]:
        """Inputs and multipliers that a motion takes, the least where many do: letters u, l.

        Args:
            values: Letters q, v, z, a, w, u, l -> values, shape (n, ..); u where it is given.
            times: [s], shape (n,).
            p: Parameters.
            given: Places of inputs that are given.
        """
        n, sizes = len(times), self.sizes
        r, K = self._pushes.map(n)(*_columns(values, times, p))
        K = _full(K).T.reshape(n, sizes.nu + sizes.m, -1).transpose(0, 2, 1)[:, : sizes.nv]
        K[:, :, given] = 0.0
        step = -np.linalg.pinv(K) @ _full(r).T[:, : sizes.nv, None]
        u, lam = np.split(step[:, :, 0], [sizes.nu], axis=1)
        return {"u": values["u"] + u, "l": values["l"] + lam}

    @cached_property
    def _rows(self) -> Any:
        """(t, q, v, p) -> g and J of rows of positions, g' and J of all rows."""
        symbols, (J, of_all) = [self.symbols[key] for key in "tqvp"], self.jacobians
        found = [ca.densify(ca.SX(one)) for one in (self.positions, J, self.velocities, of_all)]
        return ca.Function("rows", symbols, found)

    def rows_at(self, t: float, q: Array, v: Array, p: Array) -> tuple[Array, ...]:
        """G and J of rows of positions, then g' and J of all rows, at a state."""
        g, J, rate, of_all = map(_full, self._rows(t, q, v, p))
        return g.ravel(), J, rate.ravel(), of_all

    def solved(self, values: Mapping[str, Array], times: Array, p: Array) -> dict[str, Array]:
        """Accelerations, multipliers and rates at states with inputs: letters a, l, w.

        Raises:
            SolveError: Rows depend on each other.
        """
        r, K = self.answers({key: values[key] for key in "qvzu"}, times, p)
        try:
            x = np.linalg.solve(K, -r[:, :, None])[:, :, 0] if r.size else r
        except np.linalg.LinAlgError as error:
            rows = ", ".join(row.name for row in self.equations.system.multiplier_rows)
            text = f"rows that hold depend on each other at a state of the motion, among {rows}"
            raise SolveError(f"{text}; accepted: a guess that keeps clear of it") from error
        nv, m = self.sizes.nv, self.sizes.m
        return {"a": x[:, :nv], "l": x[:, nv : nv + m], "w": x[:, nv + m :]}

    @cached_property
    def _balances(self) -> Any:
        """(t, q, v, z, a, w, u, l, p) -> balance g of internal states, own slopes by w and z."""
        g, w, z = self._balance, self.symbols["w"], self.symbols["z"]
        both = [(g[i], by[i]) for by in (w, z) for i in range(self.sizes.nz)]
        slopes = [ca.densify(ca.jacobian(*one)) for one in both]
        return ca.Function(
            "balances", self._arguments, ca.cse([ca.vertcat(ca.densify(g), *slopes)])
        )

    def calmed(
        self, values: Mapping[str, Array], w: Array, times: Array, spans: Array, p: Array
    ) -> Array:
        """Rates of internal states that a step of Newton's method finds over some times.

        Where rates take a state back faster than that, as tendons do with fibres, rates at a state
        that is off say nothing of how far it is off.

        Args:
            values: As for `answers`, w too.
            w: Rates at these states, shape (n, nz).
            times: [s], shape (n,).
            spans: Over which rates act [s], shape (n,).
            p: Parameters.
        """
        if not (stiff := self._stiff).any():
            return w
        columns = _columns(values, times, p)
        g, by_w, by_z = np.split(_full(self._balances.map(len(times))(*columns)).T, 3, axis=1)
        slope = by_w + spans[:, None] * np.maximum(by_z, 0.0)
        found = w.copy()
        found[:, stiff] = (values["w"] - g / slope)[:, stiff]
        return found

    @cached_property
    def _stiff(self) -> np.ndarray:
        """Which internal states have rates that solve an equation, shape (nz,)."""
        by = ca.jacobian(self._balance, self.symbols["w"])
        return np.array([not by[i, i].is_constant() for i in range(self.sizes.nz)], dtype=np.bool_)


def _columns(values: Mapping[str, Array], times: Array, p: Array) -> list[Array]:
    """What a function of (t, q, v, z, a, w, u, l, p) takes, a column a time."""
    parameters = np.repeat(np.asarray(p)[:, None], len(times), axis=1)
    return [times[None, :], *(values[key].T for key in LETTERS), parameters]


def _full(values: Any) -> Array:
    return np.array(values.full(), dtype=np.float64)


# ---- defects ----------------------------------------------------------------------------------
# The equations of a phase at points, over intervals and at their ends, as forms of a program.


COLLOCATION, BODIES, CLOSING, MOTION = "collocation", "bodies", "closing", "motion"  # blocks
_BASE_Q, _BASE_V = 7, 6
_AT_POINTS = "awul"  # what is unknown at points alone


class PhaseForms:
    """Forms of a phase, made once for all meshes.

    Args:
        phase: Its equations.
        parameters: Numbers of the parameters among the unknowns.
    """

    def __init__(self, phase: PhaseEquations, parameters: Numbers) -> None:
        self.phase, self._p = phase, parameters
        self.begin, self.duration, self.share = (ca.SX.sym(name) for name in ("b", "T", "s"))
        self._time = self.begin + self.duration * self.share
        self._dynamics = self.point_form(phase.residual)

    def blocks(self, unknowns: Unknowns, sizes: Array, rows: Array) -> list[Block]:
        """All equations of motion on a mesh.

        Args:
            unknowns: Where the unknowns stand.
            sizes: Their usual sizes.
            rows: Usual sizes of the equations at a point.
        """
        found = [self._points(unknowns, rows), *self._intervals(unknowns, sizes)]
        found += self._curved(unknowns)
        if self.phase.sizes.m:
            found += self._closed(unknowns)
        return found

    def point_form(self, rows: Any, cost: Any = None, data: Any = None, more: Any = None) -> Form:
        """A form of expressions of `PhaseEquations.symbols` at points.

        Args:
            rows: Its rows.
            cost: Its cost; None for nothing.
            data: Symbols of what is known at a point, besides its share of the duration.
            more: Symbols of unknowns besides those of `point_places`.
        """
        symbols = self.phase.symbols
        given = [*(symbols[key] for key in LETTERS), self.begin, self.duration, symbols["p"]]
        given += [] if more is None else [more]
        known = self.share if data is None else ca.vertcat(self.share, data)
        return self._form(ca.vertcat(*given), known, rows, cost)

    def point_places(self, unknowns: Unknowns) -> Places:
        """Unknowns of a form at points, shape (.., m)."""
        m = len(unknowns.points["q"])
        shared = [unknowns.begin, unknowns.duration, *self._p]
        own = np.hstack([unknowns.points[key] for key in LETTERS])
        return np.vstack((own.T, np.repeat(np.array(shared)[:, None], m, axis=1)))

    def node_form(self, rows: Any, cost: Any = None, more: Any = None) -> Form:
        """A form of expressions of t, q, v, z, p and more, at ends of intervals; data: share."""
        symbols = self.phase.symbols
        given = [*(symbols[key] for key in "qvz"), self.begin, self.duration, symbols["p"]]
        given += [] if more is None else [more]
        return self._form(ca.vertcat(*given), self.share, rows, cost)

    def node_places(self, unknowns: Unknowns, nodes: Numbers) -> Places:
        """Unknowns of a form at some ends of intervals, shape (.., len(nodes))."""
        shared = np.array([unknowns.begin, unknowns.duration, *self._p], dtype=np.intp)
        return np.vstack((unknowns.state[nodes].T, np.repeat(shared[:, None], len(nodes), axis=1)))

    def last_form(self, scheme: Collocation, cost: Any) -> Form:
        """A cost of all letters at the end, with forces as polynomials of the last interval."""
        symbols, at_end = self.phase.symbols, ca.DM(scheme.values(np.ones(1)).T)
        points = {key: ca.SX.sym(key, symbols[key].numel(), scheme.degree) for key in _AT_POINTS}
        own, ends = [symbols[key] for key in points], [one @ at_end for one in points.values()]
        (cost,) = ca.substitute([ca.SX(cost)], own, ends)
        more = ca.vertcat(*(ca.vec(one) for one in points.values()))
        return self.node_form(ca.SX(0, 1), cost, more)

    def last_places(self, unknowns: Unknowns) -> Places:
        """Unknowns of `last_form`, one column."""
        own = self.node_places(unknowns, np.array([unknowns.mesh.intervals]))
        degree = int(unknowns.mesh.degrees[-1])
        points = (unknowns.points[key][-degree:].reshape(-1, 1) for key in _AT_POINTS)
        return np.vstack((own, *points))

    def _form(self, unknowns: Any, data: Any, rows: Any, cost: Any = None) -> Form:
        both = [ca.SX(rows), ca.SX(0) if cost is None else ca.SX(cost)]
        g, f = ca.substitute(both, [self.phase.symbols["t"]], [self._time])
        return Form(unknowns, data, g, None if cost is None else f)

    def _points(self, unknowns: Unknowns, rows: Array) -> Block:
        places, shares = self.point_places(unknowns), unknowns.mesh.shares[None, :]
        return Block(MOTION, self._dynamics, places, shares, size=rows)

    def _intervals(self, unknowns: Unknowns, sizes: Array) -> list[Block]:
        found = []
        for degree in np.unique(unknowns.mesh.degrees).tolist():
            scheme = unknowns.mesh.scheme_of(degree)
            for shifted in (True, False):
                places = self._flat_places(unknowns, degree, shifted=shifted)
                size = np.repeat(sizes[places[:1]], degree + 1, axis=0)
                form = interval_form(scheme, has_shifts=shifted and unknowns.sizes.m > 0)
                found.append(Block(COLLOCATION, form, places, size=size))
        return found

    def _flat_places(self, unknowns: Unknowns, degree: int, *, shifted: bool) -> Places:
        """Of `interval_form`, one column a coordinate and interval: q and v, or z."""
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
            own = unknowns.shifts[chosen]
            parts.append(np.hstack((own[:, v], own[:, unknowns.sizes.nv :]))[:, None])
        whole = np.concatenate(parts, axis=1)  # interval, unknown, coordinate
        return whole.transpose(1, 0, 2).reshape(whole.shape[1], -1)

    def _curved(self, unknowns: Unknowns) -> list[Block]:
        """Free bodies on intervals: one column an interval."""
        mesh, count = unknowns.mesh, int(unknowns.mesh.degrees.sum())
        found = []
        for degree in np.unique(mesh.degrees).tolist():
            chosen = np.flatnonzero(mesh.degrees == degree)
            at = mesh.first_points[chosen][:, None] + np.arange(degree)
            shared = np.stack(
                (np.full(len(chosen), unknowns.duration), unknowns.widths[chosen]), axis=1
            )
            for i, (q, v) in enumerate(unknowns.sizes.bases):
                q_of, v_of = np.arange(q, q + _BASE_Q), np.arange(v, v + _BASE_V)
                own = unknowns.steps[:, 6 * i : 6 * i + 6]
                poses, nodes = unknowns.points["q"][:, q_of], unknowns.nodes["q"][:, q_of]
                speeds = unknowns.points["v"][:, v_of]
                parts = [nodes[chosen], *(_flattened(one[at]) for one in (speeds, own, poses))]
                parts += [own[count + chosen], nodes[chosen + 1], shared]
                if unknowns.sizes.m:
                    parts.append(unknowns.shifts[chosen][:, v_of])
                form = body_form(mesh.scheme_of(degree), has_shifts=unknowns.sizes.m > 0)
                found.append(Block(BODIES, form, np.hstack(parts).T))
        return found

    def _closed(self, unknowns: Unknowns) -> list[Block]:
        """Rows at ends of intervals, and the shifts that close them."""
        later = np.arange(1, unknowns.mesh.intervals + 1)
        own = self.node_places(unknowns, later)
        places = np.vstack((own, unknowns.shifts.T, unknowns.pulls.T))
        return [Block(CLOSING, self._closing, places, unknowns.mesh.knots[None, 1:])]

    @cached_property
    def _closing(self) -> Form:
        """G = 0, g' = 0, and shifts along J' of as many multipliers."""
        phase, sizes = self.phase, self.phase.sizes
        shifts = ca.SX.sym("e", 2 * sizes.nv)
        of_positions, of_all = (ca.SX.sym("k", count) for count in (sizes.mg, sizes.mk))
        J_of_positions, J_of_all = phase.jacobians
        along = ca.vertcat(J_of_positions.T @ of_positions, J_of_all.T @ of_all)
        rows = ca.vertcat(phase.positions, phase.velocities, shifts - along)
        return self.node_form(rows, more=ca.vertcat(shifts, of_positions, of_all))


def _flattened(places: Places) -> Places:
    return places.reshape(len(places), -1)


@cache
def interval_form(scheme: Collocation, *, has_shifts: bool) -> Form:
    """One coordinate over one interval: x_0, x_k, x'_k, x_1, duration, share, and the shift."""
    d = scheme.degree
    x0, x1, T, w, shift = (ca.SX.sym(name) for name in ("x0", "x1", "T", "w", "e"))
    x, rates = ca.SX.sym("x", d), ca.SX.sym("r", d)
    h = T * w
    inside = x - x0 - h * (ca.DM(scheme.A) @ rates)
    end = x1 - x0 - h * (ca.DM(scheme.b[None, :]) @ rates)
    given = [x0, x, rates, x1, T, w]
    if has_shifts:
        end, given = end - shift, [*given, shift]
    return Form(ca.vertcat(*given), ca.SX(0, 1), ca.vertcat(inside, end))


@cache
def body_form(scheme: Collocation, *, has_shifts: bool) -> Form:
    """One free body over one interval: q_0, v_k, d_k, q_k, d_1, q_1, duration, share, shift."""
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
    given = [q0, ca.vec(v), ca.vec(steps), ca.vec(q), last, q1, T, w, shift]
    return Form(ca.vertcat(*given), ca.SX(0, 1), ca.vertcat(*rows))


# ---- traced redundancy ------------------------------------------------------------------------
# Which rows of a phase follow from others, see `optimal_control.defects`.


_DEPENDENT = 1.0e-6  # of the size of a row: what others leave of it
_CLOSED, _MOST = 1.0e-10, 50  # rad or m, Newton steps
_ASIDE, _TRIES = 0.2, 3  # rad or m from where the scene starts: rows may depend just there


def independent(equations: PhaseEquations, x: State, p: Array) -> PhaseEquations:
    """The equations without rows that depend on others.

    Args:
        equations: Of a phase.
        x: A state of what is integrated, near which the rows can hold.
        p: Parameters.
    """
    m, nv = equations.sizes.m, equations.sizes.nv
    if m < 2:
        return equations
    random, chart = np.random.default_rng(0), equations.equations.system.chart
    steps = [np.zeros(nv), *(_ASIDE * random.standard_normal((_TRIES, nv)))]
    best = Dependence((), np.zeros((0, m)), x.q)
    for number, step in enumerate(steps):
        q = _closed(equations, x.t, chart.integrate(x.q, step), p)
        found = best if q is None else _dependence(equations, x.t, q, p)
        if q is not None and (number == 0 or len(found.rows) < len(best.rows)):
            best = found
        if not best.rows:
            break
    return PhaseEquations(equations.equations, best)


def _closed(equations: PhaseEquations, t: float, q: Array, p: Array) -> Array | None:
    """The configuration near q in which the rows hold; None where none is found."""
    chart, still = equations.equations.system.chart, np.zeros(equations.sizes.nv)
    for _ in range(_MOST):
        g, J, _, _ = equations.rows_at(t, q, still, p)
        if np.abs(g).max(initial=0.0) < _CLOSED:
            return q
        q = chart.integrate(q, np.linalg.lstsq(J, -g, rcond=None)[0])
    return None


def _dependence(equations: PhaseEquations, t: float, q: Array, p: Array) -> Dependence:
    """Which rows are sums of rows before them."""
    J = equations.rows_at(t, q, np.zeros(equations.sizes.nv), p)[3]
    kept, rows, null = list[int](), list[int](), list[Array]()
    for i, row in enumerate(J):
        shares = np.linalg.lstsq(J[kept].T, row, rcond=None)[0] if kept else np.zeros(0)
        left = row - shares @ J[kept]
        if np.linalg.norm(left) > _DEPENDENT * np.linalg.norm(row):
            kept.append(i)
            continue
        rows.append(i)
        null.append(np.eye(len(J))[i])
        null[-1][kept] -= shares
    return Dependence(tuple(rows), np.array(null).reshape(-1, len(J)), q)


# ---- scaling ----------------------------------------------------------------------------------
# Usual sizes of unknowns and of equations of motion, from a guess.


_WIDEST, _INTERNAL = 0.1, 0.1  # least range of positions [rad or m], and of internal states
_STROKES = 4.0  # accelerations of a motion from rest to rest: 4 range / duration^2, bang-bang
_LOOKED_AT = 20  # points


class Usual(NamedTuple):
    """Usual sizes of a phase.

    Attributes:
        of: Letter -> of each unknown of that kind.
        rows: Of the equations of motion.
        duration: [s].
    """

    of: dict[str, Array]
    rows: Array
    duration: float

    def write(self, sizes: Array, unknowns: Unknowns) -> None:
        """Write them where the unknowns of the phase stand."""
        for letter, values in self.of.items():
            sizes[unknowns.points[letter]] = values
            if letter in unknowns.nodes:
                sizes[unknowns.nodes[letter]] = values
        sizes[unknowns.duration] = sizes[unknowns.begin] = self.duration


def usual_sizes(equations: PhaseEquations, motion: PhaseMotion, p: Array, room: Array) -> Usual:
    """Usual sizes of a motion.

    Args:
        equations: Of the phase.
        motion: A guess.
        p: Parameters.
        room: Widths between the bounds of inputs, inf without, shape (nu,).
    """
    T = max(abs(motion.duration), 1.0e-6)
    largest = {key: np.abs(motion.points[key]).max(axis=0, initial=0.0) for key in LETTERS}
    ranges = np.ptp(motion.nodes["q"], axis=0)
    range_of_all = max(float(ranges.max(initial=0.0)), _WIDEST)
    rate, bend = range_of_all / T, _STROKES * range_of_all / T**2
    of = {
        "q": np.maximum(largest["q"], range_of_all),
        "v": np.maximum(largest["v"], rate),
        "a": np.maximum(largest["a"], bend),
        "z": np.maximum(largest["z"], _INTERNAL),
        "w": np.maximum(largest["w"], _INTERNAL / T),
    }
    forces = _forces(equations, motion, p, of["a"])
    most = float(forces.max(initial=0.0)) or 1.0
    of["u"] = np.maximum(largest["u"], np.where(room > 0.0, np.minimum(room, most), most))
    of["l"] = np.maximum(largest["l"], most)
    accelerations = np.full(equations.sizes.m, float(of["a"].max(initial=bend)))
    return Usual(of, np.concatenate((forces, accelerations, of["w"])), T)


def _forces(equations: PhaseEquations, motion: PhaseMotion, p: Array, a: Array) -> Array:
    """Generalized forces that a motion takes without any input, shape (nv,)."""
    count, nv = len(motion.points["q"]), equations.sizes.nv
    some = np.unique(np.linspace(0, count - 1, min(count, _LOOKED_AT)).astype(int))
    values = {key: motion.points[key][some] for key in "qvz"}
    times = motion.begin + motion.duration * motion.mesh.shares[some]
    r, K = equations.answers(values, times, p)
    found = np.abs(r[:, :nv]).max(axis=0) + (np.abs(K[:, :nv, :nv]) @ a).max(axis=0)
    floor = 1.0e-3 * float(found.max(initial=0.0)) or 1.0
    return np.maximum(found, floor)
