"""The equations of a phase at a point as a residual of symbols, for collocation.

    r = (M a + h - loads - J' lam, J a + b, z' - rates)

No mass matrix is factorised: accelerations, multipliers and rates are unknowns beside the state.
Rates that solve an equation, such as those of fibres beside a tendon, are stated as that equation.

Rows that follow from others wherever these hold, such as those of a foot at several points, are
redundant: what they say is said already, and no equation tells their multipliers from those of the
others. They are zero then: the sums over rows on which a motion depends are the same for all
choices.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols.constrained_motion import Rows
from mbd_ros.compiled.symbols.equations import Equations
from mbd_ros.compiled.symbols.implicit import residual
from mbd_ros.compiled.symbols.scalar import column, scalars
from mbd_ros.core.rows.constraint import Level
from mbd_ros.core.state import Array, State
from mbd_ros.errors import SolveError
from mbd_ros.optimal_control.phase_motion import PhaseMotion, Sizes, Unknowns

LETTERS = "qvzawul"  # what is unknown at a point
_POSE = 7  # coordinates of a free body
_DEPENDENT = 1.0e-6  # of the size of a row: what others leave of it
_CLOSED, _MOST = 1.0e-10, 50  # rad or m, Newton steps
_ASIDE, _TRIES = 0.2, 3  # rad or m from where the scene starts: rows may depend just there
_WIDEST, _INTERNAL = 0.1, 0.1  # least range of positions [rad or m], and of internal states
_STROKES = 4.0  # accelerations of a motion from rest to rest: 4 range / duration^2, bang-bang
_LOOKED_AT = 20  # points
_NOTHING: Array = np.zeros(0)


class PhaseEquations:
    """Expressions of a system in one mode.

    Args:
        dependence: Of its rows; None where each tells something.

    Attributes:
        symbols: Letter -> column: t, p and `LETTERS`.
        sizes: Of the system.
    """

    def __init__(self, equations: Equations, dependence: Dependence | None = None) -> None:
        self.equations, e = equations, equations
        self.dependence = Dependence() if dependence is None else dependence
        self.symbols = {key: e.symbols[key] for key in "tpqvzual"}
        self.symbols["w"] = ca.SX.sym("w", e.nz)
        joints = e.system.chart.model.joints
        bases = tuple((int(j.idx_q), int(j.idx_v)) for j in joints if j.nq == _POSE)
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
        """The g of rows that state positions, a column of size mg."""
        return ca.vertcat(ca.SX(0, 1), *self._closing.g)

    @cached_property
    def velocities(self) -> Any:
        """The g' of rows but for dependent ones, or what rows of velocities state, of size mk."""
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


def independent(equations: PhaseEquations, x: State, p: Array) -> PhaseEquations:
    """The equations without rows that depend on others.

    Args:
        x: A state of what is integrated, near which the rows can hold.
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


class Dependence(NamedTuple):
    """Rows that depend on others.

    Attributes:
        rows: Their numbers among those that act.
        null: Multipliers that push nothing, one line each of them, shape (.., m).
        q: A configuration in which the rows hold.
    """

    rows: tuple[int, ...] = ()
    null: Array = _NOTHING.reshape(0, 0)
    q: Array = _NOTHING


def usual_sizes(equations: PhaseEquations, motion: PhaseMotion, p: Array, room: Array) -> Usual:
    """Usual sizes of a motion.

    Args:
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
