"""The equations of a phase at a point as a symbolic residual, for collocation.

    r = (M a + h - loads - J' lam, J a + b, z' - rates)

No mass matrix is factorized: accelerations, multipliers and rates are unknowns beside the state.
Rates that solve an equation, such as those of fibres beside a tendon, enter as that equation.

Redundant rows follow from other rows wherever these hold, such as those of a foot at several
points. No equation determines their multipliers separately from those of the others, so that these
multipliers are set to zero. The sums over rows on which a motion depends are the same for all
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

LETTERS = "qvzawul"  # unknowns at a point
_POSE = 7  # coordinates of a free body
_DEPENDENT = 1.0e-6  # of the size of a row: a smaller remainder makes it redundant
_CLOSED, _MOST = 1.0e-10, 50  # rad or m, Newton steps
_ASIDE, _TRIES = 0.2, 3  # rad or m from the initial state, where rows may be redundant by chance
_WIDEST, _INTERNAL = 0.1, 0.1  # least range of positions [rad or m], and of internal states
_STROKES = 4.0  # accelerations of a motion from rest to rest: 4 range / duration^2, bang-bang
_SAMPLES = 20  # points of a motion from which sizes of forces are computed
_NOTHING: Array = np.zeros(0)


class PhaseEquations:
    """Symbolic equations of a system in one mode.

    Args:
        equations: Equations of the system.
        dependence: Redundant rows; None for none.

    Attributes:
        symbols: Letter -> column of symbols: t, p and `LETTERS`.
        sizes: Sizes of the system.
    """

    def __init__(self, equations: Equations, dependence: Dependence | None = None) -> None:
        self.equations = e = equations
        self.dependence = Dependence() if dependence is None else dependence
        self.symbols = {key: e.symbols[key] for key in "tpqvzual"}
        self.symbols["w"] = ca.SX.sym("w", e.nz)
        joints = e.system.chart.model.joints
        bases = tuple((int(j.idx_q), int(j.idx_v)) for j in joints if j.nq == _POSE)
        counts = (len(rows.g) for rows in (e.active_rows, self._closing, self._independent_rows))
        self.sizes = Sizes(e.nq, e.nv, e.nz, e.nu, *counts, bases)

    @cached_property
    def residual(self) -> Any:
        """Residual r, a column of size nv + m + nz."""
        return ca.vertcat(self._motion, self._balance)

    @cached_property
    def _balance(self) -> Any:
        """Residual of the rates w of internal states, a column."""
        return self.equations.balance(self.symbols["w"])

    @cached_property
    def _motion(self) -> Any:
        """Residual r without internal states."""
        e = self.equations
        a, lam = (scalars(self.symbols[key]) for key in "al")
        rows = residual(e, a, lam, e.dynamics[-1 if e.mh else 0])
        for i in self.dependence.rows:
            rows[e.nv + i] = lam[i]
        return rows

    @cached_property
    def positions(self) -> Any:
        """Constraint functions g of position rows, a column of size mg."""
        return ca.vertcat(ca.SX(0, 1), *self._closing.g)

    @cached_property
    def velocities(self) -> Any:
        """Rates g' of all rows that are not redundant, a column of size mk."""
        return ca.vertcat(
            ca.SX(0, 1), *self._independent_rows.velocities(scalars(self.symbols["v"]))
        )

    @cached_property
    def jacobians(self) -> tuple[Any, Any]:
        """Jacobians of position rows, (mg, nv), and of all independent rows, (mk, nv)."""
        return self._dense(self._closing), self._dense(self._independent_rows)

    @cached_property
    def _independent_rows(self) -> Rows:
        """Rows that are not redundant."""
        rows = range(len(self.equations.active_rows.g))
        return self.equations.active_rows.only([i for i in rows if i not in self.dependence.rows])

    @cached_property
    def has_pieces(self) -> bool:
        """Whether couplings are piecewise, so that derivatives of the equations may jump."""
        e = self.equations
        both = ca.vertcat(*(column(values) for values in (e.coordinates.q, e.coordinates.v)))
        coupled = ca.Function("coupled", [self.symbols["q"], self.symbols["v"]], [both])
        operations = map(coupled.instruction_id, range(coupled.n_instructions()))
        return ca.OP_IF_ELSE_ZERO in operations

    @property
    def _closing(self) -> Rows:
        """Position rows without those of a constant g, such as tangents."""
        rows = self._independent_rows.of(Level.POSITION)
        return rows.only([i for i, g in enumerate(rows.g) if not ca.SX(g).is_constant()])

    def _dense(self, rows: Rows) -> Any:
        dense = ca.SX(len(rows.J), self.equations.nv)
        for i, row in enumerate(rows.J):
            for j, value in row.items():
                dense[i, j] = value
        return dense

    @cached_property
    def flat(self) -> np.ndarray:
        """Pairs of indices in q and v of coordinates in a vector space, shape (.., 2)."""
        joints = self.equations.system.chart.model.joints
        pairs = [(j.idx_q, j.idx_v) for j in joints if j.nq == 1 and j.idx_q >= 0]
        return np.array(pairs, dtype=np.intp).reshape(-1, 2)

    @property
    def _arguments(self) -> list[Any]:
        return [self.symbols[key] for key in ("t", *LETTERS, "p")]

    @cached_property
    def _slopes(self) -> Any:
        """(t, q, v, z, a, w, u, l, p) -> r, linear in w, and its derivatives by (a, l, w)."""
        by = ca.vertcat(*(self.symbols[key] for key in "alw"))
        r = ca.vertcat(self._motion, self.symbols["w"] - self.equations.rates)
        results = [ca.densify(r), ca.densify(ca.jacobian(r, by))]
        return ca.Function("slopes", self._arguments, ca.cse(results))

    def linearize(
        self, values: Mapping[str, Array], times: Array, p: Array
    ) -> tuple[Array, Array]:
        """Return r and its derivatives by (a, l, w), shapes (n, rows) and (n, rows, rows).

        Args:
            values: Letter -> values, shape (n, ..); zeros for missing letters.
            times: Times [s], shape (n,).
        """
        n, absent = len(times), set(LETTERS).difference(values)
        zeros = {key: np.zeros((n, int(self.symbols[key].numel()))) for key in absent}
        r, K = self._slopes.map(n)(*_columns({**values, **zeros}, times, p))
        r, K = _full(r).T, _full(K).T
        return r, K.reshape(n, r.shape[1], r.shape[1]).transpose(0, 2, 1)

    @cached_property
    def _input_slopes(self) -> Any:
        """(t, q, v, z, a, w, u, l, p) -> r, and its derivatives by (u, l), dense."""
        by, r = ca.vertcat(self.symbols["u"], self.symbols["l"]), self.residual
        results = [ca.densify(r), ca.densify(ca.jacobian(r, by))]
        return ca.Function("pushes", self._arguments, ca.cse(results))

    def minimum_norm_inputs(
        self, values: Mapping[str, Array], times: Array, p: Array, prescribed: Array
    ) -> dict[str, Array]:
        """Return the minimum-norm inputs and multipliers of a motion: letters u, l.

        Args:
            values: Letters q, v, z, a, w, u, l -> values, shape (n, ..); u where prescribed.
            times: Times [s], shape (n,).
            prescribed: Indices of prescribed inputs.
        """
        n, sizes = len(times), self.sizes
        r, K = self._input_slopes.map(n)(*_columns(values, times, p))
        K = _full(K).T.reshape(n, sizes.nu + sizes.m, -1).transpose(0, 2, 1)[:, : sizes.nv]
        K[:, :, prescribed] = 0.0
        step = -np.linalg.pinv(K) @ _full(r).T[:, : sizes.nv, None]
        u, lam = np.split(step[:, :, 0], [sizes.nu], axis=1)
        return {"u": values["u"] + u, "l": values["l"] + lam}

    @cached_property
    def _rows(self) -> Any:
        """(t, q, v, p) -> g and J of position rows, g' and J of all rows."""
        symbols, (J, of_all) = [self.symbols[key] for key in "tqvp"], self.jacobians
        results = [ca.densify(ca.SX(m)) for m in (self.positions, J, self.velocities, of_all)]
        return ca.Function("rows", symbols, results)

    def rows_at(self, t: float, q: Array, v: Array, p: Array) -> tuple[Array, ...]:
        """Return g and J of position rows, then g' and J of all rows, at a state."""
        g, J, rate, of_all = map(_full, self._rows(t, q, v, p))
        return g.ravel(), J, rate.ravel(), of_all

    def solved(self, values: Mapping[str, Array], times: Array, p: Array) -> dict[str, Array]:
        """Return accelerations, multipliers and rates at states with inputs: letters a, l, w.

        Raises:
            SolveError: Rows are redundant at a state.
        """
        r, K = self.linearize({key: values[key] for key in "qvzu"}, times, p)
        try:
            x = np.linalg.solve(K, -r[:, :, None])[:, :, 0] if r.size else r
        except np.linalg.LinAlgError as error:
            rows = ", ".join(row.name for row in self.equations.system.multiplier_rows)
            text = f"rows are linearly dependent at a state of the motion, among {rows}"
            raise SolveError(f"{text}; try a guess that avoids this state") from error
        nv, m = self.sizes.nv, self.sizes.m
        return {"a": x[:, :nv], "l": x[:, nv : nv + m], "w": x[:, nv + m :]}

    @cached_property
    def _balances(self) -> Any:
        """(t, q, v, z, a, w, u, l, p) -> residual g of w, and diagonals of dg/dw and dg/dz."""
        g, w, z = self._balance, self.symbols["w"], self.symbols["z"]
        both = [(g[i], by[i]) for by in (w, z) for i in range(self.sizes.nz)]
        slopes = [ca.densify(ca.jacobian(*pair)) for pair in both]
        return ca.Function(
            "balances", self._arguments, ca.cse([ca.vertcat(ca.densify(g), *slopes)])
        )

    def damped_rates(
        self, values: Mapping[str, Array], w: Array, times: Array, spans: Array, p: Array
    ) -> Array:
        """Return rates of internal states from an implicit Newton step over given times.

        Where rates restore a state faster than that, as tendons do with fibres, the rate at an
        inaccurate state does not tell its error.

        Args:
            values: Letter -> values, as for `linearize`, with w.
            w: Rates at these states, shape (n, nz).
            times: Times [s], shape (n,).
            spans: Durations over which rates act [s], shape (n,).
        """
        if not (stiff := self._stiff).any():
            return w
        columns = _columns(values, times, p)
        g, by_w, by_z = np.split(_full(self._balances.map(len(times))(*columns)).T, 3, axis=1)
        slope = by_w + spans[:, None] * np.maximum(by_z, 0.0)
        rates = w.copy()
        rates[:, stiff] = (values["w"] - g / slope)[:, stiff]
        return rates

    @cached_property
    def _stiff(self) -> np.ndarray:
        """Which internal states have implicit rates, shape (nz,)."""
        by = ca.jacobian(self._balance, self.symbols["w"])
        return np.array([not by[i, i].is_constant() for i in range(self.sizes.nz)], dtype=np.bool_)


