"""Gauss-Legendre collocation: implicit midpoint and its relatives of order 4 and 6."""

import math
from functools import partial
from typing import Any, ClassVar

import numpy as np

from mbd_ros.core.dynamics.linearization import Linearization
from mbd_ros.core.state import Array, Memory, Mode, State
from mbd_ros.core.thresholds import SAME_TIME
from mbd_ros.errors import DivergedError, ModelError
from mbd_ros.methods.integration.adams import integrals
from mbd_ros.methods.integration.newton import FAILED, SLOW, converge
from mbd_ros.methods.integration.stepping import Integrator, Stepper, clip


class GaussLegendre(Integrator):
    """Collocation at Gauss points, for stiff scenes and for long conservative motion.

    With stages i, V_i = v + h sum_j a_ij K_j and Q_i = q + h sum_j a_ij V_j:

        K_i = a(t + c_i h, Q_i, V_i),   v+ = v + h sum_i b_i K_i,   q+ = q + h sum_i b_i V_i

    Time-reversible everywhere; symplectic where the mass matrix is constant, for the velocity is
    integrated and not the momentum. Stable for every decaying motion at any step; what decays
    faster than the step is damped slowly (the factor tends to -1 or 1, not to 0). On a floating
    base the stages live in a chart about the middle of the step, which keeps the method symmetric.
    Simplified Newton with the derivatives of the system, by differences where it is not compiled,
    kept over steps; forces that jump within a step may keep it from converging.

    Args:
        stages: 1 (implicit midpoint), 2 or 3; the order is twice that.
        tolerance: Of the stage velocities [m/s, rad/s], relative above 1; iterations go on below
            it while they gain.

    Source: Hairer, Lubich, Wanner, Geometric Numerical Integration, 2nd ed. 2006, sec. II.1.3,
        VIII.6; chart: Zanna, Engo, Munthe-Kaas, BIT 41, 2001, 395-421.
    """

    order = 4
    dense: ClassVar[bool] = True
    event_driven: ClassVar[bool] = True
    is_explicit = False
    compiled_functions = ("accelerate", "derivatives")
    example = {"stages": 2}

    def __init__(self, *, stages: int = 2, tolerance: float = 1.0e-10) -> None:
        if stages not in (1, 2, 3):
            raise ModelError(f"stages {stages}, accepted: 1, 2, 3")
        if not 0.0 < tolerance < 1.0:
            raise ModelError(f"tolerance {tolerance:g}, accepted: between 0 and 1")
        self.stages = stages
        self.tolerance = tolerance
        self.order = 2 * stages

    def prepare(self, system: Any, dt: float) -> Stepper:
        """Return a stepper for one system and one step size [s]."""
        return _Steps(self, system, dt)


def _tableau(stages: int) -> tuple[Array, Array, Array]:
    """Return coefficients a, b, c of the collocation."""
    c = 0.5 + 0.5 * np.polynomial.legendre.leggauss(stages)[0]
    k = np.arange(1, stages + 1)
    lagrange = np.linalg.inv(np.vander(c, increasing=True))
    return (c[:, None] ** k / k).dot(lagrange), (1.0 / k).dot(lagrange), c


