"""Derivatives of forces or accelerations, for Newton's method."""

from collections.abc import Callable

import numpy as np

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import Array, State

Field = Callable[[float, Array, Array, "Array | None"], Array]
_STEP = 1.5e-8  # square root of the rounding unit: truncation and rounding are alike
_SPACINGS = 4.0  # of the numbers around a position: a shorter step of it is rounding


class Linearization:
    """Forward differences of f(t, q, v, u), shape (nv,), on the configuration manifold.

    f(t, q (+) dq, v + dv, u) = f + stiffness dq + damping dv, to about 1e-6 of f. Costs 2 nv + 1
    evaluations.

    Args:
        system: The system of these configurations.
        field: The f; what it returns is copied.

    Attributes:
        stiffness: df/dq at the last update, shape (nv, nv); a new array each time.
        damping: df/dv, same shape.
    """

    def __init__(self, system: System, field: Field) -> None:
        self._system, self._field = system, field
        self._step = np.zeros(system.nv)
        self.stiffness = np.zeros((system.nv, system.nv))
        self.damping = np.zeros((system.nv, system.nv))

    def update(self, t: float, q: Array, v: Array, u: Array | None) -> None:
        """Differentiate at a state."""
        field, step = self._field, self._step
        base = np.array(field(t, q, v, u))
        self.stiffness, self.damping = np.empty((2, len(step), len(step)))
        lengths = self._lengths(t, q)
        for i in range(len(step)):
            step[i] = lengths[i]
            there = self._system.chart.integrate(q, step)
            length = there[i] - q[i] if self._system.chart.is_flat else step[i]
            self.stiffness[:, i] = (field(t, there, v, u) - base) / length
            step[i] = _STEP * max(1.0, abs(float(v[i])))
            moved = v + step
            self.damping[:, i] = (field(t, q, moved, u) - base) / (moved[i] - v[i])
            step[i] = 0.0

    def _lengths(self, t: float, q: Array) -> Array:
        """Steps of the coordinates that move no joint by more than `_STEP`, shape (nv,).

        A joint that depends on one by a steep coupling function moves further.
        """
        system, lengths = self._system, np.full(len(self._step), _STEP)
        if system.nv == system.model.nv:
            return lengths
        for i, unit in enumerate(np.eye(system.nv)):
            lengths[i] /= max(1.0, float(np.abs(system.expand(State(t, q, unit)).v).max()))
        return (
            np.maximum(lengths, _SPACINGS * np.spacing(np.abs(q)))
            if system.chart.is_flat
            else lengths
        )
