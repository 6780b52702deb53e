"""Explicit Runge-Kutta methods: the step, steps of fixed and of adapted length, tableaus.

A method with the coefficients a, b, c integrates q' = v, v' = a(t, q, v, u) from (t, q, v) by

    dq_i = h sum_{j<i} a_ij dq'_j        dq'_i = chart.rate(dq_i, v_i)
    v_i  = v + h sum_{j<i} a_ij v'_j     v'_i  = a(t + c_i h, q (+) dq_i, v_i, u)

with the weights b in place of a_i for the end of the step. On a vector space q (+) dq is q + dq
and dq' is v; elsewhere dq are the exponential coordinates of the configuration about q.

Sources: Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, 1993, II.1; Iserles,
Munthe-Kaas, Nørsett, Zanna, Lie-group methods, Acta Numerica 9, 2000, 4.2.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from mbd_ros.core.state import Array, Mode, State, have_same_bits
from mbd_ros.errors import DivergedError, ModelError
from mbd_ros.methods.integration.stepping import Stepper, clip

_SAFETY, _LEAST, _MOST = 0.9, 0.2, 6.0  # factors of the step length
_MEMORY = 0.04  # exponent of the last error
_NO_ERROR, _SMALL_ERROR = 1.0e-10, 1.0e-4  # smallest that counts, and that is remembered
_SHORTEST, _PROBE = 1.0e-10, 0.01  # in dt


def rk_step(
    accelerate: Any,
    chart: Any,
    A: Sequence[Array],
    c: Sequence[float],
    x: State,
    u: Array | None,
    h: float,
    K: Array,
) -> tuple[Array, Array]:
    """Perform one step of a method with s stages.

    Args:
        accelerate: The equations of motion: accelerate(t, q, v, u, out) writes v' to `out`.
        chart: The configuration space, with `integrate` for (+) and `rate`.
        A: Coefficients: A[i] = (a_i0, .., a_i,i-1) for i < s, A[s] = b; A[i] has shape (i,).
        c: Times of the stages, in steps, shape (s,).
        x: State at the start of the step.
        u: Inputs, held over the step, shape (nu,); None without any.
        h: Length of the step [s].
        K: Rates (dq'_i, v'_i) of the stages, shape (s, 2 nv). Row 0 holds the rates at x, the
            other rows are written here.

    Returns:
        Configuration, shape (nq,), and velocity, shape (nv,), at t + h.
    """
    s = len(K)
    rk_stages(accelerate, chart, A, c, x, u, h, K, range(1, s))
    dy = (h * A[s]).dot(K)
    nv = len(x.v)
    return chart.integrate(x.q, dy[:nv]), x.v + dy[nv:]


def rk_stages(
    accelerate: Any,
    chart: Any,
    A: Sequence[Array],
    c: Sequence[float],
    x: State,
    u: Array | None,
    h: float,
    K: Array,
    stages: range,
) -> None:
    """Write the rates of some stages; arguments as for `rk_step`, K with all rows before them."""
    t, q, v, _, _ = x
    nv = len(v)
    for i in stages:
        dy = (h * A[i]).dot(K[:i])
        dq, v_i, k = dy[:nv], v + dy[nv:], K[i]
        k[:nv] = chart.rate(dq, v_i)
        accelerate(t + c[i] * h, chart.integrate(q, dq), v_i, u, k[nv:])


def runge_kutta(system: Any, tableau: Tableau, dt: float, tolerance: float | None) -> RungeKutta:
    """Return the stepper for fixed steps, or with a tolerance for adaptive ones."""
    if tolerance is None:
        return RungeKutta(system, tableau, dt)
    return AdaptiveRungeKutta(system, tableau, dt, tolerance)


class RungeKutta(Stepper):
    """Explicit Runge-Kutta steps of fixed length.

    The rates at the end of a step, where the error estimate or the dense output needs them, serve
    as the first ones of the next step if that starts from the same state with the same inputs.

    Args:
        dt: Length of a step [s].

    Attributes:
        before: State that the last step started from.
    """

    checkpoint_fields: ClassVar[tuple[str, ...]] = ("before", "_after", "_u", "_h", "_K", "_known")

    def __init__(self, system: Any, tableau: Tableau, dt: float) -> None:
        self._chart, self._accelerate = system.chart, system.accelerator()
        self._nv, self._dt = int(system.nv), dt
        self._tableau, self._stages = tableau, tableau.stages
        self._A = [row[:i] for i, row in enumerate(tableau.a)]
        self._c: list[float] = tableau.a.sum(axis=1).tolist()
        self._K: Array = np.zeros((len(tableau.a), 2 * self._nv))
        self._known = 0  # rows of K that belong to the last step
        self.before = self._after = State(0.0, np.zeros(0), np.zeros(0))
        self._u: Array | None = None
        self._h = 0.0
        self._mode: Mode = ()

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by dt, or to `end` if that is nearer; x itself at or after `end`."""
        h, t = clip(x.t, self._dt, end)
        if h <= 0.0:
            return x
        self.start(x, u)
        return self.again(h, t)

    def start(self, x: State, u: Array | None) -> None:
        """Begin a step at x: the first rates."""
        first, nv = self._K[0], self._nv
        if self._known > self._stages and x is self._after and have_same_bits(u, self._u):
            first[nv:] = self._K[self._stages, nv:]
        else:
            self._u = None if u is None else u.copy()  # a controller may reuse its array
            self._accelerate(x.t, x.q, x.v, self._u, first[nv:])
        first[:nv] = x.v
        self.before, self._known = x, 1

    def again(self, h: float, t: float) -> State:
        """State after a step of length h [s] from the started one; t is its time [s]."""
        rates = self._K[: self._stages]
        q, v = rk_step(
            self._accelerate, self._chart, self._A, self._c, self.before, self._u, h, rates
        )
        self._h, self._known = h, self._stages
        self._after = State(t, q, v, mode=self._mode)
        return self._after

    def errors(self) -> Array:
        """Return the error estimates of [dq; v] over the last step, shape (m, 2 nv)."""
        weights = self._tableau.errors
        errors: Array = self._h * weights.dot(self._rates(weights.shape[1]))
        return errors

    def interpolate(self, t: float) -> State:
        """Return the state inside the last step, by the dense output of the method.

        Raises:
            ModelError: t [s] is outside the last step.
        """
        x, after = self.before, self._after
        slack = 1.0e-9 * (after.t - x.t)
        if not x.t - slack <= t <= after.t + slack:
            raise ModelError(
                f"t = {t:.9g} s is outside the last step, {x.t:.9g} .. {after.t:.9g} s"
            )
        if t == after.t:
            return after
        weights = self._tableau.weights((t - x.t) / self._h)
        dq, dv = (self._h * weights).dot(self._rates(len(weights))).reshape(2, -1)
        return State(t, self._chart.integrate(x.q, dq), x.v + dv, mode=self._mode)

    @property
    def first(self) -> Array:
        """Acceleration at the start of the last step, shape (nv,); changes with the next step."""
        a: Array = self._K[0, self._nv :]
        return a

    def restart(self) -> None:
        """Forget the rates at the end of the last step."""
        self._known = 0

    def follow(self, accelerate: Any, mode: Mode = ()) -> None:
        """Follow other accelerations; the length of adaptive steps is kept."""
        self._accelerate, self._mode = accelerate, mode
        self._known = 0

    def _rates(self, count: int) -> Array:
        """Rates of the first `count` stages of the last step, some of them beyond its end."""
        rates = self._K[:count]
        rk_stages(
            self._accelerate,
            self._chart,
            self._A,
            self._c,
            self.before,
            self._u,
            self._h,
            rates,
            range(self._known, count),
        )
        self._known = max(self._known, count)
        return rates


