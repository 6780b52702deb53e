"""A system whose accelerations and derivatives come from native code."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbd_ros.compiled.build.library import Library, NativeFunction
from mbd_ros.compiled.symbols.trace import Traced
from mbd_ros.core.dynamics.system import Accelerator, Derivatives, System
from mbd_ros.core.state import NONE, Array, Mode, State


class CompiledSystem:
    """Accelerations, derivatives and what lacks for the equation of motion, in native code.

    Whatever else is asked of it is that of the system. So are states at which rows are too near to
    dependent for a factor without pivoting, and those with a mode.

    Args:
        traced: Its symbolic form.
        library: What `ImplicitMethod.asks` of it was compiled to.
        p: Values of the parameters, shape (np,).
    """

    def __init__(self, system: System, traced: Traced, library: Library, p: Array = NONE) -> None:
        self.system, self._library, self._traced, self._p = system, library, traced, p
        self._native = self._function("accelerate")
        self._plain = system.accelerator()
        self._has_internals, self._has_inputs = bool(traced.nz), bool(traced.nu)
        self._slopes: NativeFunction | None = None
        self.calls = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.system, name)

    @property
    def evaluations(self) -> int:
        """How often the equations of motion were asked."""
        return self.system.evaluations + self.calls

    def accelerator(self, mode: Mode = ()) -> Accelerator:
        """The function of t, q, v, u that writes y'' in a mode, shape (nv,)."""
        if mode:
            return self.system.accelerator(mode)
        return self._accelerate_with_rates if self._has_internals else self._accelerate

    def derivatives(self, y: State, u: Array | None = None, *, inputs: bool = True) -> Derivatives:
        """Derivatives of y'' to rounding; as `System.derivatives`."""
        if y.mode or not self._is_sound(y.t, y.q, y.v, y.z, u):
            return self.system.derivatives(y, u, inputs=inputs)
        by_q, by_v, by_z, by_u, by_p = self._tables(y, u)
        for at, _ in self.system.loads.sources.smooth:
            by_u[:, at] = 0.0  # these are given by sources, not by u
        if not inputs:
            by_u = by_u[:, :0]
        n = self.system.nv
        parts = [
            Derivatives(*(one[at] for one in (by_q, by_v, by_z, by_u)), p=by_p[at])
            for at in (slice(n), slice(n, None))
        ]
        return parts[0]._replace(rates=parts[1] if self._has_internals else None)

    def balance(self, whole: Any) -> CompiledBalance:
        """The residual force of this system, or of it with internal states."""
        names = "balance", "balance_slopes"
        force, slopes = (self._function(name) for name in names)
        return CompiledBalance(self, force, slopes, whole.nv)

    def inputs(self, t: float, u: Array | None) -> Array:
        """All inputs at a time, shape (nu,)."""
        if not self._has_inputs:
            return NONE
        return self.system.loads.inputs(State(t, NONE, NONE), u)

    def with_loads(self, loads: Any) -> System:
        """The same robot and rows for other loads, not compiled."""
        return self.system.with_loads(loads)

    def _function(self, name: str) -> NativeFunction:
        native = self._library.function(name)
        native.arguments[5][...] = self._p
        return native

    def _tables(self, y: State, u: Array | None) -> list[Array]:
        """Slopes of accelerations and rates by q, v, z, u and p."""
        if self._slopes is None:
            self._slopes = self._function("derivatives")
        native, of = self._slopes, self._traced
        values = y.t, y.q, y.v, y.z, self.inputs(y.t, u)
        for argument, value in zip(native.arguments[:5], values, strict=True):
            argument[...] = value
        native()
        self.calls += 1
        rows, widths = of.nv + of.nz, (of.nv, of.nv, of.nz, of.nu, of.np)
        return [_table(one, rows, m) for one, m in zip(native.results, widths, strict=True)]

    def _is_sound(self, t: float, q: Array, v: Array, z: Array, u: Array | None) -> bool:
        """Whether the native function has computed accelerations at a state."""
        native = self._native
        in_t, in_q, in_v, in_z, in_u, _ = native.arguments
        in_t[0], in_q[...], in_v[...] = t, q, v
        if self._has_internals:
            in_z[...] = z
        if self._has_inputs:
            in_u[...] = self.inputs(t, u)
        native()
        self.calls += 1
        return bool(native.results[2][0] > self._traced.least_health)

    def _accelerate(self, t: float, q: Array, v: Array, u: Array | None, out: Array) -> None:
        if self._is_sound(t, q, v, NONE, u):
            out[...] = self._native.results[0]
        else:
            self._plain(t, q, v, u, out)

    def _accelerate_with_rates(
        self, t: float, q: Array, v: Array, z: Array, u: Array | None, a_out: Array, z_out: Array
    ) -> None:
        if self._is_sound(t, q, v, z, u):
            a_out[...], z_out[...] = self._native.results[:2]
        else:
            self._plain(t, q, v, z, u, a_out, z_out)


def _table(values: Array, rows: int, columns: int) -> Array:
    """A new matrix from the columns that a native function has written one after the other."""
    return np.array(values[: rows * columns].reshape(columns, rows).T)


class CompiledBalance:
    """Residual force of the equation of motion and its slopes, as `linearization.Balance`.

    Args:
        force: The native function `balance`.
        slopes: The native function `balance_slopes`.
        size: nv, or nv + nz where internal states stand beside velocities.
    """

    def __init__(
        self, system: CompiledSystem, force: NativeFunction, slopes: NativeFunction, size: int
    ) -> None:
        self._system, self._force, self._slopes = system, force, slopes
        self._nq, self._nv, self._size = system.system.nq, system.system.nv, size

    def force(self, t: float, q: Array, v: Array, u: Array | None, a: Array, lam: Array) -> Array:
        """The f, shape (nv,)."""
        self._call(self._force, t, q, v, u, a, lam)
        force, rates = self._force.results
        if self._size == self._nv:
            return force.copy()
        return np.concatenate((force, rates - a[self._nv :]))

    def slopes(
        self, t: float, q: Array, v: Array, u: Array | None, a: Array, lam: Array
    ) -> tuple[Array, Array]:
        """Of f by steps in the tangent of q and by v, each of shape (nv, nv)."""
        self._call(self._slopes, t, q, v, u, a, lam)
        n, size = self._nv, self._size
        by_q, by_v = np.zeros((2, size, size))
        places = by_q[:, :n], by_v[:, :n], by_v[:, n:]
        for values, place in zip(self._slopes.results, places, strict=True):
            width = place.shape[1]
            place[...] = values[: size * width].reshape(width, size).T
        return by_q, by_v

    def _call(
        self,
        native: NativeFunction,
        t: float,
        q: Array,
        v: Array,
        u: Array | None,
        a: Array,
        lam: Array,
    ) -> None:
        n = self._nv
        values = t, q[: self._nq], v[:n], v[n:], self._system.inputs(t, u)
        for argument, value in zip(native.arguments[:5], values, strict=True):
            argument[...] = value
        native.arguments[6][...], native.arguments[7][...] = a[:n], lam
        native()
        self._system.calls += 1
