"""Checks of motion by the laws of mechanics, beside the code that computed it.

M a + h - tau - J' lam = 0    by Newton-Euler (rnea), J by differences of g
g'' = 0                       by differences of g along q + s v + s^2 a / 2
lower <= lam <= upper, w lam  of bounded rows
E(t) - E(0) = work            of everything but gravity and joint springs, by quadrature
"""

import math
from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.applications.report.stability.oracle_forces import OracleForces
from mbd_ros.applications.report.stability.oracle_rows import bilateral_rows, bounded_rows
from mbd_ros.applications.report.stability.scene_text import LoadedScene
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import Array, State

_STEP = 1.0e-6  # rad or m, of central differences
_BALANCE = 1.0e-6  # of the terms of an equation of motion; differences of g leave 1e-9
_ROUNDED = 1.0e-8  # of the largest terms, within which small ones drown: times `_BALANCE`
_NOISE = 1.0e-3  # error of J by differences, in `_BALANCE`
_SECOND = 1.0e-5  # of the terms of g''
_FAR = 4.0e-3  # of the time in which a joint moves by one: truncation and rounding are alike
_COMPLEMENTARY = 1.0e-6
_STENCIL = ((-2, -1.0), (-1, 16.0), (0, -30.0), (1, 16.0), (2, -1.0))  # twelfths


