"""The force that lacks for the equation of motion, from native code."""

from typing import TYPE_CHECKING

import numpy as np

from mbd_ros.compiled.build.library import NativeFunction
from mbd_ros.core.state import Array

if TYPE_CHECKING:
    from mbd_ros.compiled.runs.compiled_system import CompiledSystem


class CompiledBalance:
    """As `mbd_ros.core.dynamics.residual_force.Balance`, with slopes to rounding.

    Args:
        system: The system.
        force: The native function `balance`.
        slopes: The native function `balance_slopes`.
        size: nv, or nv + nz where internal states stand beside velocities.
    """

    def __init__(
        self, system: "CompiledSystem", force: NativeFunction, slopes: NativeFunction, size: int
    ) -> None:
        self._system, self._force, self._slopes = system, force, slopes
        self._nq, self._nv, self._size = system.system.nq, system.system.nv, size

    def force(self, t: float, q: Array, v: Array, u: Array | None, a: Array, lam: Array) -> Array:
        """As `Balance.force`."""
        self._call(self._force, t, q, v, u, a, lam)
        force, rates = self._force.results
        if self._size == self._nv:
            return force.copy()
        return np.concatenate((force, rates - a[self._nv :]))

    def slopes(
        self, t: float, q: Array, v: Array, u: Array | None, a: Array, lam: Array
    ) -> tuple[Array, Array]:
        """As `Balance.slopes`."""
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
