"""The equations of a phase as a residual of symbols, for collocation.

    r = (M a + h - loads - J' lam, J a + b, z' - rates)

Rates that solve an equation, such as those of fibres beside a tendon, are stated as that equation.
No mass matrix is factorised: accelerations, multipliers and rates are unknowns beside the state.
"""

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols.equations import Equations
from mbd_ros.compiled.symbols.implicit import residual
from mbd_ros.compiled.symbols.rows import Rows
from mbd_ros.compiled.symbols.scalar import column, scalars
from mbd_ros.core.multiplier_laws import Level
from mbd_ros.core.state import Array
from mbd_ros.errors import SolveError
from mbd_ros.optimal_control.redundant_rows import NO_DEPENDENCE, Dependence
from mbd_ros.optimal_control.unknowns import Sizes

LETTERS = "qvzawul"  # what is unknown at a point
_BASE_Q = 7


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
        bases = tuple((int(j.idx_q), int(j.idx_v)) for j in joints if j.nq == _BASE_Q)
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
