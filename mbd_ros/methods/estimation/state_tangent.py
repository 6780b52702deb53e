"""Tangent steps between consistent states of a mechanism.

    x (+) d: q = q (+) Nq d_q,  v = v + Nv d_v,  z = z + d_z, projected onto the constraints

Nq spans the steps that position constraints allow, Nv the velocities that all constraints allow.
Without constraints both are identity matrices and d is the step of `Chart.plus`.
Source: P.-A. Absil, R. Mahony, R. Sepulchre, Optimization Algorithms on Matrix Manifolds, 2008,
ch. 4, on retractions.
"""

from typing import NamedTuple, TypeVar

import numpy as np
import pinocchio as pin

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import redundant
from mbd_ros.methods.projection.assembly import project

_STEP = 1.0e-6  # for finite differences of a projection [m, rad]
_STATES = 64  # number of states whose bases are cached, enough for a window
Value = TypeVar("Value")


class Basis(NamedTuple):
    """Basis of the tangent at a state.

    Attributes:
        q: Nq with orthonormal columns, shape (nv, a).
        v: Nv with orthonormal columns, shape (nv, b).
    """

    q: Array
    v: Array


class StateTangent:
    """Tangent space of the consistent states of a system, in its integrated coordinates.

    Its dimension is that at the given state. The constraints must not lose rank there.

    Args:
        y: A consistent state in the integrated coordinates.

    Attributes:
        n: Dimension of a step.
        levels: 0 for entries of d_q, 1 for d_v, 2 for d_z, shape (n,).
        is_unconstrained: Whether the system has no constraints, so that all steps are allowed.
    """

    def __init__(self, system: System, y: State) -> None:
        self.system = system
        self.is_unconstrained = not system.bilateral.rows
        self._nz = len(y.z)
        unit = np.eye(system.nv)
        self._unity = Basis(unit, unit)
        self._unit_lift = np.eye(2 * system.nv + self._nz)
        self._bases = dict[int, tuple[State, Basis]]()
        self._lifts = dict[int, tuple[State, Array]]()
        self._ranks = system.nv, system.nv
        if not self.is_unconstrained:
            position_rows, velocity_rows = self._rows(y)
            self._ranks = _rank(position_rows), _rank(velocity_rows)
        self.n = 2 * system.nv - sum(self._ranks) + self._nz
        if self.is_unconstrained:
            self.n = 2 * system.nv + self._nz
        sizes = [system.nv - (0 if self.is_unconstrained else rank) for rank in self._ranks]
        self.levels = np.repeat((0, 1, 2), (*sizes, self._nz))

    def basis(self, y: State) -> Basis:
        """Return the basis at a state, which is the same in every call."""
        if self.is_unconstrained:
            return self._unity
        known = self._bases.get(id(y))
        if known is None or known[0] is not y:
            spans = (_null(J, r) for J, r in zip(self._rows(y), self._ranks, strict=True))
            known = _cache(self._bases, y, Basis(*spans))
        return known[1]

    def plus(self, y: State, d: Array) -> State:
        """Return the state y (+) d.

        Raises:
            SolveError: There is no consistent state near the end of the step.
        """
        spans = self.basis(y)
        a, b = spans.q.shape[1], spans.q.shape[1] + spans.v.shape[1]
        q = self.system.chart.integrate(y.q, spans.q.dot(d[:a]))
        z = self.system.internals.inside(y.z + d[b:]) if self._nz else y.z
        end = y._replace(q=q, v=y.v + spans.v.dot(d[a:b]), z=z)
        return end if self.is_unconstrained else project(self.system, end)

    def minus(self, y1: State, y0: State) -> Array:
        """Return the step d with y0 (+) d = y1, shape (n,)."""
        spans, chart = self.basis(y0), self.system.chart
        step = spans.q.T.dot(chart.difference(y0.q, y1.q))
        dv = y1.v - y0.v
        if not self.is_unconstrained:
            nv = self.system.nv
            dv = dv - self.lift(y0)[nv : 2 * nv, : len(step)].dot(step)
        return np.concatenate((step, spans.v.T.dot(dv), y1.z - y0.z))

    def lift(self, y: State) -> Array:
        """Return the matrix from steps d to those of `Chart.plus`, shape (2 nv + nz, n).

        A step of the configuration also changes the velocities that the constraints allow. This
        block is computed by finite differences of `project`.
        """
        if self.is_unconstrained:
            return self._unit_lift
        known = self._lifts.get(id(y))
        if known is None or known[0] is not y:
            known = _cache(self._lifts, y, self._compute_lift(y))
        return known[1]

    def _compute_lift(self, y: State) -> Array:
        nv, nz, spans = self.system.nv, self._nz, self.basis(y)
        a, b = spans.q.shape[1], spans.q.shape[1] + spans.v.shape[1]
        lift = np.zeros((2 * nv + nz, self.n))
        lift[:nv, :a], lift[nv : 2 * nv, a:b] = spans.q, spans.v
        lift[2 * nv :, b:] = np.eye(nz)
        for i in range(a):
            q = self.system.chart.integrate(y.q, _STEP * spans.q[:, i])
            lift[nv : 2 * nv, i] = (project(self.system, y._replace(q=q)).v - y.v) / _STEP
        return lift

    def lift_to_joints(self, y: State) -> Array:
        """Return the matrix from steps d to those of q and v of all joints, shape (2 nv, n)."""
        system, nv = self.system, self.system.nv
        model = system.robot.model
        if nv == model.nv:
            return self.lift(y)[: 2 * nv]
        lift, step, x = np.empty((2 * model.nv, self.n)), np.zeros(self.n), system.expand(y)
        for i in range(self.n):
            step[i] = _STEP
            near = system.expand(self.plus(y, step))
            lift[:, i] = np.concatenate((pin.difference(model, x.q, near.q), near.v - x.v)) / _STEP
            step[i] = 0.0
        return lift

    def restriction(self, y: State) -> Array:
        """Return the matrix from steps of `Chart.plus` to the nearest d, shape (n, 2 nv + nz)."""
        if self.is_unconstrained:
            return self._unit_lift
        nv, nz, spans = self.system.nv, self._nz, self.basis(y)
        a, b = spans.q.shape[1], spans.q.shape[1] + spans.v.shape[1]
        lower = np.zeros((self.n, 2 * nv + nz))
        lower[:a, :nv], lower[a:b, nv : 2 * nv] = spans.q.T, spans.v.T
        velocity_change = self.lift(y)[nv : 2 * nv, :a]
        lower[a:b, :nv] = -spans.v.T.dot(velocity_change).dot(spans.q.T)
        lower[b:, 2 * nv :] = np.eye(nz)
        return lower

    def transport(self, y0: State, y1: State) -> Array | None:
        """Return the matrix from steps at y0 to steps at y1, shape (n, n); None for identity."""
        if self.is_unconstrained or y0.q is y1.q:
            return None
        return self.restriction(y1).dot(self.lift(y0))

    def _rows(self, y: State) -> tuple[Array, Array]:
        system = self.system
        J = system.bilateral.jacobian(y.t, y.q)
        if len(system.rows) == len(system.bilateral.rows):
            return J, J
        return system.jacobian(y.t, y.q), J


def _cache(known: dict[int, tuple[State, Value]], y: State, value: Value) -> tuple[State, Value]:
    """Store a value of a state object, and drop the oldest of many entries."""
    if len(known) >= _STATES:
        known.pop(next(iter(known)))
    known[id(y)] = y, value
    return known[id(y)]


def _rank(J: Array) -> int:
    sizes = np.linalg.svd(_scaled(J), compute_uv=False)
    return int(np.count_nonzero(sizes > redundant(J.shape[1]) * sizes.max(initial=0.0)))


def _null(J: Array, rank: int) -> Array:
    return np.linalg.svd(_scaled(J))[2][rank:].T


def _scaled(J: Array) -> Array:
    """Return rows of unit length, so that metres and radians have equal weight."""
    sizes = np.linalg.norm(J, axis=1, keepdims=True)
    return J / np.where(sizes > 0.0, sizes, 1.0)