class AdaptiveRungeKutta(RungeKutta):
    """Explicit Runge-Kutta steps with error control.

    A step is accepted if the root mean square of e_i / (tolerance (1 + |y_i|)) is below one,
    with e the estimated error of the step in y = [q; v], taken at its start. On configurations
    that are no vector space, dq stands for q and its tolerance is absolute. The next length
    follows from this error and from the last one (PI control).

    Source: Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, 1993, II.4; II.10
    for the two estimates of DOP853; Hairer, Wanner, II, 1996, IV.2 for PI control.

    Args:
        dt: Longest first step [s]; later steps may be longer.
        tolerance: Relative and absolute.
    """

    checkpoint_fields = (*RungeKutta.checkpoint_fields, "_length", "_last_error")
    is_fixed = False

    def __init__(self, system: Any, tableau: Tableau, dt: float, tolerance: float) -> None:
        super().__init__(system, tableau, dt)
        self._tolerance = tolerance
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
        self.start(x, u)
        scale = self._scale(x)
        if self._length == 0.0:
            self._length = self._first_length(x, u, scale)
        while True:
            is_last = left <= 1.01 * self._length
            h = left if is_last else self._length
            after = self.again(h, end if is_last else x.t + h)
            error = _norm(self.errors() / scale)
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
        """Length of the next step [s] and last error."""
        return self._length, self._last_error

    @pace.setter
    def pace(self, pace: tuple[float, ...]) -> None:
        self._length, self._last_error = pace

    def restart(self) -> None:
        """Forget the last step and its length."""
        super().restart()
        self._length, self._last_error = 0.0, _SMALL_ERROR

    def _factor(self, error: float) -> float:
        """Return the change of the step length after an accepted step."""
        error = max(error, _NO_ERROR)
        factor = error ** (0.75 * _MEMORY - self._power) * self._last_error**_MEMORY
        self._last_error = max(error, _SMALL_ERROR)
        return float(max(_LEAST, _SAFETY * factor))

    def _scale(self, x: State) -> Array:
        """Return the size of an error that counts as one, shape (2 nv,)."""
        scale, nv = self._weights, len(x.v)
        scale[:nv] = x.q if self._chart.is_flat else 0.0
        scale[nv:] = x.v
        np.abs(scale, out=scale)
        scale += self._chart.sizes
        scale *= self._tolerance
        return scale

    def _first_length(self, x: State, u: Array | None, scale: Array) -> float:
        """Length of a first step from the slope and its change over a short Euler step."""
        probe, a = _PROBE * self._dt, self.first
        q, v = self._chart.integrate(x.q, probe * x.v), x.v + probe * a
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
    """Return the root mean square of an error estimate, or of the two of DOP853 combined."""
    square = errors[0].dot(errors[0])
    if len(errors) == 2:
        whole = square + 0.01 * errors[1].dot(errors[1])
        square = square * square / whole if whole else square
    return math.sqrt(square / errors.shape[1])


def check_tolerance(tolerance: float | None) -> None:
    """Refuse a tolerance that double precision or the error estimate does not allow.

    Raises:
        ModelError: It is not in 1e-13 .. 0.1.
    """
    if tolerance is not None and not 1e-13 <= tolerance <= 0.1:
        raise ModelError(f"tolerance {tolerance:g} is outside 1e-13 .. 0.1")


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
        """Return weights w of the rates with y(t + theta h) = y + h sum_i w_i k_i, shape (n,).

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
    """Return the dense matrix of rows that are given as {column: value}."""
    full = np.zeros((len(rows), columns))
    for row, values in zip(full, rows, strict=True):
        row[list(values)] = list(values.values())
    return full


RK4 = Tableau(
    matrix([{}, {0: 1 / 2}, {1: 1 / 2}, {2: 1.0}, {0: 1 / 6, 1: 1 / 3, 2: 1 / 3, 3: 1 / 6}], 5), 4
)
