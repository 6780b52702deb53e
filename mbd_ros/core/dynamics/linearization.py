"""Derivatives of forces and accelerations by state and inputs, and the residual of the motion.

`Linearization` differentiates any function by forward differences. `FreeDerivatives` has those of
the accelerations of an open chain, exact but for those of its loads:

    da = ABA_q dq + ABA_v dv + M^-1 dtau

Loads that do not know their derivatives are differentiated by differences: they are cheap, and
most of them linear. `Balance` is the residual f = tau - h - M a + J' lam of the equation of motion
with its slopes, for methods that solve for accelerations. Source: J. Carpentier, N. Mansard,
Analytical derivatives of rigid body dynamics algorithms, RSS 2018.
"""

from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.core.contracts import Load
from mbd_ros.core.dynamics.chart import Chart
from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.dynamics.system import Accelerator, Derivatives, System
from mbd_ros.core.loads.internal_states import Internals
from mbd_ros.core.state import Array, Mode, State

_STEP = 1.5e-8  # square root of the rounding unit: truncation and rounding are alike
_SPACINGS = 4.0  # of the numbers around a position: a shorter step of it is rounding


class Linearization:
    """Forward differences of f(t, q, v, u), shape (nv,), on the configuration manifold.

    f(t, q (+) dq, v + dv, u) = f + stiffness dq + damping dv, to about 1e-6 of f. Costs 2 nv + 1
    evaluations.

    Args:
        system: A `System`, or an `Extended` one.
    """

    def __init__(self, system: Any) -> None:
        self._system = system
        self._step, self._base, self._moved = np.zeros((3, system.nv))
        self._upper: Array | None = getattr(system, "upper", None)

    def slopes(
        self, field: Accelerator, t: float, q: Array, v: Array, u: Array | None
    ) -> tuple[Array, Array]:
        """Return stiffness df/dq and damping df/dv at a state, shape (nv, nv) each.

        Args:
            field: Function of t, q, v, u that writes f into its fifth argument.
            t: Time [s].
            q: Configuration, shape (nq,).
            v: Velocity, shape (nv,).
            u: Inputs, as for `System.evaluate`.
        """
        step, there = self._step, self._moved
        chart, (base, damping) = self._system.chart, self.by_velocity(field, t, q, v, u)
        stiffness = np.empty((len(step), len(step)))
        lengths = self._lengths(t, q)
        for i in range(len(step)):
            step[i] = lengths[i]
            moved = chart.integrate(q, step)
            length = moved[i] - q[i] if chart.is_flat else step[i]
            field(t, moved, v, u, there)
            stiffness[:, i] = (there - base) / length
            step[i] = 0.0
        return stiffness, damping

    def by_velocity(
        self, field: Accelerator, t: float, q: Array, v: Array, u: Array | None
    ) -> tuple[Array, Array]:
        """Return f at a state, read-only, shape (nv,), and df/dv, shape (nv, nv)."""
        step, base, there = self._step, self._base, self._moved
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

    def derivatives(
        self, field: Accelerator, y: State, u: Array | None, *, inputs: bool
    ) -> Derivatives:
        """Return the derivatives at a state; those by u cost an evaluation each.

        Args:
            field: Function of t, q, v, u that writes f into its fifth argument.
            y: State of what is integrated.
            u: Inputs, as for `System.evaluate`.
            inputs: Whether the derivatives by u are wanted.
        """
        stiffness, damping = self.slopes(field, y.t, y.q, y.v, u)
        by_u = self._by_inputs(field, y, u) if inputs else np.zeros((len(self._step), 0))
        none = np.zeros((len(self._step), len(y.z)))
        return Derivatives(stiffness, damping, none, by_u)

    def _by_inputs(self, field: Accelerator, y: State, u: Array | None) -> Array:
        inputs = np.array(self._system.loads.idle if u is None else u, dtype=np.float64)
        slopes = np.empty((len(self._step), len(inputs)))
        for i in range(len(inputs)):
            moved = inputs.copy()
            moved[i] += _STEP * max(1.0, abs(float(inputs[i])))
            field(y.t, y.q, y.v, moved, self._moved)
            slopes[:, i] = (self._moved - self._base) / (moved[i] - inputs[i])
        return slopes

    def _lengths(self, t: float, q: Array) -> Array:
        """Return steps of the coordinates that move no joint by more than `_STEP`, shape (nv,).

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
    """Return the mode of the event-driven rows at a state.

    Derivatives are taken in one mode: across an event a difference quotient is no slope.

    Args:
        system: The system.
        y: State of what it integrates; its own mode is returned, if it has one.
        u: Inputs there.
    """
    rows = system.event_rows
    if rows is None or y.mode:
        return () if rows is None else y.mode
    mode, near = rows.modes_by_distance(y)
    if not near:
        return mode
    decided = rows.decided_mode(rows.solve(y, u, mode, near))
    return tuple(decided[i] if i in near else side for i, side in enumerate(mode))


class FreeDerivatives:
    """Derivatives of q'' and of the rates z' of a mechanism without rows.

    Args:
        chart: Steps of the configurations of all joints.
        internals: The internal states of its loads.
    """

    def __init__(self, mechanism: Mechanism, chart: Chart, internals: Internals) -> None:
        self._mechanism = mechanism
        self._chart = chart
        self._internals = internals
        self._nv, self._nz = nv, nz = int(mechanism.model.nv), internals.nz
        self._constant = np.zeros((nv + nz, 2 * nv + nz))
        self._varying = list[Load]()
        for part in (*mechanism.loads.actuators, *mechanism.loads.forces):
            slopes = part.constant_slopes(nv, nz)
            if slopes is None:
                self._varying.append(part)
            else:
                self._constant[:nv] += slopes
        self._moving = [part for part in self._varying if part.internal]

    def at(self, y: State, u: Array | None, *, inputs: bool) -> Derivatives:
        """Return derivatives of the accelerations and rates at a state."""
        mechanism, nv, nz = self._mechanism, self._nv, self._nz
        u = mechanism.loads.inputs(y, u)
        force = self._loads(y, u)
        slopes = self._slopes(y, u, force, len(u) if inputs else 0)
        model, data = mechanism.model, mechanism.data
        mechanism.evaluations += 1
        pin.computeABADerivatives(model, data, y.q, y.v, force[:nv])
        by_q, by_v, respond = np.array(data.ddq_dq), np.array(data.ddq_dv), np.array(data.Minv)
        if slopes is None:
            none = np.zeros((nv, 0))
            return Derivatives(by_q, by_v, none, none, force=respond)
        pushed = respond.dot(slopes[:nv])
        by_q += pushed[:, :nv]
        by_v += pushed[:, nv : 2 * nv]
        at = 2 * nv + nz
        rates = None
        if nz:
            rows = slopes[nv:]
            rates = Derivatives(
                rows[:, :nv], rows[:, nv : 2 * nv], rows[:, 2 * nv : at], rows[:, at:]
            )
        by_z, by_u = pushed[:, 2 * nv : at], pushed[:, at:]
        return Derivatives(by_q, by_v, by_z, by_u, rates, force=respond)

    def _loads(self, y: State, u: Array) -> Array:
        """Forces of the loads on the joints, then rates of their states, shape (nv + nz,)."""
        mechanism, internals = self._mechanism, self._internals
        x = y._replace(z=internals.inside(y.z)) if self._nz else y
        mechanism.k.refresh(x.q, x.v, max(mechanism.loads.reads, internals.reads))
        force = mechanism.loads.total(mechanism.k, x, u)
        if not self._nz:
            return force
        return np.concatenate((force, internals.rates(mechanism.k, x, u)))

    def _slopes(self, y: State, u: Array, force: Array, nu: int) -> Array | None:
        """Return the slopes of `_loads` by q, v, z and u; None for zero.

        The shape is (nv + nz, 2 nv + nz + nu).
        """
        if self._mechanism.loads.is_empty:
            return None
        nv, nz = self._nv, self._nz
        slopes = np.empty((nv + nz, 2 * nv + nz + nu))
        slopes[:, : 2 * nv + nz] = self._constant
        if self._varying:
            self._differ(y, u, slopes)
        for i in range(nu):
            moved = u.copy()
            moved[i] += _STEP * max(1.0, abs(float(u[i])))
            slopes[:, 2 * nv + nz + i] = (self._loads(y, moved) - force) / (moved[i] - u[i])
        return slopes

    def _differ(self, y: State, u: Array, slopes: Array) -> None:
        """Add the slopes of the loads that do not know them, by q, v and z."""
        nv, here = self._nv, self._of_varying(y, u)
        inside, step = self._internals.upper, np.zeros(2 * nv + self._nz)
        for i in range(len(step)):
            step[i] = _STEP
            if i >= 2 * nv and y.z[i - 2 * nv] + _STEP > inside[i - 2 * nv]:
                step[i] = -_STEP
            slopes[:, i] += (self._of_varying(self._chart.plus(y, step), u) - here) / step[i]
            step[i] = 0.0

    def _of_varying(self, y: State, u: Array) -> Array:
        """Return forces and rates of the loads that do not know their slopes, shape (nv + nz,)."""
        mechanism, internals, nv = self._mechanism, self._internals, self._nv
        x = y._replace(z=internals.inside(y.z)) if self._nz else y
        k, total = mechanism.k, np.zeros(nv + self._nz)
        k.refresh(x.q, x.v, max(mechanism.loads.reads, internals.reads))
        for part in self._varying:
            total[:nv] += part.force(k, x, u)
        for part in self._moving:
            total[nv:][part.z] = part.rates(k, x, u)
        return total


def balance_of(system: Any) -> Any:
    """Return the balance of a system that has one of its own, else one by differences."""
    own = getattr(system, "balance", None)
    return Balance(system) if own is None else own(system)


class Balance:
    """f = tau - h - M a + J' lam at given accelerations and multipliers, and its slopes.

    Slopes are differences, to about 1e-6.

    Args:
        system: A `System`, or an `Extended` one, whose rates are accelerations of mass 1.
    """

    def __init__(self, system: Any) -> None:
        self._system = system
        self._bilateral = system.bilateral
        self._linearization = Linearization(system)

    def force(self, t: float, q: Array, v: Array, u: Array | None, a: Array, lam: Array) -> Array:
        """Return the f, shape (nv,).

        Args:
            q: Configuration of what is integrated.
            u: Inputs, as for `System.evaluate`.
            a: Accelerations, shape (nv,).
            lam: Multipliers of the bilateral rows.
        """
        system = self._system
        force: Array = system.applied(t, q, v, u) - system.mass(q).dot(a)
        return force + lam.dot(self._bilateral.jacobian(t, q)) if self._bilateral.rows else force

    def slopes(
        self, t: float, q: Array, v: Array, u: Array | None, a: Array, lam: Array
    ) -> tuple[Array, Array]:
        """Return the derivatives of f by q and by v, shape (nv, nv) each."""

        def write(t: float, q: Array, v: Array, u: Array | None, out: Array) -> None:
            out[...] = self.force(t, q, v, u, a, lam)

        return self._linearization.slopes(write, t, q, v, u)
