"""Explicit Runge-Kutta methods: tableaus, stages, fixed and adapted steps."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.state import NONE, Array, Memory, Mode, State, copied, recognised
from mbd_ros.errors import DivergedError, ModelError
from mbd_ros.methods.integration.stepping import NEAR, Stepper, clip

# ---- tableau ----------------------------------------------------------------------------------
# Explicit Runge-Kutta methods as data.


class Tableau(NamedTuple):
    """Coefficients of an explicit Runge-Kutta method for y' = f(t, y).

        y_i = y + h sum_j a[i, j] k_j,   k_i = f(t + c_i h, y_i),   c_i = sum_j a[i, j]

    Row `stages` of `a` is the step itself; the rows after it serve the dense output only.

    Attributes:
        a: Strictly lower triangular, shape (n, n), n > stages.
        stages: Evaluations of a step.
        error_order: Order of the error estimate.
        errors: Error estimates as weights of the rates, shape (m, k): one row, or two (5th and
            3rd order) that are combined as in DOP853.
        dense: What the dense output adds to the cubic through both ends, as weights of the rates,
            shape (d, n).
    """

    a: Array
    stages: int
    error_order: int = 0
    errors: Array = np.zeros((0, 0))
    dense: Array = np.zeros((0, 0))

    @property
    def terms(self) -> Array:
        """F0, F1, .. of `weights` as weights of the rates, shape (3 + d, n)."""
        start, end = np.eye(len(self.a))[[0, self.stages]]
        step = self.a[self.stages]
        hermite = [step, start - step, 2.0 * step - start - end]
        return np.vstack([hermite, self.dense.reshape(-1, len(step))])

    def weights(self, theta: float) -> Array:
        """Weights w of the rates with y(t + theta h) = y + h sum_i w_i k_i, shape (n,).

            y + theta (F0 + (1 - theta) (F1 + theta (F2 + (1 - theta) (F3 + ..))))

        Source: Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, 1993, II.6.

        Args:
            theta: Part of the step, 0 .. 1.
        """
        terms = self.terms
        factors = np.resize([theta, 1.0 - theta], len(terms))
        weights: Array = np.cumprod(factors).dot(terms)
        return weights


def matrix(rows: Sequence[Mapping[int, float]], columns: int) -> Array:
    """Dense matrix of rows that are given as {column: value}."""
    full = np.zeros((len(rows), columns))
    for row, values in zip(full, rows, strict=True):
        row[list(values)] = list(values.values())
    return full


RK4 = Tableau(
    matrix([{}, {0: 1 / 2}, {1: 1 / 2}, {2: 1.0}, {0: 1 / 6, 1: 1 / 3, 2: 1 / 3, 3: 1 / 6}], 5), 4
)


# ---- runge kutta stages -----------------------------------------------------------------------
# Stages of an explicit Runge-Kutta method on any configuration space.


class Stages:
    """One step at work, in the chart of the configuration that it starts from.

        q(t) = q0 (+) dq(t),   dq' = chart.rate(dq, v),   v' = a(t, q, v, u)

    The acceleration at the end of a step is the first one of the next step, if the state and the
    command are still the same then.

    Source: Iserles, Munthe-Kaas, Nørsett, Zanna, Lie-group methods, Acta Numerica 9, 2000, 4.2.

    Args:
        system: The system.
        tableau: The method.
    """

    def __init__(self, system: Any, tableau: Tableau) -> None:
        self._chart, self._accelerate = system.chart, system.accelerator()
        self._a = np.zeros(int(system.nv))
        self._tableau, self._nv, self._end = tableau, int(system.nv), tableau.stages
        self._c = tableau.a.sum(axis=1).tolist()
        self._h, self._done = 0.0, 0
        self._x = self._after = State(0.0, np.zeros(0), np.zeros(0))
        self._u: Array | None = None
        self._held: bytes | None = None
        self._mode: Mode = ()
        self._allocate()

    def start(self, x: State, u: Array | None) -> None:
        """Begin a step at x: the first rate."""
        held = None if u is None else u.tobytes()
        is_known = self._done > self._end and x is self._after and held == self._held
        if held != self._held:  # by value, since a controller may reuse its array
            self._u, self._held = None if u is None else u.copy(), held
        if is_known:
            a = self._end_acceleration()
        else:
            a = self._a
            self._accelerate(x.t, x.q, x.v, self._u, a)
        self._begin(x, a)
        self._x, self._done = x, 1

    def step(self, x: State, u: Array | None, h: float, t: float) -> State:
        """`start` and `advance`."""
        self.start(x, u)
        return self.advance(h, t)

    def advance(self, h: float, t: float) -> State:
        """State after a step of length h [s] from the started one; t is its time [s]."""
        self._h, self._done = h, 1
        self._complete(self._end)
        self._after = State(t, *self._stage(self._end), mode=self._mode)
        return self._after

    def memory(self) -> Memory:
        """What the next step and the dense output of this one depend on."""
        kept = (self._h, self._done, self._x, self._after, self._u, self._held)
        return {"step": copied(kept), "rates": self._rates_kept()}

    def recall(self, memory: Memory, x: State) -> None:
        """Continue from a memory; x is the state from which the next step starts."""
        step = recognised(copied(memory["step"]), x)
        self._h, self._done, self._x, self._after, self._u, self._held = step
        self._put_rates(memory["rates"])

    def rename(self, after: State) -> None:
        """Take a state with the numbers of the last result for that result."""
        self._after = after

    def follow(self, accelerate: Any, mode: Mode) -> None:
        """Other accelerations for the next step, and the mode that its states have."""
        self._accelerate, self._mode = accelerate, mode
        self.forget()

    def forget(self) -> None:
        """Nothing of this step may serve the next one."""
        self._done = 0

    def errors(self) -> Array:
        """Error estimates of [dq; v] over the last `advance`, shape (m, 2 nv)."""
        count = self._tableau.errors.shape[1]
        self._complete(count)
        errors: Array = self._h * self._tableau.errors.dot(self._flat_rates[:count])
        return errors

    def at(self, t: float) -> State:
        """State inside the last step, by the dense output."""
        if t == self._after.t:
            return self._after
        self._complete(len(self._c))
        weights = self._tableau.weights((t - self._x.t) / self._h)
        return State(t, *self._blend(weights), mode=self._mode)

    @property
    def first(self) -> Array:
        """Acceleration at the started state, shape (nv,); changes with the next step."""
        a: Array = self._rates[0, 1]
        return a

    @property
    def before(self) -> State:
        """State that the last step started from."""
        return self._x

    @property
    def span(self) -> tuple[float, float]:
        """Times at the start and at the end of the last step [s]."""
        return self._x.t, self._after.t

    def _allocate(self) -> None:
        self._rates: Array = np.zeros((len(self._c), 2, self._nv))
        self._flat_rates = self._rates.reshape(len(self._c), -1)

    def _rates_kept(self) -> Any:
        return self._rates.copy()

    def _put_rates(self, rates: Any) -> None:
        self._rates[...] = rates

    def _begin(self, x: State, a: Array) -> None:
        self._rates[0, 0], self._rates[0, 1] = x.v, a

    def _end_acceleration(self) -> Array:
        a: Array = self._rates[self._end, 1]
        return a

    def _stage(self, i: int) -> tuple[Array, Array]:
        """Configuration and velocity of a stage whose predecessors are known."""
        return self._blend(self._tableau.a[i, :i])

    def _blend(self, weights: Array) -> tuple[Array, Array]:
        dq, dv = (self._h * weights).dot(self._flat_rates[: len(weights)]).reshape(2, -1)
        return self._chart.integrate(self._x.q, dq), self._x.v + dv

    def _complete(self, count: int) -> None:
        """Evaluate the rates up to `count`, which may be beyond those of the step."""
        t0, h, v0 = self._x.t, self._h, self._x.v
        for i in range(self._done, count):
            dq, dv = (h * self._tableau.a[i, :i]).dot(self._flat_rates[:i]).reshape(2, -1)
            q, v = self._chart.integrate(self._x.q, dq), v0 + dv
            self._rates[i, 0] = self._chart.rate(dq, v)
            self._accelerate(t0 + h * self._c[i], q, v, self._u, self._rates[i, 1])
        self._done = max(self._done, count)


# ---- nystrom stages ---------------------------------------------------------------------------
# Stages of an explicit Runge-Kutta method where q is a vector space with q' = v.


new_state = tuple.__new__  # half the time of the constructor of a NamedTuple


class NystromStages(Stages):
    """The stages of `Stages` at the cost of one small product each.

    With B = [q; v; a_1; a_2; ..] the rows above a_i give q_i and v_i at once:

        q_i = q + c_i h v + h^2 sum_j (A A)_ij a_j,   v_i = v + h sum_j A_ij a_j

    A step writes its result into the head of a second B, from which the next step starts.

    Source: Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, 1993, II.14.
    """

    def step(self, x: State, u: Array | None, h: float, t: float) -> State:
        """`start` and `advance`, without the way through `start` on a smooth stretch."""
        t0, q, v, _, _ = x
        held = None if u is None else u.tobytes()
        if x is not self._after or self._done != self._end or held != self._held:
            return super().step(x, u, h, t)
        self._switch()
        self._accelerate(t0, q, v, self._u, self._side.first)
        self._x = x
        return self.advance(h, t)

    def advance(self, h: float, t: float) -> State:
        """State after a step of length h [s] from the started one; t is its time [s]."""
        if h != self._h:
            self._h = h
            self._blocks.scale(h)
        accelerate, u, t0 = self._accelerate, self._u, self._x[0]
        side, q, v, pair = self._side, self._q, self._v, self._pair
        for c, product, above, row in side.inner:
            product(above, pair)
            accelerate(t0 + c * h, q, v, u, row)
        side.step(side.above_step, side.result)
        self._done = self._end
        result = t, side.result_q(), side.result_v(), NONE, self._mode
        self._after = after = new_state(State, result)
        return after

    def errors(self) -> Array:
        """Error estimates of [q; v] over the last `advance`, shape (m, 2 nv)."""
        count = self._tableau.errors.shape[1]
        self._complete(count)
        errors: Array = self._errors.dot(self._side.B[: 2 + count]).reshape(-1, 2 * self._nv)
        return errors

    @property
    def first(self) -> Array:
        """Acceleration at the started state, shape (nv,); changes with the next step."""
        a: Array = self._side.first
        return a

    def _allocate(self) -> None:
        a, errors = self._tableau.a, self._tableau.errors
        self._pair = np.empty((2, self._nv))
        self._q, self._v = self._pair
        stages = [np.eye(2, 2 + i) + _increment(a[i, :i], a) for i in range(1, len(a))]
        estimates = [_increment(weights, a) for weights in errors]
        self._blocks = Blocks([*stages, np.reshape(estimates, (-1, 2 + errors.shape[1]))])
        *stages, self._errors = self._blocks.views
        one, two = np.zeros((2, 2 + len(a), self._nv))
        self._side: _Side = _Side(one, two[:2], stages, self._c, self._end)
        self._other: _Side = _Side(two, one[:2], stages, self._c, self._end)

    def _rates_kept(self) -> Any:
        return self._side.B.copy(), self._side.result.copy()

    def _put_rates(self, rates: Any) -> None:
        self._side.B[...], self._side.result[...] = rates
        self._blocks.scale(self._h)

    def _switch(self) -> None:
        self._side, self._other = self._other, self._side

    def _begin(self, x: State, a: Array) -> None:
        if x is self._after:
            self._switch()
        else:
            self._side.q[...], self._side.v[...] = x.q, x.v
        self._side.first[...] = a

    def _end_acceleration(self) -> Array:
        a: Array = self._side.end
        return a

    def _complete(self, count: int) -> None:
        for c, product, above, row in self._side.later[self._done - 1 : count - 1]:
            product(above, self._pair)
            t = self._x.t + c * self._h
            self._accelerate(t, self._q, self._v, self._u, row)
        self._done = max(self._done, count)

    def _blend(self, weights: Array) -> tuple[Array, Array]:
        block = Blocks([np.eye(2, 2 + len(weights)) + _increment(weights, self._tableau.a)])
        block.scale(self._h)
        q, v = block.views[0].dot(self._side.B[: 2 + len(weights)])
        return q, v


class _Side:
    """One B with everything that a step needs of it.

    Args:
        B: [q; v; a_1; ..], shape (2 + n, nv).
        result: Where the step writes its [q; v], shape (2, nv).
        stages: Matrices of the stages after the first one.
        c: Times of all stages, in steps.
        end: Index of the stage that is the step itself.
    """

    def __init__(
        self, B: Array, result: Array, stages: Sequence[Array], c: Sequence[float], end: int
    ) -> None:
        rows = list(B)
        self.B, self.result, self.q, self.v, self.first = B, result, *rows[:3]
        self.end = rows[2 + end]
        self.result_q, self.result_v = (row.copy for row in result)
        self.later = [
            (c[i], stage.dot, B[: 2 + i], rows[2 + i]) for i, stage in enumerate(stages, 1)
        ]
        self.inner = self.later[: end - 1]
        _, self.step, self.above_step, _ = self.later[end - 1]


class Blocks:
    """Matrices for [q; v; a_1; ..] whose entries are multiples of 1, h or h^2, in one array.

    Args:
        units: The multiples; rows for q and v alternate.

    Attributes:
        views: The matrices, for the step length of the last `scale`.
    """

    def __init__(self, units: Sequence[Array]) -> None:
        self._units = np.concatenate([unit.ravel() for unit in units])
        self._exponents = np.concatenate([_exponents(*unit.shape).ravel() for unit in units])
        self._values = np.zeros_like(self._units)
        pieces = np.split(self._values, np.cumsum([unit.size for unit in units])[:-1])
        self.views = [piece.reshape(u.shape) for piece, u in zip(pieces, units, strict=True)]

    def scale(self, h: float) -> None:
        """Fill the matrices for steps of length h [s]."""
        np.multiply(self._units, np.array([1.0, h, h * h])[self._exponents], out=self._values)


def _increment(weights: Array, a: Array) -> Array:
    """Change of q and v that weights of the rates (v_i, a_i) make, as multiples of 1, h, h^2."""
    count = len(weights)
    return np.array([[0.0, weights.sum(), *weights.dot(a[:count, :count])], [0.0, 0.0, *weights]])


def _exponents(rows: int, columns: int) -> Array:
    """Power of h of every entry."""
    row = np.array([[0, 1, *[2] * (columns - 2)], [0, 0, *[1] * (columns - 2)]])
    return np.resize(row, (rows, columns))


# ---- runge kutta ------------------------------------------------------------------------------
# Steps of fixed length by an explicit Runge-Kutta method.


class RungeKutta(Stepper):
    """Explicit Runge-Kutta steps.

    Args:
        system: The system.
        tableau: The method.
        dt: Length of a step [s].

    Attributes:
        stages: The last step at work.
    """

    def __init__(self, system: Any, tableau: Tableau, dt: float) -> None:
        self.stages = (NystromStages if system.chart.is_flat else Stages)(system, tableau)
        self._dt, self._near = dt, NEAR * dt

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by dt, or to `end` if that is nearer; x itself at or after `end`."""
        start = x[0]
        if start + self._near > end:
            h, t = clip(start, self._dt, end)
            return self.stages.step(x, u, h, t) if h > 0.0 else x
        return self.stages.step(x, u, self._dt, start + self._dt)

    def restart(self) -> None:
        """Forget the acceleration at the end of the last step."""
        self.stages.forget()

    def again(self, h: float, t: float) -> State:
        """As `Stepper.again`."""
        return self.stages.advance(h, t)

    def follow(self, accelerate: Any, mode: Mode = ()) -> None:
        """As `Stepper.follow`; the length of adaptive steps is kept."""
        self.stages.follow(accelerate, mode)

    def memory(self) -> Memory:
        """The last step."""
        return {**super().memory(), "stages": self.stages.memory()}

    def recall(self, memory: Memory, x: State) -> None:
        """As `Stepper.recall`."""
        super().recall({name: memory[name] for name in self.kept}, x)
        self.stages.recall(memory["stages"], x)

    def interpolate(self, t: float) -> State:
        """State inside the last step, by the dense output of the method.

        Raises:
            ModelError: t [s] is outside the last step.
        """
        start, end = self.stages.span
        slack = 1.0e-9 * (end - start)
        if not start - slack <= t <= end + slack:
            raise ModelError(f"t = {t:.9g} s is outside the last step, {start:.9g} .. {end:.9g} s")
        return self.stages.at(t)