def _columns(values: Mapping[str, Array], times: Array, p: Array) -> list[Array]:
    """Return the arguments (t, q, v, z, a, w, u, l, p) of a function, one column per time."""
    parameters = np.repeat(np.asarray(p)[:, None], len(times), axis=1)
    return [times[None, :], *(values[key].T for key in LETTERS), parameters]


def _full(values: Any) -> Array:
    return np.array(values.full(), dtype=np.float64)


def without_redundant_rows(equations: PhaseEquations, x: State, p: Array) -> PhaseEquations:
    """Return the equations with knowledge of their redundant rows.

    Args:
        x: A state as integrated, near which the rows can hold.
    """
    m, nv = equations.sizes.m, equations.sizes.nv
    if m < 2:
        return equations
    random, chart = np.random.default_rng(0), equations.equations.system.chart
    steps = [np.zeros(nv), *(_ASIDE * random.standard_normal((_TRIES, nv)))]
    best = Dependence((), np.zeros((0, m)), x.q)
    for number, step in enumerate(steps):
        q = _close(equations, x.t, chart.integrate(x.q, step), p)
        dependence = best if q is None else _dependence(equations, x.t, q, p)
        if q is not None and (number == 0 or len(dependence.rows) < len(best.rows)):
            best = dependence
        if not best.rows:
            break
    return PhaseEquations(equations.equations, best)