class Oracle:
    """The equations of a scene, evaluated independently.

    Args:
        loaded: The scene.
    """

    def __init__(self, loaded: LoadedScene) -> None:
        self.robot = loaded.scene.robot
        self._model, self._data = self.robot.model, self.robot.model.createData()
        self._rows, self._bounded = bilateral_rows(loaded), bounded_rows(loaded)
        self._forces = OracleForces(loaded)

    def residual(self, t: float, q: Array) -> Array:
        """Residual g of couplings and bilateral constraints, shape (m,)."""
        pin.forwardKinematics(self._model, self._data, q)
        return np.concatenate([[], *(rows(self._data, t, q) for rows in self._rows)])

    def violation(self, x: State) -> float:
        """Largest |g| [m or rad]."""
        return float(np.abs(self.residual(x.t, x.q)).max(initial=0.0)) if self._rows else 0.0

    def rate(self, x: State) -> float:
        """Largest |g'| [m/s or rad/s]."""
        if not self._rows:
            return 0.0
        s = _STEP / max(1.0, float(np.abs(x.v).max()))
        change = self._along(x, x.v, s) - self._along(x, x.v, -s)
        return float(np.abs(change).max()) / (2.0 * s)

    def energy(self, x: State) -> tuple[float, float]:
        """Kinetic and stored potential energy [J]."""
        return self._forces.stored(x)

    def power(self, system: System, y: State) -> float:
        """Work that everything but gravity and joint springs does per time [W].

        Args:
            system: The system that solves for the multipliers.
            y: State of its integrated coordinates.
        """
        x, (a, lam, bounded) = system.expand(y), self._solved(system, y)
        power = float(self._forces.not_stored(x).dot(x.v))
        if self._rows:
            s = _STEP / max(1.0, float(np.abs(x.v).max()))
            moved = self._along(x, x.v, s, x.t) - self._along(x, x.v, -s, x.t)
            power += float(lam.dot(moved)) / (2.0 * s)
        for row, value in zip(self._bounded or (), bounded, strict=False):
            power += row.margin(x, a)[0] * value * float(x.v[row.v])
        return power

    def complaints(self, system: System, y: State) -> list[str]:
        """Faults of the accelerations and multipliers that a system finds.

        Args:
            system: The system.
            y: Consistent state of its integrated coordinates.
        """
        x, (a, lam, bounded) = system.expand(y), self._solved(system, y)
        if not (np.isfinite(a).all() and np.isfinite(lam).all() and np.isfinite(bounded).all()):
            return ["accelerations or multipliers are not finite"]
        found = [self._row_motion(x, a)] if self._rows else []
        if self._bounded is not None:
            found += [self._balance(x, a, lam, bounded), *self._bounds(x, a, bounded)]
        return [text for text in found if text]

    def _solved(self, system: System, y: State) -> tuple[Array, Array, Array]:
        """Accelerations, multipliers of bilateral and of bounded rows."""
        _, a, _, lam, _ = system.evaluate(system.expand(y))
        parts = (
            [lam[block.slots] for block in system.layout.rigid],
            [lam[block.slots] for block in system.layout.yielding],
        )
        rigid, yielding = (np.concatenate([lam[:0], *part]) for part in parts)
        return a, rigid, yielding

    def _balance(self, x: State, a: Array, lam: Array, bounded: Array) -> str:
        model, data, size = self._model, self._data, np.abs
        pushed, scale = np.zeros(model.nv), np.zeros(model.nv)
        if self._rows:
            J = self._jacobian(x)
            pushed, scale = lam.dot(J), size(lam).dot(size(J)) + _NOISE * size(lam).sum()
        for row, value in zip(self._bounded or (), bounded, strict=True):
            pushed[row.v] += row.margin(x, a)[0] * value
            scale[row.v] += abs(value)
        tau = self._forces.total(x)
        h = pin.rnea(model, data, x.q, x.v, np.zeros(model.nv))
        left = pin.rnea(model, data, x.q, x.v, a) - tau - pushed
        M = pin.crba(model, data, x.q)
        scale += size(M).dot(size(a)) + size(h) + size(tau)
        scale += _ROUNDED * scale.max()
        worst = int(np.argmax(size(left) / (scale + 1.0e-12)))
        if size(left[worst]) <= _BALANCE * scale[worst] + 1.0e-12:
            return ""
        return (
            f"equation of motion {worst} is {left[worst]:.3g} off, {scale[worst]:.3g} in all, "
            f"at t = {x.t:.6g} s"
        )

    def _row_motion(self, x: State, a: Array) -> str:
        """Text if g'' does not vanish."""
        pace = float(np.abs(x.v).sum()) + math.sqrt(float(np.abs(a).sum())) + 1.0e-3
        s = _FAR / pace
        bent = sum(c * self._path(x, a, k * s) for k, c in _STENCIL) / (12.0 * s * s)
        worst = int(np.argmax(np.abs(bent)))
        if abs(bent[worst]) <= _SECOND * pace * pace:
            return ""
        return (
            f"row {worst} accelerates by {bent[worst]:.3g} where joints do by "
            f"{np.abs(a).max():.3g}, at t = {x.t:.6g} s"
        )

    def _bounds(self, x: State, a: Array, lam: Array) -> list[str]:
        texts = []
        for row, value in zip(self._bounded or (), lam, strict=True):
            _, w = row.margin(x, a)
            lower, upper = row.limits
            slack = _COMPLEMENTARY * (1.0 + abs(value))
            near = _COMPLEMENTARY * (1.0 + float(np.abs(a).max()) + sum(row.gains))
            pushes, pulls = value > lower + slack, value < upper - slack
            is_inside = lower - slack <= value <= upper + slack
            if not is_inside or (w > near and pushes) or (w < -near and pulls):
                text = f"bounded row at velocity {row.v}: w = {w:.3g} with multiplier {value:.3g}"
                texts.append(f"{text}, at t = {x.t:.6g} s")
        return texts

    def _jacobian(self, x: State) -> Array:
        """Central differences dg/dq, shape (m, nv)."""
        columns = []
        for direction in np.eye(self._model.nv):
            change = self._along(x, direction, _STEP, x.t) - self._along(x, direction, -_STEP, x.t)
            columns.append(change / (2.0 * _STEP))
        return np.array(columns).T

    def _along(self, x: State, v: Array, s: float, t: float | None = None) -> Array:
        """Residual at q + s v, at the time x.t + s or t."""
        return self.residual(x.t + s if t is None else t, self._moved(x.q, s * v))

    def _path(self, x: State, a: Array, s: float) -> Array:
        return self.residual(x.t + s, self._moved(x.q, s * x.v + 0.5 * s * s * a))

    def _moved(self, q: Array, dq: Array) -> Any:
        return pin.integrate(self._model, q, dq)
