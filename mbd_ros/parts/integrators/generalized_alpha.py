"""Generalized-alpha for multibody systems of index 3."""

import math
from typing import Any

import numpy as np

from mbd_ros.core.dynamics.linearization import balance_of
from mbd_ros.core.state import Array, State, have_same_bits
from mbd_ros.core.thresholds import redundant
from mbd_ros.errors import DivergedError, ModelError
from mbd_ros.methods.integration.newton import FAILED, SLOW, converge, refuse_bounded_rows
from mbd_ros.methods.integration.stepping import Integrator, Stepper, clip


class GeneralizedAlpha(Integrator):
    """Second order, with numerical damping of what the step does not resolve.

    With the algorithmic acceleration a and the true one v', at the end of the step

        M v' = tau - h + J' lam,   g(t, q) = 0,
        (1 - alpha_m) a+ + alpha_m a = (1 - alpha_f) v'+ + alpha_f v'
        q+ = q (+) h (v + (1/2 - beta) h a + beta h a+),   v+ = v + (1 - gamma) h a + gamma h a+

    The positions keep the constraints; the velocities keep them to O(h^2) only, but rows of
    velocities, J v+ + rate = 0, to the tolerance. Force equations
    and multipliers are scaled by beta h^2 and by the masses, so that the condition of the Newton
    matrix does not depend on the step. Redundant rows are allowed. One-sided rows are refused.

    Args:
        spectral_radius: Factor by which one step shortens infinitely fast motion, 0 <= . < 1.
        tolerance: Of the positions [m, rad], relative above 1; iterations go on below it while
            they gain.

    Source: Arnold, Bruels, Multibody System Dynamics 18, 2007, 185-202; on manifolds: Bruels,
        Cardona, J. Comput. Nonlinear Dyn. 5, 2010, 031002; scaling: Bottasso, Dopico, Trainelli,
        Multibody System Dynamics 19, 2008, 3-20.
    """

    order = 2
    keeps_constraints = True
    is_explicit = False
    compiled_functions = ("accelerate", "balance", "balance_slopes")
    example = {"spectral_radius": 0.9}

    def __init__(self, *, spectral_radius: float = 0.9, tolerance: float = 1.0e-10) -> None:
        if not 0.0 <= spectral_radius < 1.0:
            raise ModelError(f"spectral_radius {spectral_radius:g}, accepted: 0 <= . < 1")
        if not 0.0 < tolerance < 1.0:
            raise ModelError(f"tolerance {tolerance:g}, accepted: between 0 and 1")
        self.spectral_radius = spectral_radius
        self.tolerance = tolerance

    def prepare(self, system: Any, dt: float) -> Stepper:
        """Return a stepper for one system and one step size [s].

        Raises:
            ModelError: The system has one-sided rows.
        """
        refuse_bounded_rows(system, "generalized_alpha")
        return _Steps(self, system, dt)