def _close(equations: PhaseEquations, t: float, q: Array, p: Array) -> Array | None:
    """Return the configuration near q in which the rows hold; None where there is none."""
    chart, still = equations.equations.system.chart, np.zeros(equations.sizes.nv)
    for _ in range(_MOST):
        g, J, _, _ = equations.rows_at(t, q, still, p)
        if np.abs(g).max(initial=0.0) < _CLOSED:
            return q
        q = chart.integrate(q, np.linalg.lstsq(J, -g, rcond=None)[0])
    return None


def _dependence(equations: PhaseEquations, t: float, q: Array, p: Array) -> Dependence:
    """Find rows that are linear combinations of rows before them."""
    J = equations.rows_at(t, q, np.zeros(equations.sizes.nv), p)[3]
    basis, rows, null = list[int](), list[int](), list[Array]()
    for i, row in enumerate(J):
        shares = np.linalg.lstsq(J[basis].T, row, rcond=None)[0] if basis else np.zeros(0)
        remainder = row - shares @ J[basis]
        if np.linalg.norm(remainder) > _DEPENDENT * np.linalg.norm(row):
            basis.append(i)
            continue
        rows.append(i)
        null.append(np.eye(len(J))[i])
        null[-1][basis] -= shares
    return Dependence(tuple(rows), np.array(null).reshape(-1, len(J)), q)


