"""Free bodies with velocities in the axes of the world.

A velocity v of a free body stands in its own axes, v' = R' a - w x v: beside a spin of 50 rad/s it
turns by half a radian in steps of 0.01 s though the body moves straight on. Methods that integrate
it err by powers of w h. In the axes of the world it changes by forces alone: a ball that slides or
rolls has constant accelerations there, whatever its spin.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.dynamics.chart import Chart
from mbd_ros.core.dynamics.linearization import Linearization, mode_at
from mbd_ros.core.dynamics.system import Accelerator, Derivatives, System
from mbd_ros.core.state import Array, Mode, State

_BASE_V = 6  # velocities of a free body
_SMALL_TURN = 1.0e-2  # rad^2; below it the series is exact, far below it the closed form is not


class InWorldAxes:
    """A system for integrators, with velocities of free bodies in the axes of the world.

    All other attributes are those of the system.

    Attributes:
        chart: Chart of the same configurations, in the axes of the world.
    """

    def __init__(self, system: System) -> None:
        self.system = system
        self.chart: Chart = WorldChart(system.chart)
        self._bodies = FreeBodies(system.chart.model)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.system, name)

    def to_world(self, y: State) -> State:
        """A state of what the system integrates, with velocities in the axes of the world."""
        return y._replace(v=self._bodies.in_world(y.v, self._bodies.axes(y.q)))

    def from_world(self, x: State) -> State:
        """Return the state of what the system integrates."""
        return x._replace(v=self._bodies.in_body_axes(x.v, self._bodies.axes(x.q)))

    def accelerator(self, mode: Mode = ()) -> Accelerator:
        """Return the function that writes accelerations in the axes of the world in a mode."""
        return self.adapted(self.system.accelerator(mode))

    def adapted(self, write: Accelerator) -> Accelerator:
        """Return a function of velocities in the axes of the world from one of the system."""
        bodies, has_rates = self._bodies, self.system.internals.nz > 0

        def accelerate(t: float, q: Array, v: Array, *more: Any) -> None:
            axes = bodies.axes(q)
            write(t, q, bodies.in_body_axes(v, axes), *more)
            out = more[-2 if has_rates else -1]
            out[...] = bodies.in_world(out, axes)
            bodies.add_turning(out, v)

        return accelerate

    def derivatives(self, x: State, u: Array | None = None, *, inputs: bool = True) -> Derivatives:
        """Return derivatives of accelerations by differences, to about 1e-6."""
        field = self.accelerator(mode_at(self.system, self.from_world(x), u))
        return Linearization(self).derivatives(field, x, u, inputs=inputs)

    def expand(self, x: State) -> State:
        """Return the state of all joints."""
        return self.system.expand(self.from_world(x))

    def reduce(self, x: State) -> State:
        """Return the state of what is integrated from that of all joints."""
        return self.to_world(self.system.reduce(x))


class WorldChart(Chart):
    """The map q (+) dq in the axes of the world.

    Free bodies move by a displacement and a rotation about their origin, both in the axes of the
    world, [m, rad]; all other coordinates add up.

    Args:
        chart: The chart in the axes of the bodies.
    """

    def __init__(self, chart: Chart) -> None:
        super().__init__(chart.model)
        self._body_chart = chart
        self._bodies = FreeBodies(chart.model)

    def integrate(self, q: Array, dq: Array) -> Array:
        """Return the configuration q (+) dq, shape (nq,)."""
        axes = self._bodies.axes(q)
        displacement = self._bodies.in_body_axes(dq, axes)
        return self._bodies.integrate(self._body_chart, q, displacement, axes)

    def difference(self, q0: Array, q1: Array) -> Array:
        """Return the dq with q0 (+) dq = q1, shape (nv,)."""
        return self._bodies.difference(self._body_chart, q0, q1)

    def rate(self, dq: Array, v: Array) -> Array:
        """Return the rate of dq in q = q0 (+) dq while q moves with v, shape (nv,).

        Source: Iserles et al., Lie-group methods, Acta Numerica 9, 2000, app. B: the inverse of
        the left Jacobian of SO(3).
        """
        rate = v.copy()
        for spin in self._bodies.spins:
            rate[spin] = _rate_on_turns(dq[spin].tolist(), v[spin].tolist())
        return rate


def _rate_on_turns(turn: list[float], spin: list[float]) -> Array:
    """Return the rate of a rotation vector whose body spins, both in the axes of the world."""
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


class FreeBodies:
    """The free bodies of a model, in the order of its joints.

    Args:
        model: The Pinocchio model.

    Attributes:
        spins: Places of their angular velocities.
    """

    def __init__(self, model: Any) -> None:
        joints = [joint for joint in model.joints if joint.nv == _BASE_V]
        starts = [int(joint.idx_v) for joint in joints]
        self.spins = [slice(v + 3, v + 6) for v in starts]
        self._q = _places([joint.idx_q for joint in joints], 3)
        self._turns = _places([joint.idx_q + 3 for joint in joints], 4)
        self._v = _places([joint.idx_v for joint in joints], 3)
        self._spins = _places([joint.idx_v + 3 for joint in joints], 3)
        self._vectors = np.stack((self._v, self._spins), axis=-1)

    def axes(self, q: Array) -> Array:
        """Return from axes of the bodies to those of the world, shape (n, 3, 3)."""
        if len(self._q) == 1:
            axes: Array = pin.Quaternion(q[self._turns[0]]).matrix()[None]
            return axes
        x, y, z, w = q[self._turns].T
        rows = (
            *(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
            *(2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)),
            *(2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
        )
        return np.array(rows).T.reshape(-1, 3, 3)

    def in_axes(self, v: Array, before: Array, after: Array) -> Array:
        """Return a velocity with its linear parts in other axes.

        Args:
            v: Velocity, shape (nv,).
            before: Present axes of its linear parts, shape (n, 3, 3).
            after: Axes of the result, shape (n, 3, 3).
        """
        rotated = v.copy()
        world = np.einsum("nij,nj->ni", before, v[self._v])
        rotated[self._v] = np.einsum("nij,ni->nj", after, world)
        return rotated

    def integrate(self, chart: Chart, q: Array, displacement: Array, axes: Array) -> Array:
        """Return the configuration after a displacement, free bodies on straight lines.

        Args:
            chart: Chart of the configuration.
            q: Configuration before it, shape (nq,).
            displacement: Tangent step, its linear parts in some axes, shape (nv,).
            axes: These axes, shape (n, 3, 3).
        """
        turn = displacement.copy()
        turn[self._v] = 0.0
        moved = chart.integrate(q, turn)
        moved[self._q] += np.einsum("nij,nj->ni", axes, displacement[self._v])
        return moved

    def difference(self, chart: Chart, q0: Array, q1: Array) -> Array:
        """Return the displacement between configurations in the axes of the world."""
        displacement = self.in_world(chart.difference(q0, q1), self.axes(q0))
        displacement[self._v] = q1[self._q] - q0[self._q]
        return displacement

    def in_world(self, v: Array, axes: Array) -> Array:
        """Return velocities or accelerations in the axes of the world, both parts of them.

        Args:
            v: In the axes of the bodies, shape (nv,).
            axes: Of the bodies, shape (n, 3, 3).
        """
        rotated = v.copy()
        rotated[self._vectors] = axes @ v[self._vectors]
        return rotated

    def in_body_axes(self, v: Array, axes: Array) -> Array:
        """Return the reverse of `in_world`."""
        rotated = v.copy()
        rotated[self._vectors] = axes.transpose(0, 2, 1) @ v[self._vectors]
        return rotated

    def add_turning(self, a: Array, v: Array) -> None:
        """Add w x v to accelerations of the bodies, both in the axes of the world."""
        for spin in self.spins:
            start = spin.start - 3
            x, y, z, p, q, r = v[start : spin.stop].tolist()
            a[start : spin.start] += (q * z - r * y, r * x - p * z, p * y - q * x)

    def spin_acceleration(self, v: Array) -> Array:
        """Return w x v, by which accelerations in the axes of the bodies differ, shape (nv,)."""
        acceleration = np.zeros(len(v))
        (a, b, c), (x, y, z) = v[self._spins].T, v[self._v].T
        acceleration[self._v] = np.column_stack((b * z - c * y, c * x - a * z, a * y - b * x))
        return acceleration


def _places(starts: list[int], count: int) -> NDArray[np.intp]:
    return np.array(starts, dtype=np.intp)[:, None] + np.arange(count)