class _Steps(Stepper):
    checkpoint_fields = (
        "_h",
        "_is_slow",
        "_a0",
        "_vdot0",
        "_lam0",
        "_inverse",
        "_of_q",
        "_of_g",
        "_u",
    )

    def __init__(self, method: GeneralizedAlpha, system: Any, dt: float) -> None:
        self._system = system
        self._dt = dt
        self._tolerance = method.tolerance
        self._bilateral = system.bilateral
        self._is_rate = system.bilateral.constraints.is_rate
        self._has_rates = bool(self._is_rate.any())
        self._accelerate = system.accelerator()
        rho = method.spectral_radius
        self._am = (2.0 * rho - 1.0) / (rho + 1.0)
        self._af = rho / (rho + 1.0)
        self._gamma = 0.5 + self._af - self._am
        self._beta = 0.25 * (self._gamma + 0.5) ** 2
        self._ratio = (1.0 - self._am) / (1.0 - self._af)  # dv'+ / da+
        nv, size = system.nv, system.nv + len(system.bilateral.rows)
        self._a0, self._vdot0, self._of_q = np.zeros((3, nv))
        self._lam0, self._of_g = np.zeros((2, size - nv))
        self._inverse = np.eye(size)
        self._r = np.zeros(size)
        self._balance = balance_of(system)
        self.restart()

    def restart(self) -> None:
        """Forget accelerations and derivatives."""
        self._h, self._is_slow = 0.0, True
        self._u: Array | None = None

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by one step."""
        h, t = clip(x.t, self._dt, end)
        if h != self._h:
            self._start(x, u, h)
        elif not have_same_bits(u, self._u):  # the accelerations jump with the commands
            self._vdot0 = self._a0 = self._acceleration(x, u)
        self._u = None if u is None else u.copy()
        self._begin(x, h)
        rate = FAILED if self._is_slow else self._solve(x, u, t)
        if rate == FAILED:
            self._begin(x, h)
            self._refresh(x, u, t)
            rate = self._solve(x, u, t)
        if rate == FAILED:
            self.restart()
            raise DivergedError(
                f"generalized-alpha: the step from t = {x.t:.9g} s by {h:g} s does not converge; "
                "try a smaller dt"
            )
        self._is_slow = rate > SLOW
        self._a0, self._vdot0, self._lam0 = self._a, self._vdot, self._lam
        return State(t, self._q, self._v)

    def _start(self, x: State, u: Array | None, h: float) -> None:
        """Accelerations to begin with.

        That a belongs to t + (alpha_m - alpha_f) h is left out: extrapolating v' would blow up
        fast motion, and the order of q and v does not need it.
        """
        self._h, self._is_slow = h, True
        self._vdot0 = self._a0 = self._acceleration(x, u)
        self._lam0 = np.zeros(len(self._bilateral.rows))

    def _begin(self, x: State, h: float) -> None:
        """Set the parts of the step that do not depend on a+, and a first guess of a+."""
        self._D0 = h * x.v + (0.5 - self._beta) * h * h * self._a0
        self._v0 = x.v + (1.0 - self._gamma) * h * self._a0
        left = self._am * self._a0 - self._af * self._vdot0
        self._vdot_free = left / (1.0 - self._af)
        self._a = (self._vdot0 - self._vdot_free) / self._ratio
        self._lam = self._lam0.copy()

    def _evaluate(self, x: State) -> None:
        """State and accelerations at the end of the step for the current a+."""
        h = self._h
        self._q = self._system.chart.integrate(x.q, self._D0 + (self._beta * h * h) * self._a)
        self._v = self._v0 + (self._gamma * h) * self._a
        self._vdot = self._vdot_free + self._ratio * self._a

    def _acceleration(self, x: State, u: Array | None) -> Array:
        a: Array = np.empty(self._system.nv)
        self._accelerate(x.t, x.q, x.v, u, a)
        return a

    def _refresh(self, x: State, u: Array | None, t: float) -> None:
        """Inverse of the scaled matrix of positions and multipliers at the predicted state."""
        system, n, hh = self._system, self._system.nv, self._beta * self._h**2
        self._evaluate(x)
        M = system.mass(self._q).dense
        stiffness, damping = self._balance.slopes(t, self._q, self._v, u, self._vdot, self._lam)
        J = self._bilateral.jacobian(t, self._q) if self._bilateral.rows else np.zeros((0, n))
        self._of_q = 1.0 / np.sqrt(M.diagonal())
        J = J * self._of_q
        size = np.sqrt((J * J).sum(axis=1))
        self._of_g = 1.0 / np.where(size > 0.0, size, 1.0)
        J = self._of_g[:, None] * J
        K = self._ratio * M - (self._gamma * self._h) * damping - hh * stiffness
        matrix = np.zeros((n + len(J), n + len(J)))
        matrix[:n, :n] = self._of_q[:, None] * K * self._of_q
        matrix[:n, n:], matrix[n:, :n] = -J.T, J
        if not np.isfinite(matrix).all():
            raise DivergedError(f"generalized-alpha: forces at t = {t:.9g} s are not finite")
        self._inverse = np.linalg.pinv(matrix, rcond=redundant(len(matrix)))

    def _solve(self, x: State, u: Array | None, t: float) -> float:
        r, n = self._r, self._system.nv
        hh = self._beta * self._h**2
        force_scale, of_a, of_lam = hh * self._of_q, self._of_q / hh, self._of_g / hh

        def correct() -> float:
            self._evaluate(x)
            force = self._balance.force(t, self._q, self._v, u, self._vdot, self._lam)
            r[:n] = force_scale * force
            if self._bilateral.rows:
                r[n:] = -self._of_g * self._off(t)
            z = self._inverse.dot(r)
            self._a = self._a + of_a * z[:n]
            self._lam += of_lam * z[n:]
            return float(np.abs(self._of_q * z[:n]).max())

        scale = max(1.0, float(np.abs(x.q).max()))
        rate = converge(correct, self._tolerance * scale)
        self._evaluate(x)
        return rate

    def _off(self, t: float) -> Array:
        """Return the residuals of the rows as positions; rates count beta h / gamma."""
        g = self._bilateral.residual(t, self._q)
        if self._has_rates:
            rate = self._bilateral.jacobian(t, self._q).dot(self._v) + self._bilateral.rate(
                t, self._q
            )
            g = np.where(self._is_rate, (self._beta * self._h / self._gamma) * rate, g)
        return g
