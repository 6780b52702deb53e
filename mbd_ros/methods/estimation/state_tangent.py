"""Steps between states of a mechanism that stay on its constraints.

    x (+) d: q = q (+) Nq d_q,  v = v + Nv d_v,  z = z + d_z, then the nearest consistent state

Nq spans the steps that rows of positions allow, Nv the velocities that all rows allow. Without
rows both are unity and d is the step of `Chart.plus`. Source: P.-A. Absil, R. Mahony,
R. Sepulchre, Optimization Algorithms on Matrix Manifolds, 2008, ch. 4, on retractions.
"""

from typing import NamedTuple, TypeVar

import numpy as np
import pinocchio as pin

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import redundant
from mbd_ros.methods.projection.assembly import project

_STEP = 1.0e-6  # of differences of a projection [m, rad]
_STATES = 64  # whose directions are remembered: those of a window
Value = TypeVar("Value")


class Basis(NamedTuple):
    """Independent directions at a state.

    Attributes:
        q: Nq, orthonormal, shape (nv, a).
        v: Nv, orthonormal, shape (nv, b).
    """

    q: Array
    v: Array


class StateTangent:
    """The tangent of the consistent states of a system, in what it integrates.

    Its size is that of the start: a mechanism whose rows lose rank there has no such tangent.

    Args:
        y: A consistent state of what it integrates.

    Attributes:
        n: Size of a step.
        levels: 0 for its parts d_q, 1 for d_v, 2 for d_z, shape (n,).
        is_whole: Whether there are no rows, so that all steps are allowed.
    """

    def __init__(self, system: System, y: State) -> None:
        self.system, self.is_whole = system, not system.bilateral.rows
        self._nz = len(y.z)
        unit = np.eye(system.nv)
        self._unity, self._whole_lift = Basis(unit, unit), np.eye(2 * system.nv + self._nz)
        self._bases, self._lifts = (
            dict[int, tuple[State, Basis]](),
            dict[int, tuple[State, Array]](),
        )
        self._ranks = system.nv, system.nv
        if not self.is_whole:
            of_q, of_v = self._rows(y)
            self._ranks = _rank(of_q), _rank(of_v)
        self.n = 2 * system.nv - sum(self._ranks) + self._nz
        if self.is_whole:
            self.n = 2 * system.nv + self._nz
        sizes = [system.nv - (0 if self.is_whole else rank) for rank in self._ranks]
        self.levels = np.repeat((0, 1, 2), (*sizes, self._nz))

    def basis(self, y: State) -> Basis:
        """Independent directions at a state, the same whenever it is asked for."""
        if self.is_whole:
            return self._unity
        known = self._bases.get(id(y))
        if known is None or known[0] is not y:
            spans = (_null(J, r) for J, r in zip(self._rows(y), self._ranks, strict=True))
            known = _kept(self._bases, y, Basis(*spans))
        return known[1]

    def plus(self, y: State, d: Array) -> State:
        """The state y (+) d.

        Raises:
            SolveError: No consistent state is near.
        """
        spans = self.basis(y)
        a, b = spans.q.shape[1], spans.q.shape[1] + spans.v.shape[1]
        q = self.system.chart.integrate(y.q, spans.q.dot(d[:a]))
        z = self.system.internals.inside(y.z + d[b:]) if self._nz else y.z
        moved = y._replace(q=q, v=y.v + spans.v.dot(d[a:b]), z=z)
        return moved if self.is_whole else project(self.system, moved)

    def minus(self, y1: State, y0: State) -> Array:
        """The d with y0 (+) d = y1, shape (n,)."""
        spans, chart = self.basis(y0), self.system.chart
        step = spans.q.T.dot(chart.difference(y0.q, y1.q))
        rest = y1.v - y0.v
        if not self.is_whole:
            nv = self.system.nv
            rest = rest - self.lifted(y0)[nv : 2 * nv, : len(step)].dot(step)
        return np.concatenate((step, spans.v.T.dot(rest), y1.z - y0.z))

    def lifted(self, y: State) -> Array:
        """From steps d to those of `Chart.plus`, shape (2 nv + nz, n).

        A step along the rows turns the velocities that they allow: differences of `project`.
        """
        if self.is_whole:
            return self._whole_lift
        known = self._lifts.get(id(y))
        if known is None or known[0] is not y:
            known = _kept(self._lifts, y, self._lift(y))
        return known[1]

    def _lift(self, y: State) -> Array:
        nv, nz, spans = self.system.nv, self._nz, self.basis(y)
        a, b = spans.q.shape[1], spans.q.shape[1] + spans.v.shape[1]
        lift = np.zeros((2 * nv + nz, self.n))
        lift[:nv, :a], lift[nv : 2 * nv, a:b] = spans.q, spans.v
        lift[2 * nv :, b:] = np.eye(nz)
        for i in range(a):
            q = self.system.chart.integrate(y.q, _STEP * spans.q[:, i])
            lift[nv : 2 * nv, i] = (project(self.system, y._replace(q=q)).v - y.v) / _STEP
        return lift

    def of_all_joints(self, y: State) -> Array:
        """From steps d to those of q and v of all joints, shape (2 nv of the robot, n)."""
        system, nv = self.system, self.system.nv
        model = system.robot.model
        if nv == model.nv:
            return self.lifted(y)[: 2 * nv]
        found, step, x = np.empty((2 * model.nv, self.n)), np.zeros(self.n), system.expand(y)
        for i in range(self.n):
            step[i] = _STEP
            near = system.expand(self.plus(y, step))
            found[:, i] = (
                np.concatenate((pin.difference(model, x.q, near.q), near.v - x.v)) / _STEP
            )
            step[i] = 0.0
        return found

    def lowered(self, y: State) -> Array:
        """From steps of `Chart.plus` to the nearest d, shape (n, 2 nv + nz)."""
        if self.is_whole:
            return self._whole_lift
        nv, nz, spans = self.system.nv, self._nz, self.basis(y)
        a, b = spans.q.shape[1], spans.q.shape[1] + spans.v.shape[1]
        lower = np.zeros((self.n, 2 * nv + nz))
        lower[:a, :nv], lower[a:b, nv : 2 * nv] = spans.q.T, spans.v.T
        turned = self.lifted(y)[nv : 2 * nv, :a]
        lower[a:b, :nv] = -spans.v.T.dot(turned).dot(spans.q.T)
        lower[b:, 2 * nv :] = np.eye(nz)
        return lower

    def turned(self, y0: State, y1: State) -> Array | None:
        """From steps at y0 to those at a state beside it, shape (n, n); None for unity."""
        if self.is_whole or y0.q is y1.q:
            return None
        return self.lowered(y1).dot(self.lifted(y0))

    def _rows(self, y: State) -> tuple[Array, Array]:
        system = self.system
        J = system.bilateral.jacobian(y.t, y.q)
        if len(system.rows) == len(system.bilateral.rows):
            return J, J
        return system.jacobian(y.t, y.q), J


def _kept(known: dict[int, tuple[State, Value]], y: State, value: Value) -> tuple[State, Value]:
    """Remember what belongs to a state, which stays alive as long; only for the newest ones."""
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
    """Rows of length one: metres and radians count alike."""
    sizes = np.linalg.norm(J, axis=1, keepdims=True)
    return J / np.where(sizes > 0.0, sizes, 1.0)
