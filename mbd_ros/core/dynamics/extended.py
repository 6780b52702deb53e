"""A system whose internal states are velocities of coordinates that nobody asks for.

Every method that integrates v' = a and q' = v integrates z' = r too, if z stands beside v: (v, z)
are the velocities, the integral of z the position that belongs to z. Methods stay as they are, and
scenes without internal states pay nothing.
"""

from typing import Any

import numpy as np

from mbd_ros.core.dynamics.chart import Chart
from mbd_ros.core.dynamics.mass import Mass
from mbd_ros.core.dynamics.rigid_rows import RigidRows
from mbd_ros.core.dynamics.system import Accelerator, Derivatives, System
from mbd_ros.core.state import NONE, Array, Mode, State


class ExtendedChart:
    """The chart of a configuration beside the integrals of internal states.

    Args:
        chart: Of the configuration.
        sizes: Errors of internal states that count as one, shape (nz,).

    Attributes:
        nq: Size of a configuration.
        nv: Size of a step and of a velocity.
        is_flat: Whether configurations are a vector space with q' = v.
        sizes: As that of a `Chart`; errors of the integrals do not count.
    """

    def __init__(self, chart: Chart, sizes: Array) -> None:
        self._chart, nz = chart, len(sizes)
        self.nq, self.nv, self.is_flat = chart.nq + nz, chart.nv + nz, chart.is_flat
        ones = np.ones(chart.nv)
        self.sizes = np.concatenate((ones, np.full(nz, np.inf), ones, sizes))

    def integrate(self, q: Array, dq: Array) -> Array:
        """Configuration q (+) dq, shape (nq,)."""
        if self.is_flat:
            return q + dq
        n, m = self._chart.nq, self._chart.nv
        return np.concatenate((self._chart.integrate(q[:n], dq[:m]), q[n:] + dq[m:]))

    def difference(self, q0: Array, q1: Array) -> Array:
        """The dq with q0 (+) dq = q1, shape (nv,)."""
        if self.is_flat:
            return q1 - q0
        n = self._chart.nq
        return np.concatenate((self._chart.difference(q0[:n], q1[:n]), q1[n:] - q0[n:]))

    def rate(self, dq: Array, v: Array) -> Array:
        """Rate of dq in q = q0 (+) dq while q moves with v, shape (nv,)."""
        if self.is_flat:
            return v
        m = self._chart.nv
        return np.concatenate((self._chart.rate(dq[:m], v[:m]), v[m:]))


class ExtendedRows:
    """Rows that an integrator keeps, none of which moves internal states.

    Whatever else is asked of them is that of the rows.

    Args:
        rows: The rows.
        nq: Size of the configuration.
        nz: Number of internal states.
    """

    def __init__(self, rows: RigidRows | System, nq: int, nz: int) -> None:
        self._rows, self._nq = rows, nq
        self._none = np.zeros((len(rows.rows), nz))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._rows, name)

    def residual(self, t: float, q: Array) -> Array:
        """g(t, q), shape (m,)."""
        return self._rows.residual(t, q[: self._nq])

    def jacobian(self, t: float, q: Array) -> Array:
        """dg/dq, shape (m, nv + nz)."""
        return np.hstack((self._rows.jacobian(t, q[: self._nq]), self._none))

    def rate(self, t: float, q: Array) -> Array:
        """dg/dt, shape (m,)."""
        return self._rows.rate(t, q[: self._nq])


class Extended:
    """What integrators ask of a system, with internal states beside the velocities.

    Whatever else they ask is that of the system.

    Args:
        system: The system, with internal states.

    Attributes:
        system: As given.
        chart: Of configurations beside the integrals of internal states.
        nq: Size of such a configuration.
        nv: Size of velocities and internal states together.
        held: All bilateral rows, as that of the system.
        residual: Of the bilateral rows of positions, as that of the system; so are `jacobian` and
            `rate`.
        upper: Largest velocities, inf but for internal states, shape (nv,).
    """

    def __init__(self, system: System) -> None:
        self.system, internals = system, system.internals
        sizes = np.minimum(internals.upper - internals.lower, 1.0)
        self.chart = ExtendedChart(system.chart, sizes)
        self.nq, self.nv, self.bounded = self.chart.nq, self.chart.nv, system.bounded
        self.upper = np.concatenate((np.full(system.nv, np.inf), internals.upper))
        self._nq, self._nv, self._nz = system.nq, system.nv, internals.nz
        self.held = ExtendedRows(system.held, system.nq, internals.nz)
        rows = ExtendedRows(system, system.nq, internals.nz)
        self.residual, self.jacobian, self.rate = rows.residual, rows.jacobian, rows.rate

    def __getattr__(self, name: str) -> Any:
        return getattr(self.system, name)

    def joined(self, y: State, integrals: Array | None = None) -> State:
        """A state of what the system integrates, with its internal states beside v.

        Args:
            y: State with internal states.
            integrals: Of the internal states; 0 without.
        """
        more = np.zeros(self._nz) if integrals is None else integrals
        q, v = np.concatenate((y.q, more)), np.concatenate((y.v, y.z))
        return State(y.t, q, v, NONE, y.mode)

    def parted(self, x: State) -> State:
        """The state of what the system integrates, internal states inside their bounds."""
        z = self.system.internals.inside(x.v[self._nv :])
        return State(x.t, x.q[: self._nq], x.v[: self._nv], z, x.mode)

    def accelerator(self, mode: Mode = ()) -> Accelerator:
        """The function of t, q, v, u that writes accelerations and rates in a mode."""
        return self.adapted(self.system.accelerator(mode))

    def adapted(self, write: Accelerator) -> Accelerator:
        """A function of t, q, v, u from one of t, q, v, z, u."""
        n, m = self._nq, self._nv

        def accelerate(t: float, q: Array, v: Array, u: Array | None, out: Array) -> None:
            write(t, q[:n], v[:m], v[m:], u, out[:m], out[m:])

        return accelerate

    def derivatives(self, x: State, u: Array | None = None, *, inputs: bool = True) -> Derivatives:
        """As those of the system, rates among the accelerations."""
        of = self.system.derivatives(self.parted(x), u, inputs=inputs)
        by_q, by_v = of.of_velocities
        by_u = of.u if of.rates is None else np.vstack((of.u, of.rates.u))
        return Derivatives(by_q, by_v, np.zeros((len(by_q), 0)), by_u)

    def with_loads(self, loads: Any) -> "Extended":
        """The same for other loads."""
        return Extended(self.system.with_loads(loads))

    def expand(self, x: State) -> State:
        """State of all joints."""
        return self.system.expand(self.parted(x))

    def reduce(self, x: State) -> State:
        """State of what is integrated from that of all joints."""
        return self.joined(self.system.reduce(x))

    def lift(self, x: State, a: Array) -> Array:
        """Accelerations of all joints."""
        return self.system.lift(self.parted(x), a[: self._nv])

    def mass(self, q: Array) -> Mass:
        """Mass matrix; internal states have the mass 1."""
        M, m = np.eye(self.nv), self._nv
        M[:m, :m] = self.system.mass(q[: self._nq]).dense
        return Mass(M)

    def applied(self, t: float, q: Array, v: Array, u: Array | None = None) -> Array:
        """Generalized force tau - h beside the rates."""
        y = self.parted(State(t, q, v))
        return np.concatenate((self.system.applied_with(y, u), self.system.rates(y, u)))