# ---- adaptive runge kutta ---------------------------------------------------------------------
# Steps as long as a tolerance allows, by an explicit Runge-Kutta method.


_SAFETY, _LEAST, _MOST = 0.9, 0.2, 6.0  # factors of the step length
_MEMORY = 0.04  # exponent of the last error
_NO_ERROR, _SMALL_ERROR = 1.0e-10, 1.0e-4  # smallest that counts, and that is remembered
_SHORTEST, _PROBE = 1.0e-10, 0.01  # in dt


def runge_kutta(system: Any, tableau: Tableau, dt: float, tolerance: float | None) -> RungeKutta:
    """The stepper for fixed steps, or with a tolerance for adaptive ones."""
    if tolerance is None:
        return RungeKutta(system, tableau, dt)
    return AdaptiveRungeKutta(system, tableau, dt, tolerance)


def check_tolerance(tolerance: float | None) -> None:
    """Refuse a tolerance that double precision or the error estimate does not allow.

    Raises:
        ModelError: It is not in 1e-13 .. 0.1.
    """
    if tolerance is not None and not 1e-13 <= tolerance <= 0.1:
        raise ModelError(f"tolerance {tolerance:g} is outside 1e-13 .. 0.1")


class AdaptiveRungeKutta(RungeKutta):
    """Explicit Runge-Kutta steps with error control.

    A step is accepted if the root mean square of e_i / (tolerance (1 + |y_i|)) is below one,
    with e the estimated error of the step in y = [q; v], taken at its start. On configurations
    that are no vector space, dq stands for q and its tolerance is absolute. The next length
    follows from this error and from the last one (PI control).

    Source: Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, 1993, II.4; II.10
    for the two estimates of DOP853; Hairer, Wanner, II, 1996, IV.2 for PI control.

    Args:
        system: The system.
        tableau: The method.
        dt: Longest first step [s]; later steps may be longer.
        tolerance: Relative and absolute.
    """

    kept = ("_length", "_last_error")
    is_fixed = False

    def __init__(self, system: Any, tableau: Tableau, dt: float, tolerance: float) -> None:
        super().__init__(system, tableau, dt)
        self._system, self._tolerance = system, tolerance
        self._accelerate = system.accelerator()
        self._weights = np.zeros(2 * int(system.nv))
        self._power = 1.0 / (tableau.error_order + 1)
        self._length, self._last_error = 0.0, _SMALL_ERROR

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by one step of its own length, not beyond `end`; x itself at or after it.

        Raises:
            DivergedError: No step is short enough.
        """
        left, most = end - x.t, _MOST
        if left <= 0.0:
            return x
        self.stages.start(x, u)
        scale = self._scale(x)
        if self._length == 0.0:
            self._length = self._first_length(x, u, scale)
        while True:
            is_last = left <= 1.01 * self._length
            h = left if is_last else self._length
            after = self.stages.advance(h, end if is_last else x.t + h)
            error = _norm(self.stages.errors() / scale)
            if error < 1.0:
                break
            most = 1.0
            self._length = h * max(_LEAST, _SAFETY * error**-self._power)
            self._check_length(x)
        longer = h * min(most, self._factor(error))
        self._length = max(longer, self._length) if is_last else longer
        return after

    @property
    def pace(self) -> tuple[float, ...]:
        """As `Stepper.pace`."""
        return self._length, self._last_error

    @pace.setter
    def pace(self, pace: tuple[float, ...]) -> None:
        self._length, self._last_error = pace

    def restart(self) -> None:
        """Forget the last step and its length."""
        super().restart()
        self._length, self._last_error = 0.0, _SMALL_ERROR

    def follow(self, accelerate: Any, mode: Mode = ()) -> None:
        """As `Stepper.follow`."""
        super().follow(accelerate, mode)
        self._accelerate = accelerate

    def _factor(self, error: float) -> float:
        """Change of the step length after an accepted step."""
        error = max(error, _NO_ERROR)
        factor = error ** (0.75 * _MEMORY - self._power) * self._last_error**_MEMORY
        self._last_error = max(error, _SMALL_ERROR)
        return float(max(_LEAST, _SAFETY * factor))

    def _scale(self, x: State) -> Array:
        """Size of an error that counts as one, shape (2 nv,)."""
        scale, nv = self._weights, len(x.v)
        scale[:nv] = x.q if self._system.chart.is_flat else 0.0
        scale[nv:] = x.v
        np.abs(scale, out=scale)
        scale += self._system.chart.sizes
        scale *= self._tolerance
        return scale

    def _first_length(self, x: State, u: Array | None, scale: Array) -> float:
        """Length of a first step from the slope and its change over a short Euler step."""
        probe, a = _PROBE * self._dt, self.stages.first
        q, v = self._system.chart.integrate(x.q, probe * x.v), x.v + probe * a
        there = np.concatenate([v, np.empty_like(v)])
        self._accelerate(x.t + probe, q, v, u, there[len(v) :])
        here = np.concatenate([x.v, a])[None]
        steepest = max(_norm(here / scale), _norm((there - here) / scale / probe))
        if not steepest > 0.0:
            return self._dt
        return float(min(self._dt, (0.01 / steepest) ** self._power))

    def _check_length(self, x: State) -> None:
        if self._length > max(_SHORTEST * self._dt, 8.0 * math.ulp(x.t)):
            return
        i = int(np.abs(x.v).argmax())
        raise DivergedError(
            f"no step from t = {x.t:.9g} s down to {self._length:.2g} s meets tolerance "
            f"{self._tolerance:g}; fastest there: velocity {i} with {x.v[i]:.4g}"
        )


def _norm(errors: Array) -> float:
    """Root mean square of an error estimate, or of the two of DOP853 combined."""
    square = errors[0].dot(errors[0])
    if len(errors) == 2:
        whole = square + 0.01 * errors[1].dot(errors[1])
        square = square * square / whole if whole else square
    return math.sqrt(square / errors.shape[1])
