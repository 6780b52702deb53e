"""Derivatives of forces or accelerations, for Newton's method."""

from typing import Any

import numpy as np

from mbd_ros.core.dynamics.system import Accelerator, Derivatives, System
from mbd_ros.core.state import Array, Mode, State

_STEP = 1.5e-8  # square root of the rounding unit: truncation and rounding are alike
_SPACINGS = 4.0  # of the numbers around a position: a shorter step of it is rounding


class Linearization:
    """Forward differences of f(t, q, v, u), shape (nv,), on the configuration manifold.

    f(t, q (+) dq, v + dv, u) = f + stiffness dq + damping dv, to about 1e-6 of f. Costs 2 nv + 1
    evaluations.

    Args:
        system: A `System`, or an `Extended` one.
        field: Writes the f.

    Attributes:
        stiffness: df/dq at the last update, shape (nv, nv); a new array each time.
        damping: df/dv, same shape.
    """

    def __init__(self, system: Any, field: Accelerator) -> None:
        self._system, self._field = system, field
        self._step, self._base, self._moved = np.zeros((3, system.nv))
        self._upper: Array | None = getattr(system, "upper", None)
        self.stiffness = np.zeros((system.nv, system.nv))
        self.damping = np.zeros((system.nv, system.nv))

    def update(self, t: float, q: Array, v: Array, u: Array | None) -> None:
        """Differentiate at a state."""
        field, step, there = self._field, self._step, self._moved
        chart, (base, self.damping) = self._system.chart, self.by_velocity(t, q, v, u)
        self.stiffness = np.empty((len(step), len(step)))
        lengths = self._lengths(t, q)
        for i in range(len(step)):
            step[i] = lengths[i]
            moved = chart.integrate(q, step)
            length = moved[i] - q[i] if chart.is_flat else step[i]
            field(t, moved, v, u, there)
            self.stiffness[:, i] = (there - base) / length
            step[i] = 0.0

    def by_velocity(self, t: float, q: Array, v: Array, u: Array | None) -> tuple[Array, Array]:
        """The f at a state, not to be written to, shape (nv,), and df/dv, shape (nv, nv)."""
        field, step, base, there = self._field, self._step, self._base, self._moved
        field(t, q, v, u, base)
        damping = np.empty((len(step), len(step)))
        for i in range(len(step)):
            step[i] = _STEP * max(1.0, abs(float(v[i])))
            if self._upper is not None and v[i] + step[i] > self._upper[i]:
                step[i] = -step[i]  # internal states stay inside their bounds
            moved = v + step
            field(t, q, moved, u, there)
            damping[:, i] = (there - base) / (moved[i] - v[i])
            step[i] = 0.0
        return base, damping

    def derivatives(self, y: State, u: Array | None, *, inputs: bool) -> Derivatives:
        """Derivatives at a state; those by u cost an evaluation each where they are wanted."""
        self.update(y.t, y.q, y.v, u)
        by_u = self._by_inputs(y, u) if inputs else np.zeros((len(self._step), 0))
        none = np.zeros((len(self._step), len(y.z)))
        return Derivatives(self.stiffness, self.damping, none, by_u)

    def _by_inputs(self, y: State, u: Array | None) -> Array:
        given = np.array(self._system.loads.idle if u is None else u, dtype=np.float64)
        found = np.empty((len(self._step), len(given)))
        for i in range(len(given)):
            moved = given.copy()
            moved[i] += _STEP * max(1.0, abs(float(given[i])))
            self._field(y.t, y.q, y.v, moved, self._moved)
            found[:, i] = (self._moved - self._base) / (moved[i] - given[i])
        return found

    def _lengths(self, t: float, q: Array) -> Array:
        """Steps of the coordinates that move no joint by more than `_STEP`, shape (nv,).

        A joint that depends on one by a steep coupling function moves further.
        """
        system, lengths = self._system, np.full(len(self._step), _STEP)
        if system.nv == system.model.nv:
            return lengths
        for i, unit in enumerate(np.eye(system.nv)):
            lengths[i] /= max(1.0, float(np.abs(system.expand(State(t, q, unit)).v).max()))
        if not system.chart.is_flat:
            return lengths
        return np.maximum(lengths, _SPACINGS * np.spacing(np.abs(q)))


def mode_at(system: System, y: State, u: Array | None) -> Mode:
    """The mode of the exact rows at a state: across an event a difference quotient is no slope.

    Args:
        system: The system.
        y: State of what it integrates; its own mode, if it has one.
        u: Inputs.
    """
    exact = system.exact
    if exact is None or y.mode:
        return () if exact is None else y.mode
    ways, near = exact.ways(y)
    exact.solve(y, u, ways, near)
    found = exact.found()
    return tuple(found[i] if i in near else way for i, way in enumerate(ways))
