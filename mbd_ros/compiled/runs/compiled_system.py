"""A system whose accelerations and derivatives come from native code."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbd_ros.compiled.build.library import Library, NativeFunction
from mbd_ros.compiled.symbols.trace import Traced
from mbd_ros.core.dynamics.system import Accelerator, Derivatives, System
from mbd_ros.core.state import NONE, Array, Mode, State


class CompiledSystem:
    """System with accelerations, derivatives and the residual force in native code.

    Everything else is delegated to the plain system, as are states with a mode and states at which
    rows are too close to dependent for a factorization without pivoting.

    Args:
        system: The plain system.
        traced: Symbolic form of the system.
        library: Library of the compiled functions.
        p: Values of the parameters, shape (np,).
    """

    def __init__(self, system: System, traced: Traced, library: Library, p: Array = NONE) -> None:
        self.system = system
        self._library = library
        self._traced = traced
        self._p = p
        self._native = self._function("accelerate")
        self._plain = system.accelerator()
        self._has_internals, self._has_inputs = bool(traced.nz), bool(traced.nu)
        self._slopes: NativeFunction | None = None
        self.calls = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.system, name)

    @property
    def evaluations(self) -> int:
        """Number of evaluations of the equations of motion."""
        return self.system.evaluations + self.calls

    def accelerator(self, mode: Mode = ()) -> Accelerator:
        """Return the function of t, q, v, u that writes y'' in a mode, shape (nv,)."""
        if mode:
            return self.system.accelerator(mode)
        return self._accelerate_with_rates if self._has_internals else self._accelerate

    def derivatives(self, y: State, u: Array | None = None, *, inputs: bool = True) -> Derivatives:
        """Return the exact derivatives of y'', see `System.derivatives`."""
        if y.mode or not self._is_sound(y.t, y.q, y.v, y.z, u):
            return self.system.derivatives(y, u, inputs=inputs)
        by_q, by_v, by_z, by_u, by_p = self._tables(y, u)
        for at, _ in self.system.loads.sources.smooth:
            by_u[:, at] = 0.0  # sources determine these inputs, not u
        if not inputs:
            by_u = by_u[:, :0]
        n = self.system.nv
        parts = [
            Derivatives(*(table[at] for table in (by_q, by_v, by_z, by_u)), p=by_p[at])
            for at in (slice(n), slice(n, None))
        ]
        return parts[0]._replace(rates=parts[1] if self._has_internals else None)

    def balance(self, extended: Any) -> CompiledBalance:
        """Return the residual force of this system, or of its form with internal states."""
        names = "balance", "balance_slopes"
        force, slopes = (self._function(name) for name in names)
        return CompiledBalance(self, force, slopes, extended.nv)

    def inputs(self, t: float, u: Array | None) -> Array:
        """Return all inputs at a time, shape (nu,)."""
        if not self._has_inputs:
            return NONE
        return self.system.loads.inputs(State(t, NONE, NONE), u)

    def with_loads(self, loads: Any) -> System:
        """Return a plain system with the same robot and rows and other loads."""
        return self.system.with_loads(loads)

    def _function(self, name: str) -> NativeFunction:
        native = self._library.function(name)
        native.arguments[5][...] = self._p
        return native

    def _tables(self, y: State, u: Array | None) -> list[Array]:
        """Return derivatives of accelerations and rates with respect to q, v, z, u and p."""
        if self._slopes is None:
            self._slopes = self._function("derivatives")
        native, sizes = self._slopes, self._traced
        values = y.t, y.q, y.v, y.z, self.inputs(y.t, u)
        for argument, value in zip(native.arguments[:5], values, strict=True):
            argument[...] = value
        native()
        self.calls += 1
        rows = sizes.nv + sizes.nz
        widths = sizes.nv, sizes.nv, sizes.nz, sizes.nu, sizes.np
        return [_table(values, rows, m) for values, m in zip(native.results, widths, strict=True)]

    def _is_sound(self, t: float, q: Array, v: Array, z: Array, u: Array | None) -> bool:
        """Evaluate the native function, and return whether its accelerations are reliable."""
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
    """Return a new matrix from consecutive columns."""
    return np.array(values[: rows * columns].reshape(columns, rows).T)


class CompiledBalance:
    """Residual force of the equation of motion with its derivatives, like `linearization.Balance`.

    Args:
        force: The native function `balance`.
        slopes: The native function `balance_slopes`.
        size: nv, or nv + nz if internal states extend the velocities.
    """

    def __init__(
        self, system: CompiledSystem, force: NativeFunction, slopes: NativeFunction, size: int
    ) -> None:
        self._system, self._force, self._slopes = system, force, slopes
        self._nq, self._nv, self._size = system.system.nq, system.system.nv, size

    def force(self, t: float, q: Array, v: Array, u: Array | None, a: Array, lam: Array) -> Array:
        """Return the residual force, shape (nv,)."""
        self._call(self._force, t, q, v, u, a, lam)
        force, rates = self._force.results
        if self._size == self._nv:
            return force.copy()
        return np.concatenate((force, rates - a[self._nv :]))

    def slopes(
        self, t: float, q: Array, v: Array, u: Array | None, a: Array, lam: Array
    ) -> tuple[Array, Array]:
        """Return its derivatives by tangent steps of q and by v, shape (nv, nv) each."""
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
