"""Loads and internal states in a step that solves for them with their slopes.

    M dv = h f + J' p,   dz = h r,   f and r at shares s / h of the step

With f' = s f_v + s^2 f_q and r' = s r_v + s^2 r_q one step of Newton's method gives

    (M - f' - s f_z (1 - s r_z)^-1 r') dv = h f + s f_z (1 - s r_z)^-1 h r + J' p

so that neither stiff loads nor stiff internal states limit a step.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from mbd_ros.core.dynamics.internal_dynamics import ExtendedChart
from mbd_ros.core.dynamics.linearization import Linearization
from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.dynamics.open_chain import AllJoints
from mbd_ros.core.loads.internal_states import Internals
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.state import Array, State


class ImplicitLoads:
    """Forces and rates of all joints, and their slopes by differences.

    Forces that jump count with their side at the state: across the surface a difference quotient
    is no slope.

    Args:
        mechanism: Whose loads they are.
        internals: Internal states of the scene.

    Attributes:
        nv: Number of velocities and internal states together.
        chart: Of the configuration beside integrals of internal states.
        upper: Largest values of both.
        model: The Pinocchio model.
    """

    def __init__(self, mechanism: Mechanism, internals: Internals) -> None:
        self._mechanism = mechanism
        self._internals = internals
        self.model = mechanism.model
        chart, sizes = AllJoints(mechanism).chart, np.ones(internals.nz)
        self.chart = ExtendedChart(chart, sizes)
        self._nq = chart.nq
        self._nv = chart.nv
        self.nv = chart.nv + internals.nz
        self.upper = np.concatenate((np.full(chart.nv, np.inf), internals.upper))
        self._linearization = Linearization(self)
        n = chart.nv
        self._none = Slopes(np.zeros((n, n)), np.zeros((n, 0)), np.eye(0), np.zeros((0, n)))

    def expand(self, x: State) -> State:
        """Return the same state: all joints are their own coordinates."""
        return x

    def force(self, x: State, u: Array | None) -> Array:
        """Return the generalized force tau - h at a state of all joints, shape (nv,)."""
        mechanism = self._mechanism
        inside = x._replace(z=self._internals.inside(x.z))
        return mechanism.tau(inside, u) - mechanism.bias(x.q, x.v)

    def rates(self, x: State, u: Array | None) -> Array:
        """Return rates of the internal states there, shape (nz,)."""
        k, loads, internals = self._mechanism.k, self._mechanism.loads, self._internals
        k.refresh(x.q, x.v, internals.reads)
        return internals.rates(k, x._replace(z=internals.inside(x.z)), loads.inputs(x, u))

    def slopes(self, x: State, u: Array | None, s: float) -> Slopes:
        """Return the matrices of a step at a state of all joints.

        Args:
            u: Inputs, as for `Loads.total`.
            s: Share of the step that increments count for [s].
        """
        loads, k, n = self._mechanism.loads, self._mechanism.k, self._nv
        if loads.is_empty and not self._internals.nz:
            return self._none
        z = self._internals.inside(x.z)
        k.refresh(x.q, x.v, loads.reads)
        field = partial(self._write, loads.beside(k, x._replace(z=z)))
        q, v = np.concatenate((x.q, 0.0 * z)), np.concatenate((x.v, z))
        stiffness, damping = self._linearization.slopes(field, x.t, q, v, u)
        slopes = s * damping + s * s * stiffness
        gain = np.asarray(np.linalg.inv(np.eye(len(z)) - slopes[n:, n:]), dtype=np.float64)
        push = slopes[:n, n:].dot(gain)
        by_motion = slopes[:n, :n] + push.dot(slopes[n:, :n])
        added = -0.5 * (by_motion + by_motion.T)
        return Slopes(added, push, gain, gain.dot(slopes[n:, :n]))

    def _write(
        self, loads: Loads, t: float, q: Array, v: Array, u: Array | None, out: Array
    ) -> None:
        n, k = self._nv, self._mechanism.k
        x = State(t, q[: self._nq], v[:n], v[n:])
        k.refresh(x.q, x.v, max(loads.reads, self._internals.reads))
        out[:n] = loads.total(k, x, u)
        if self._internals.nz:
            out[n:] = self._internals.rates(k, x, loads.inputs(x, u))


class Slopes(NamedTuple):
    """The matrices of a step.

    Attributes:
        added: What loads add to M, symmetric part, shape (nv, nv).
        push: Force of an increment of internal states, shape (nv, nz).
        gain: Their increment by h r, shape (nz, nz).
        by_v: Their increment by dv, shape (nz, nv).
    """

    added: Array
    push: Array
    gain: Array
    by_v: Array


def mass_with(M: Array, added: Array) -> Array:
    """Return M + added where that is positive definite, else without what makes it less than M.

    Such a load makes motion grow: it is left to explicit steps.
    """
    effective_mass: Array = M + added
    try:
        np.linalg.cholesky(effective_mass)
    except np.linalg.LinAlgError:
        L = np.linalg.cholesky(M)
        sizes, ways = np.linalg.eigh(np.linalg.solve(L, np.linalg.solve(L, added).T))
        ways = L.dot(ways)
        effective_mass = M + (ways * np.maximum(sizes, 0.0)).dot(ways.T)
    return effective_mass
