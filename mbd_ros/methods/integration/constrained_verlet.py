"""A kick and a move onto position constraints, which SHAKE and RATTLE share.

    q+ = q (+) h w,   w = v + h/2 a + M(q)^-1 J(q)' mu   with the mu of g(q+) = 0

mu is found by Newton's method with the rows of the start, or of the end where these have turned.
Source: E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2006, sec. VII.1.4.
"""

from math import isfinite
from typing import NamedTuple

import numpy as np

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.rows.delassus import RowFactor
from mbd_ros.core.state import Array, Memory, State, copied, have_same_bits
from mbd_ros.core.thresholds import ASSEMBLED, redundant
from mbd_ros.errors import DivergedError
from mbd_ros.methods.integration.newton import FAILED, converge

_CHORD = 10  # corrections with the rows at the start of the step; more means that they turned
_NEWTON = 20
_FORESEEN = 1.0e-2  # of the tolerance: what a last correction, by its contraction, leaves
_VELOCITY = 1.0e-10  # [m/s, rad/s], relative above 1: where the iteration of a(q, v) may stop

_KEPT = ("_s", "_s_before", "_stretch")


class PositionStep(NamedTuple):
    """Length of a step and the time it ends at [s]."""

    h: float
    t: float


class Configuration:
    """Masses and rows at one configuration, evaluated and factorised once.

    Args:
        t: Time [s].
        q: Configuration, shape (nq,).
        unit: Unit matrix, shape (m, m).

    Attributes:
        lift: M^-1 J' (J M^-1 J')^-1, the least velocity that changes g' by 1, shape (nv, m).
    """

    def __init__(self, system: System, t: float, q: Array, unit: Array) -> None:
        self.t, self.q = t, q
        self._mass = system.mass(q)
        if system.rows:
            self._J, self._rate = system.jacobian(t, q), system.rate(t, q)
            factor = RowFactor(self._mass.dense, self._J)
            self.lift: Array = factor.motion(unit)

    def respond(self, force: Array) -> Array:
        """Return M^-1 force, shape (nv,)."""
        return self._mass.solve(force)

    def project(self, v: Array) -> Array:
        """Return the nearest velocity, in the mass metric, with J v + dg/dt = 0."""
        nearest: Array = v - self.lift.dot(self._J.dot(v) + self._rate)
        return nearest