class Dependence(NamedTuple):
    """Redundant rows.

    Attributes:
        rows: Their indices among the active rows.
        null: Multipliers without any effect, one row for each redundant row, shape (.., m).
        q: A configuration in which the rows hold.
    """

    rows: tuple[int, ...] = ()
    null: Array = _NOTHING.reshape(0, 0)
    q: Array = _NOTHING


def characteristic_sizes(
    equations: PhaseEquations, motion: PhaseMotion, p: Array, room: Array
) -> CharacteristicSizes:
    """Return the characteristic sizes of a motion.

    Args:
        room: Widths between the bounds of inputs, inf without bounds, shape (nu,).
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
    return CharacteristicSizes(of, np.concatenate((forces, accelerations, of["w"])), T)


class CharacteristicSizes(NamedTuple):
    """Characteristic sizes of a phase.

    Attributes:
        of: Letter -> size of each unknown of that kind.
        rows: Sizes of the equations of motion.
        duration: Duration [s].
    """

    of: dict[str, Array]
    rows: Array
    duration: float

    def write(self, sizes: Array, unknowns: Unknowns) -> None:
        """Write the sizes to the places of the unknowns of a phase."""
        for letter, values in self.of.items():
            sizes[unknowns.points[letter]] = values
            if letter in unknowns.nodes:
                sizes[unknowns.nodes[letter]] = values
        sizes[unknowns.duration] = sizes[unknowns.begin] = self.duration


def _forces(equations: PhaseEquations, motion: PhaseMotion, p: Array, a: Array) -> Array:
    """Return generalized forces that a motion needs without inputs, shape (nv,)."""
    count, nv = len(motion.points["q"]), equations.sizes.nv
    samples = np.unique(np.linspace(0, count - 1, min(count, _SAMPLES)).astype(int))
    values = {key: motion.points[key][samples] for key in "qvz"}
    times = motion.begin + motion.duration * motion.mesh.shares[samples]
    r, K = equations.linearize(values, times, p)
    forces = np.abs(r[:, :nv]).max(axis=0) + (np.abs(K[:, :nv, :nv]) @ a).max(axis=0)
    floor = 1.0e-3 * float(forces.max(initial=0.0)) or 1.0
    return np.maximum(forces, floor)
