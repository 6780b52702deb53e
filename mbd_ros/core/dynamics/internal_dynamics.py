"""Systems with internal states z: as velocities of further coordinates, and where they start.

Every method that integrates v' = a and q' = v integrates z' = r too, if z stands beside v: (v, z)
are the velocities, the integral of z the position that belongs to z (`Extended`). Methods stay as
they are, and scenes without internal states pay nothing. `settled` finds where internal states
start: as given, or at rest under the position, the velocity and u.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.dynamics.chart import Chart
from mbd_ros.core.dynamics.mass import Mass
from mbd_ros.core.dynamics.mechanism import RigidRows
from mbd_ros.core.dynamics.system import Accelerator, Derivatives, System
from mbd_ros.core.state import NONE, Array, Mode, State
from mbd_ros.core.thresholds import redundant
from mbd_ros.errors import SolveError

_CORRECTIONS = 60  # steps of Newton's method
_SHORTEST = 1.0e-6  # share of such a step
_FIRST = 1.0e-2  # change of z in a first implicit step
_FOLLOWED = 200  # implicit steps
_STEP = 1.5e-8  # square root of the rounding unit
_AT_REST = 1.0e-9  # of z: a correction that may be the last
_ROUNDING = 1.0e-15  # of z: a correction that must be the last
_LEFT = 1.0e-6  # of a rate: what a correction may leave of it


class Extended:
    """A system for integrators, with internal states as further velocities.

    All other attributes are those of the system.

    Args:
        system: The system, with internal states.

    Attributes:
        chart: Of configurations beside the integrals of internal states.
        nq: Size of such a configuration.
        nv: Size of velocities and internal states together.
        bilateral: All bilateral rows, as those of the system.
        residual: Of the bilateral rows of positions, as that of the system; so are `jacobian` and
            `rate`.
        upper: Largest velocities, inf but for internal states, shape (nv,).
    """

    def __init__(self, system: System) -> None:
        self.system = system
        internals = system.internals
        sizes = np.minimum(internals.upper - internals.lower, 1.0)
        self.chart = ExtendedChart(system.chart, sizes)
        self.nq = self.chart.nq
        self.nv = self.chart.nv
        self.bounded = system.bounded
        self.upper = np.concatenate((np.full(system.nv, np.inf), internals.upper))
        self._nq = system.nq
        self._nv = system.nv
        self._nz = internals.nz
        self.bilateral = ExtendedRows(system.bilateral, system.nq, internals.nz)
        rows = ExtendedRows(system, system.nq, internals.nz)
        self.residual = rows.residual
        self.jacobian = rows.jacobian
        self.rate = rows.rate

    def __getattr__(self, name: str) -> Any:
        return getattr(self.system, name)

    def joined(self, y: State, integrals: Array | None = None) -> State:
        """Return a state of what the system integrates, with its internal states beside v.

        Args:
            y: State with internal states.
            integrals: Of the internal states; 0 without.
        """
        more = np.zeros(self._nz) if integrals is None else integrals
        q, v = np.concatenate((y.q, more)), np.concatenate((y.v, y.z))
        return State(y.t, q, v, NONE, y.mode)

    def parted(self, x: State) -> State:
        """Return the state of what the system integrates, internal states inside their bounds."""
        z = self.system.internals.inside(x.v[self._nv :])
        return State(x.t, x.q[: self._nq], x.v[: self._nv], z, x.mode)

    def accelerator(self, mode: Mode = ()) -> Accelerator:
        """Return the function of t, q, v, u that writes accelerations and rates in a mode."""
        return self.adapted(self.system.accelerator(mode))

    def adapted(self, write: Accelerator) -> Accelerator:
        """Return a function of t, q, v, u from one of t, q, v, z, u."""
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

    def with_loads(self, loads: Any) -> Extended:
        """Return the same for other loads."""
        return Extended(self.system.with_loads(loads))

    def expand(self, x: State) -> State:
        """Return the state of all joints."""
        return self.system.expand(self.parted(x))

    def reduce(self, x: State) -> State:
        """Return the state of what is integrated from that of all joints."""
        return self.joined(self.system.reduce(x))

    def lift(self, x: State, a: Array) -> Array:
        """Return accelerations of all joints."""
        return self.system.lift(self.parted(x), a[: self._nv])

    def mass(self, q: Array) -> Mass:
        """Return the mass matrix; internal states have the mass 1."""
        M, m = np.eye(self.nv), self._nv
        M[:m, :m] = self.system.mass(q[: self._nq]).dense
        return Mass(M)

    def applied(self, t: float, q: Array, v: Array, u: Array | None = None) -> Array:
        """Return the generalized force tau - h beside the rates."""
        y = self.parted(State(t, q, v))
        return np.concatenate((self.system.applied_with(y, u), self.system.rates(y, u)))


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
        self._chart = chart
        nz = len(sizes)
        self.nq = chart.nq + nz
        self.nv = chart.nv + nz
        self.is_flat = chart.is_flat
        ones = np.ones(chart.nv)
        self.sizes = np.concatenate((ones, np.full(nz, np.inf), ones, sizes))

    def integrate(self, q: Array, dq: Array) -> Array:
        """Return the configuration q (+) dq, shape (nq,)."""
        if self.is_flat:
            return q + dq
        n, m = self._chart.nq, self._chart.nv
        return np.concatenate((self._chart.integrate(q[:n], dq[:m]), q[n:] + dq[m:]))

    def difference(self, q0: Array, q1: Array) -> Array:
        """Return the dq with q0 (+) dq = q1, shape (nv,)."""
        if self.is_flat:
            return q1 - q0
        n = self._chart.nq
        return np.concatenate((self._chart.difference(q0[:n], q1[:n]), q1[n:] - q0[n:]))

    def rate(self, dq: Array, v: Array) -> Array:
        """Return the rate of dq in q = q0 (+) dq while q moves with v, shape (nv,)."""
        if self.is_flat:
            return v
        m = self._chart.nv
        return np.concatenate((self._chart.rate(dq[:m], v[:m]), v[m:]))


class ExtendedRows:
    """Rows that an integrator keeps, none of which moves internal states.

    Whatever else is asked of them is that of the rows.

    Args:
        nq: Size of the configuration.
        nz: Number of internal states.
    """

    def __init__(self, rows: RigidRows | System, nq: int, nz: int) -> None:
        self._rows = rows
        self._nq = nq
        self._none = np.zeros((len(rows.rows), nz))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._rows, name)

    def residual(self, t: float, q: Array) -> Array:
        """Return g(t, q), shape (m,)."""
        return self._rows.residual(t, q[: self._nq])

    def jacobian(self, t: float, q: Array) -> Array:
        """Return dg/dq, shape (m, nv + nz)."""
        return np.hstack((self._rows.jacobian(t, q[: self._nq]), self._none))

    def rate(self, t: float, q: Array) -> Array:
        """Return dg/dt, shape (m,)."""
        return self._rows.rate(t, q[: self._nq])


def settled(system: System, y: State, u: Array | None) -> State:
    """Return a state whose internal states are as given, and else at their first values.

    Those whose equilibrium is asked for are where their rates are 0, or at a bound beyond which
    these would take them: where their part says so, else by Newton's method with shorter steps
    where one does not help, and else where they come to rest by themselves.

    Args:
        y: State of what is integrated; z is NaN where nothing is given, or empty.
        u: Inputs; None asks the sources.

    Raises:
        SolveError: There is no equilibrium; names the internal states.
        ModelError: An internal state starts outside its bounds.
    """
    internals = system.internals
    z = system.at_rest(y._replace(z=internals.completed(y.z)), u)
    free = np.flatnonzero(np.isnan(z))
    z[free] = internals.inside(np.zeros(len(z)))[free]
    if not len(free):
        return y._replace(z=z)

    def all_rates(values: Array) -> Array:
        moved = z.copy()
        moved[free] = values
        rates_there: Array = system.rates(y._replace(z=moved), u)
        return rates_there

    rows = _determining(all_rates, z[free], free, internals.upper[free])

    def rates(values: Array) -> Array:
        settled_rates: Array = all_rates(values)[rows]
        return settled_rates

    bounds = internals.lower[free], internals.upper[free]
    settled_rates = _at_rest(rates, z[free], bounds)
    if settled_rates is None:
        settled_rates = _at_rest(rates, _followed(rates, z[free], bounds), bounds)
    if settled_rates is None:
        names = ", ".join(internals.names[i] for i in free)
        raise SolveError(
            f"no equilibrium of {names} at t = {y.t:.9g} s was found; give values in "
            "initial.internal"
        )
    z[free] = settled_rates
    return y._replace(z=z)


def _determining(
    rates: Callable[[Array], Array], z: Array, free: NDArray[np.intp], upper: Array
) -> NDArray[np.intp]:
    """Return the rate that each state is found from, shape (n,): its own, as a rule.

    A state that none of these rates depends on, such as the angle of a motor whose speed is given,
    is found from the first rate that it changes, such as that of the speed.
    """
    r = rates(z)
    if len(free) == len(r) or not np.isfinite(r).all():
        return free
    J = _slopes(rates, z, r, upper)
    rows = free.copy()
    for i in np.flatnonzero(~J[free].any(axis=0)):
        others = [j for j in np.flatnonzero(J[:, i]) if j not in rows]
        rows[i] = others[0] if others else free[i]
    return rows


def _slopes(rates: Callable[[Array], Array], z: Array, r: Array, upper: Array) -> Array:
    """Return differences of m rates, shape (m, n)."""
    J = np.empty((len(r), len(z)))
    for i in range(len(z)):
        moved = z.copy()
        step = _STEP * max(1.0, abs(float(z[i])))
        moved[i] += step if z[i] + step <= upper[i] else -step
        J[:, i] = (rates(moved) - r) / (moved[i] - z[i])
    return J


def _at_rest(
    rates: Callable[[Array], Array], z: Array, bounds: tuple[Array, Array]
) -> Array | None:
    """Newton's method within bounds, None where it does not converge.

    A step is shortened until it shortens the next one (natural monotonicity test).

    Source: P. Deuflhard, Newton Methods for Nonlinear Problems, 2011, sec. 3.1.4, 3.3.
    """
    lower, upper = bounds
    r, last = rates(z), math.inf
    for _ in range(_CORRECTIONS):
        if not np.isfinite(r).all():
            return None
        J = _slopes(rates, z, r, upper)
        is_at_bound = ((z <= lower) & (r < 0.0)) | ((z >= upper) & (r > 0.0))
        step, is_solved = _correction(J, r, is_at_bound)
        size = _size(step, z)
        if size <= _ROUNDING or (size <= _AT_REST and size > 0.5 * last):
            return z if is_solved else None
        last, share = size, 1.0
        while True:
            nearer = np.minimum(np.maximum(z + share * step, lower), upper)
            there = rates(nearer)
            following = _size(_correction(J, there, is_at_bound)[0], z)
            if following <= (1.0 - 0.5 * share) * size or size <= _AT_REST:
                break
            share *= 0.5
            if share < _SHORTEST:
                return None
        z, r = nearer, there
    return None


def _correction(J: Array, r: Array, is_at_bound: NDArray[np.bool_]) -> tuple[Array, bool]:
    """Return the step with r + J step = 0 of what no bound holds, and whether there is one."""
    step, free = np.zeros(len(r)), ~is_at_bound
    part = J[np.ix_(free, free)]
    size = np.abs(part).max(axis=1, initial=0.0)
    size[size == 0.0] = 1.0
    wanted = -r[free] / size
    step[free] = np.linalg.lstsq(part / size[:, None], wanted, rcond=redundant(len(r)))[0]
    left = np.abs((part / size[:, None]).dot(step[free]) - wanted)
    return step, bool((left <= _LEFT * (_ROUNDING + np.abs(wanted))).all())


def _size(step: Array, z: Array) -> float:
    return float((np.abs(step) / (1.0 + np.abs(z))).max(initial=0.0))


def _followed(rates: Callable[[Array], Array], z: Array, bounds: tuple[Array, Array]) -> Array:
    """Return where the states go by themselves, in implicit steps of growing length.

    Source: C. T. Kelley, D. E. Keyes, SIAM J. Numer. Anal. 35, 1998, 508-523.
    """
    lower, upper = bounds
    r = rates(z)
    length = _FIRST / max(_size(r, z), _FIRST)
    for _ in range(_FOLLOWED):
        if not np.isfinite(r).all():
            break
        is_at_bound = ((z <= lower) & (r < 0.0)) | ((z >= upper) & (r > 0.0))
        J = _slopes(rates, z, r, upper) - np.eye(len(z)) / length
        step, _ = _correction(J, r, is_at_bound)
        if _size(step, z) > 1.0:
            length *= 0.25
            continue
        z = np.minimum(np.maximum(z + step, lower), upper)
        r, length = rates(z), 2.0 * length
    return z
