"""A system whose free bodies have velocities in the axes of the world.

A velocity v of a free body stands in its own axes, v' = R' a - w x v: beside a spin of 50 rad/s it
turns by half a radian in steps of 0.01 s though the body keeps its way. Methods that integrate it
err by powers of w h. In the axes of the world it changes by what acts alone: a ball that slides or
rolls has constant accelerations there, whatever its spin.
"""

import math
from typing import Any

import numpy as np

from mbd_ros.core.dynamics.chart import Chart
from mbd_ros.core.dynamics.free_bodies import FreeBodies
from mbd_ros.core.dynamics.linearization import Linearization, mode_at
from mbd_ros.core.dynamics.system import Accelerator, Derivatives, System
from mbd_ros.core.state import Array, Mode, State

_SMALL_TURN = 1.0e-2  # rad^2; below it the series is exact, far below it the closed form is not


class WorldChart(Chart):
    """What q (+) dq means in the axes of the world.

    Free bodies move by a way and a turn about their own origin, both in the axes of the world,
    [m, rad]; all other coordinates add up.

    Args:
        chart: The chart in the axes of the bodies.
    """

    def __init__(self, chart: Chart) -> None:
        super().__init__(chart.model)
        self._own, self._bodies = chart, FreeBodies(chart.model)

    def integrate(self, q: Array, dq: Array) -> Array:
        """Configuration q (+) dq, shape (nq,)."""
        axes = self._bodies.axes(q)
        way = self._bodies.in_own_axes(dq, axes)
        return self._bodies.moved(self._own, q, way, axes)

    def difference(self, q0: Array, q1: Array) -> Array:
        """The dq with q0 (+) dq = q1, shape (nv,)."""
        return self._bodies.gone(self._own, q0, q1)

    def rate(self, dq: Array, v: Array) -> Array:
        """Rate of dq in q = q0 (+) dq while q moves with v, shape (nv,).

        Source: Iserles et al., Lie-group methods, Acta Numerica 9, 2000, app. B: the inverse of
        the left Jacobian of SO(3).
        """
        rate = v.copy()
        for spin in self._bodies.spins:
            rate[spin] = _rate_on_turns(dq[spin].tolist(), v[spin].tolist())
        return rate


class InWorldAxes:
    """What integrators ask of a system, velocities of free bodies in the axes of the world.

    Whatever else they ask is that of the system.

    Args:
        system: The system.

    Attributes:
        system: As given.
        chart: Of the same configurations, in the axes of the world.
    """

    def __init__(self, system: System) -> None:
        self.system = system
        self.chart: Chart = WorldChart(system.chart)
        self._bodies = FreeBodies(system.chart.model)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.system, name)

    def turned(self, y: State) -> State:
        """A state of what the system integrates, with velocities in the axes of the world."""
        return y._replace(v=self._bodies.in_world(y.v, self._bodies.axes(y.q)))

    def turned_back(self, x: State) -> State:
        """The state of what the system integrates."""
        return x._replace(v=self._bodies.in_own_axes(x.v, self._bodies.axes(x.q)))

    def accelerator(self, mode: Mode = ()) -> Accelerator:
        """The function that writes accelerations in the axes of the world in a mode."""
        return self.adapted(self.system.accelerator(mode))

    def adapted(self, write: Accelerator) -> Accelerator:
        """A function of velocities in the axes of the world from one of the system."""
        bodies, has_rates = self._bodies, self.system.internals.nz > 0

        def accelerate(t: float, q: Array, v: Array, *more: Any) -> None:
            axes = bodies.axes(q)
            write(t, q, bodies.in_own_axes(v, axes), *more)
            out = more[-2 if has_rates else -1]
            out[...] = bodies.in_world(out, axes)
            bodies.add_turning(out, v)

        return accelerate

    def derivatives(self, x: State, u: Array | None = None, *, inputs: bool = True) -> Derivatives:
        """Derivatives of accelerations by differences; as `System.derivatives`."""
        field = self.accelerator(mode_at(self.system, self.turned_back(x), u))
        return Linearization(self, field).derivatives(x, u, inputs=inputs)

    def expand(self, x: State) -> State:
        """State of all joints."""
        return self.system.expand(self.turned_back(x))

    def reduce(self, x: State) -> State:
        """State of what is integrated from that of all joints."""
        return self.turned(self.system.reduce(x))


def _rate_on_turns(turn: list[float], spin: list[float]) -> Array:
    """Rate of a rotation vector whose body spins, both in the axes of the world."""
    (a, b, c), (x, y, z) = turn, spin
    square = a * a + b * b + c * c
    if square < _SMALL_TURN:
        weight = 1.0 / 12.0 + square * (1.0 / 720.0 + square * (1.0 / 30240.0))
    else:
        half = 0.5 * math.sqrt(square)
        weight = (1.0 - half / math.tan(half)) / square
    p, q, r = b * z - c * y, c * x - a * z, a * y - b * x
    return np.array(
        (
            x - 0.5 * p + weight * (b * r - c * q),
            y - 0.5 * q + weight * (c * p - a * r),
            z - 0.5 * r + weight * (a * q - b * p),
        )
    )