class _Steps(Stepper):
    checkpoint_fields = (
        "_is_fresh",
        "_is_slow",
        "_h",
        "_K",
        "_turn",
        "_inverse",
        "_slopes",
        "_x",
        "_after",
    )

    def __init__(self, method: GaussLegendre, system: Any, dt: float) -> None:
        self._system = system
        self._dt = dt
        self._tolerance = method.tolerance
        self._name = f"Gauss-Legendre with {method.stages} stages"
        self._a, self._b, self._c = _tableau(method.stages)
        self._accelerate = system.accelerator()
        self._differentiate = system.derivatives
        self._mode: Mode = ()
        self._x = self._after = State(0.0, np.zeros(0), np.zeros(0))
        self._u: Array | None = None
        shape = (method.stages, system.nv)
        self._K = np.zeros(shape)
        self._turn = np.zeros(shape)
        self._r = np.zeros(shape)
        self._a0 = np.zeros(system.nv)
        self._inverse: Array = np.eye(self._K.size)
        self._slopes: tuple[Array, ...] = ()  # by q and by v, of which the inverse was made
        self._vander = np.linalg.inv(np.vander(self._c, increasing=True))
        self._guess = np.vander(1.0 + self._c, method.stages, increasing=True).dot(self._vander)
        self._stages = self._flat_stages if system.chart.is_flat else self._curved_stages
        self.restart()

    def restart(self) -> None:
        """Forget stages and derivatives."""
        self._is_fresh, self._is_slow, self._h = True, True, 0.0

    def restore(self, checkpoint: Memory, x: State) -> None:
        """Take up what an earlier step has kept, with the coefficients for its length."""
        super().restore(checkpoint, x)
        self._scale(self._h)

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by one step."""
        h, t = clip(x.t, self._dt, end)
        self._begin(x, u, h)
        return self._advance(x, u, h, t)

    def again(self, h: float, t: float) -> State:
        """Return the last step once more by another length, with the same derivatives."""
        places = np.minimum(self._c * (h / self._h), 1.0)
        guess = np.vander(places, len(places), increasing=True).dot(self._vander)
        self._K, self._turn = guess.dot(self._K), guess.dot(self._turn)
        self._scale(h)
        self._invert()
        self._is_slow = False
        return self._advance(self._x, self._u, h, t)

    def follow(self, accelerate: Any, mode: Mode = ()) -> None:
        """Go on with other accelerations, as in another mode."""
        self._accelerate, self._mode = accelerate, mode
        self._differentiate = partial(Linearization(self._system).derivatives, accelerate)
        self.restart()

    def interpolate(self, t: float) -> State:
        """Return the state inside the last step, by the polynomial of the collocation.

        Raises:
            ModelError: t [s] is outside the last step.
        """
        x, h, after = self._x, self._h, self._after
        if t == after.t:
            return after
        theta = (t - x.t) / h if h else math.nan
        if not -SAME_TIME <= theta <= 1.0 + SAME_TIME:
            raise ModelError(
                f"t = {t:.9g} s is outside the last step, {x.t:.9g} .. {after.t:.9g} s"
            )
        once, twice = integrals(self._c, theta)
        v = x.v + h * once.dot(self._K)
        moved = theta * h * x.v + h * h * twice.dot(self._K)
        if self._system.chart.is_flat:
            return State(t, x.q + moved, v, mode=self._mode)
        V = x.v + self._ha.dot(self._K)
        half = 0.5 * self._hb.dot(V + self._turn)
        centre = self._system.chart.integrate(x.q, half)
        q = self._system.chart.integrate(centre, moved + h * once.dot(self._turn) - half)
        return State(t, q, v, mode=self._mode)

    def _advance(self, x: State, u: Array | None, h: float, t: float) -> State:
        """Return the step that has begun."""
        rate = FAILED
        if not self._is_slow:
            rate = self._solve(x, u, h)
        if rate == FAILED:
            self._refresh(x, u, h)
            rate = self._solve(x, u, h)
        if rate == FAILED:
            raise DivergedError(
                f"{self._name}: the stages of the step from t = {x.t:.9g} s by {h:g} s do not "
                "converge; try a smaller dt"
            )
        self._is_slow, self._x, self._u = rate > SLOW, x, u
        self._after = State(t, self._q1, x.v + self._hb.dot(self._K), mode=self._mode)
        return self._after

    def _begin(self, x: State, u: Array | None, h: float) -> None:
        """First guess of the stages: the last polynomial continued, or no change."""
        if h != self._h or self._is_fresh:
            self._scale(h)
            self._is_slow = True
            self._accelerate(x.t, x.q, x.v, u, self._a0)
            self._K[...] = self._a0
            self._turn[...] = 0.0
            self._is_fresh = False
        else:
            self._K = self._guess.dot(self._K)

    def _scale(self, h: float) -> None:
        """Coefficients for steps of length h [s]."""
        self._h = h
        self._ha, self._hb = h * self._a, h * self._b
        self._hhaa, self._hhba = self._ha.dot(self._ha), self._hb.dot(self._ha)
        self._hc = h * self._c[:, None]
        self._centred = self._ha - 0.5 * self._hb
        self._times = h * self._c

    def _refresh(self, x: State, u: Array | None, h: float) -> None:
        """Derivatives at the state, and the inverse of the Newton matrix."""
        if not np.isfinite(self._K).all():
            self._accelerate(x.t, x.q, x.v, u, self._a0)
            self._K[...] = self._a0
            self._turn[...] = 0.0
        at = self._differentiate(x, u, inputs=False)
        self._slopes = at.q, at.v
        self._invert()

    def _invert(self) -> None:
        """The inverse of the Newton matrix with the derivatives that are known."""
        by_q, by_v = self._slopes
        matrix = np.eye(self._K.size)
        matrix -= np.kron(self._ha, by_v) + np.kron(self._hhaa, by_q)
        self._inverse = np.linalg.inv(matrix)

    def _solve(self, x: State, u: Array | None, h: float) -> float:
        scale = max(1.0, float(np.abs(x.v).max()))

        def correct() -> float:
            moved = self._stages(x, u)
            dK = self._inverse.dot(self._r.ravel()).reshape(self._K.shape)
            self._K += dK
            return moved + h * float(np.abs(dK).max())

        rate = converge(correct, self._tolerance * scale)
        if self._system.chart.is_flat:
            self._q1 = x.q + h * x.v + self._hhba.dot(self._K)
        return rate

    def _flat_stages(self, x: State, u: Array | None) -> float:
        """Return the residual of every stage where q is a vector space."""
        K = self._K
        V = x.v + self._ha.dot(K)
        Q = (x.q + self._hc * x.v) + self._hhaa.dot(K)
        for i, c in enumerate(self._times):
            self._accelerate(x.t + c, Q[i], V[i], u, self._r[i])
            self._r[i] -= K[i]
        return 0.0

    def _curved_stages(self, x: State, u: Array | None) -> float:
        """Residual in a chart about q (+) half the step; returns the change of the chart rates.

        The chart moves with V + turn; turn is O(h) and follows by plain repetition.
        """
        system, K = self._system, self._K
        V = x.v + self._ha.dot(K)
        D = self._centred.dot(V + self._turn)
        rates = np.array([system.chart.rate(d, v) for d, v in zip(D, V, strict=True)])
        moved = float(np.abs(rates - V - self._turn).max())
        self._turn = rates - V
        half = 0.5 * self._hb.dot(rates)
        centre, D = system.chart.integrate(x.q, half), self._centred.dot(rates)
        for i, c in enumerate(self._times):
            q = system.chart.integrate(centre, D[i])
            self._accelerate(x.t + c, q, V[i], u, self._r[i])
            self._r[i] -= K[i]
        self._q1 = system.chart.integrate(centre, half)
        return moved