class ConstrainedVerlet:
    """A kick and a move that ends on the constraints.

        w = v + kick M^-1 f(t, q, v + share (w - v)) - lift s,   g(t + h, q (+) h w) = 0

    M^-1 J' mu is written as -lift s, where s [m/s, rad/s] is the correction of g'.

    Args:
        name: Of the method, for messages.
        tolerance: |g| from which one more correction is the last [m, rad].
    """

    def __init__(self, system: System, name: str, tolerance: float) -> None:
        self._system, self._name, self._tolerance = system, name, tolerance
        self._unit = np.eye(len(system.rows))
        self.restart()

    def restart(self) -> None:
        """Forget corrections and the last configuration."""
        self._s = self._s_before = np.zeros(len(self._system.rows))
        self._stretch = 1.0
        self._here: Configuration | None = None

    def checkpoint(self) -> Memory:
        """Return corrections of the last step, from which the next one starts."""
        return {name: copied(getattr(self, name)) for name in _KEPT}

    def restore(self, checkpoint: Memory) -> None:
        """Continue from a checkpoint."""
        self.restart()
        for name, value in checkpoint.items():
            setattr(self, name, copied(value))

    def at(self, t: float, q: Array) -> Configuration:
        """Masses and rows at a configuration; those of the last call where it is the same."""
        here = self._here
        if here is None or here.q is not q or here.t != t:
            here = self._here = Configuration(self._system, t, q, self._unit)
        return here

    def advance(
        self,
        x: State,
        u: Array | None,
        move: PositionStep,
        kick: float,
        share: float,
        force: Array,
    ) -> tuple[Array, Array]:
        """Return the velocity w of the step and the configuration it leads to.

        Args:
            move: Length of the step and the time it ends at [s].
            kick: [s].
            share: How much of w the velocity in f has.
            force: f to begin with, that of the solution if f does not depend on the velocity.

        Raises:
            DivergedError: An iteration does not converge.
        """
        here, applied = self.at(x.t, x.q), self._system.applied
        first = 2.0 * self._s - self._s_before
        s, w, q = self._move(here, x.v + kick * here.respond(force), first, move)
        if share:
            now = applied(x.t, x.q, x.v + share * (w - x.v), u)
            if not have_same_bits(now, force):
                s, w, q = self._settle(x, u, move, kick, share, (s, w, now))
        if not isfinite(w.dot(w)):
            raise DivergedError(f"{self._name}: velocities after t = {x.t:.9g} s are not finite")
        self._s_before, self._s = self._s, s
        return w, q

    def _settle(
        self,
        x: State,
        u: Array | None,
        move: PositionStep,
        kick: float,
        share: float,
        first: tuple[Array, Array, Array],
    ) -> tuple[Array, Array, Array]:
        """Fixed point of forces that depend on the velocity, from s, w and the force there."""
        here, (s, w, force), q = self.at(x.t, x.q), first, x.q

        def correct() -> float:
            nonlocal s, w, q, force
            last = w
            s, w, q = self._move(here, x.v + kick * here.respond(force), s, move)
            force = self._system.applied(x.t, x.q, x.v + share * (w - x.v), u)
            return float(np.abs(w - last).max())

        if converge(correct, _VELOCITY * max(1.0, float(np.abs(x.v).max()))) == FAILED:
            raise DivergedError(
                f"{self._name}: forces that depend on the velocity change too much in the step "
                f"from t = {x.t:.9g} s by {move.h:g} s; try a smaller dt or an implicit method"
            )
        return s, w, q

    def _move(
        self, here: Configuration, w: Array, s: Array, move: PositionStep
    ) -> tuple[Array, Array, Array]:
        """Return the s, w - lift s and the configuration, with g = 0 there.

        The rows at the start serve as derivatives. The observed contraction, also that of the last
        step, lengthens or shortens corrections (Aitken), which for one row is the secant method.
        """
        (h, t), integrate, q0 = move, self._system.chart.integrate, here.q
        if not self._system.rows:
            return s, w, integrate(q0, h * w)
        lift, residual = here.lift, self._system.residual
        last, left, stretch = None, 1.0, self._stretch
        for _ in range(_CHORD):
            g = residual(t, integrate(q0, h * (w - lift.dot(s))))
            if last is not None:
                left = float(g.dot(last)) / float(last.dot(last))
                if not abs(left) < 0.5:
                    break
                stretch /= 1.0 - left
            s = s + (stretch / h) * g
            size = max(map(abs, g.tolist()))
            if size <= self._tolerance or size * abs(left) <= _FORESEEN * self._tolerance:
                self._stretch, v = stretch, w - lift.dot(s)
                return s, v, integrate(q0, h * v)
            last = g
        self._stretch = 1.0
        return self._move_by_newton(here, w, s, move)

    def _move_by_newton(
        self, here: Configuration, w: Array, s: Array, move: PositionStep
    ) -> tuple[Array, Array, Array]:
        """Move with fresh rows in every correction, for rows that turn within the step."""
        (h, t), system, lift, worst, last = move, self._system, here.lift, 0, np.inf
        for _ in range(_NEWTON):
            q = system.chart.integrate(here.q, h * (w - lift.dot(s)))
            g = system.residual(t, q)
            worst = int(np.argmax(np.abs(g)))
            if not isfinite(g[worst]):
                break
            slope = h * system.jacobian(t, q).dot(lift)
            s = s + np.linalg.lstsq(slope, g, rcond=redundant(len(g)))[0]
            size = abs(float(g[worst]))
            if size <= self._tolerance or (size <= ASSEMBLED and size >= 0.5 * last):
                v = w - lift.dot(s)
                return s, v, system.chart.integrate(here.q, h * v)
            last = size
        raise DivergedError(
            f"{self._name}: no step from t = {here.t:.9g} s by {h:g} s ends on the constraints; "
            f"row {system.rows[worst].name} stays {g[worst]:.3g} open; try a smaller dt"
        )
