"""How far markers are from where they were seen, over many frames at once, with two derivatives.

    f(y) = sum_i w_i |p_i(q) - m_i|^2 / (2 sum_i w_i) + sum_c w_c (q_c - q0_c)^2 / 2,   q = F(y)

A marker that was not seen in a frame weighs 0 there. With the columns (v_k, omega_k) of the
spatial Jacobian about the world's origin, a marker moves by u_ik = v_k + omega_k x p_i, and

    d2 p_i / dq_j dq_k = omega_j x u_ik    (j not beyond k, symmetric in the axes of a free body)

so that f, its slope and its exact Hessian follow from sums over the markers that a column moves:
of w, w p, w p p', w e and w p e', e = p - m. The slopes of couplings join in with their
curvature.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.kinematics.poses import cross
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.points import Point
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array

Frames = NDArray[np.intp] | slice
_SHARES = 25  # numbers of a marker that are summed: w, w p, w p p', w e, w p e'


class MarkerCost:
    """The objective of markers on a robot.

    Args:
        couplings: Its dependent joints.
        points: Where the markers are.
        tasks: Weights of coordinate tasks [m^2/rad^2 or 1], shape (nv,).

    Attributes:
        ancestry: 1 where a joint moves with an independent coordinate, shape (nv, ny).
        y_of_q: Where the independent coordinates stand in q, those of a free body all where its
            coordinates begin, shape (ny,).
        reached: 1 where markers or tasks depend on an independent coordinate, shape (ny,).
    """

    def __init__(
        self, robot: Robot, couplings: Couplings, points: Sequence[Point], tasks: Array
    ) -> None:
        model = robot.model
        places = [robot.places.points[point.number] for point in points]
        self._model, self._data, self.couplings = model, pin.Data(model), couplings
        self._tasks, self._task_q = tasks, q_of_v(model)
        self._carriers = sorted({place.joint for place in places})
        of = [self._carriers.index(place.joint) for place in places]
        self._of_marker = np.array(of, dtype=np.intp)
        self._local = np.array([place.at.translation for place in places]).reshape(-1, 3)
        held = [self._data.oMi[joint] for joint in self._carriers]
        self._views = [(pose.rotation, pose.translation) for pose in held]  # live
        self._order, self._moved = orders(model, [place.joint for place in places])
        self.ancestry = ancestry_of(couplings, model.nv)
        self._coupled = bool(couplings.pairs)
        self.y_of_q = self._task_q[couplings.v_index]
        self.reached = ((self._moved.any(axis=1) | (tasks > 0.0)) @ self.ancestry > 0.0) * 1.0

    def at(self, q: Array, seen: Seen, bent: Array | None = None) -> Cost:
        """The objective.

        Args:
            q: Configurations that keep the couplings, shape (N, nq).
            bent: Shares, 0 to 1, of what misses add to the Hessian, shape (N,); all of it by
                default. Without it no direction has a negative curvature.
        """
        slopes, bends = self._slopes(q)
        p, J = self._kinematics(q)
        misses = p - seen.places
        bent = np.ones(len(q)) if bent is None else bent
        value = 0.5 * (seen.weights * (misses * misses).sum(axis=2)).sum(axis=1)
        slope, hessian = self._derivatives(p, misses, seen.weights, J, bent)
        if self._tasks.any():
            off = q[:, self._task_q] - seen.targets
            value += 0.5 * (off * off) @ self._tasks
            slope += self._tasks * off
            every = np.arange(len(self._tasks))
            hessian[:, every, every] += self._tasks
        G = self.ancestry * slopes[:, :, None]
        if not self._coupled:
            at = self.couplings.v_index
            return Cost(value, slope[:, at], hessian[:, at[:, None], at], G, misses)
        hessian = G.transpose(0, 2, 1) @ hessian @ G
        every = np.arange(G.shape[2])
        hessian[:, every, every] += (bends * slope * bent[:, None]) @ self.ancestry
        return Cost(value, (slopes * slope) @ self.ancestry, hessian, G, misses)

    def rows(self, q: Array) -> Array:
        """Derivatives of the markers by the independent coordinates, shape (N, n, 3, ny)."""
        p, J = self._kinematics(q)
        G = self.tangent(q)
        v, omega = J[:, None, :3].transpose(0, 1, 3, 2), J[:, None, 3:].transpose(0, 1, 3, 2)
        moves = (v + cross(omega, p[:, :, None])) * self._moved.T[None, :, :, None]
        return np.array(moves.transpose(0, 1, 3, 2) @ G[:, None])

    def moved(self, q: Array, dy: Array) -> Array:
        """Configurations after moves of the independent coordinates, couplings kept.

        Args:
            q: Shape (N, nq).
            dy: Shape (N, ny).
        """
        step = np.zeros((len(q), self._model.nv))
        step[:, self.couplings.v_index] = dy
        if self._model.nq == self._model.nv:
            return self.coupled(q + step)
        each = zip(q, step, strict=True)
        return self.coupled(np.array([pin.integrate(self._model, *pair) for pair in each]))

    def tangent(self, q: Array) -> Array:
        """G = dq/dy, shape (N, nv, ny)."""
        return self.ancestry * self._slopes(q)[0][:, :, None]

    def coupled(self, q: Array) -> Array:
        """The configurations with dependent joints brought to where couplings put them."""
        return self._expanded(q)[0] if self._coupled else q

    def _slopes(self, q: Array) -> tuple[Array, Array]:
        """dq/dz and d2q/dz2 of every joint by its independent ancestor, shapes (N, nv)."""
        if self._coupled:
            return self._expanded(q)[1:]
        shape = len(q), self._model.nv
        return np.ones(shape), np.zeros(shape)

    def _expanded(self, q: Array) -> tuple[Array, Array, Array]:
        """F with two derivatives, each by the independent ancestor of a joint."""
        nv, N = self._model.nv, len(q)
        if N == 1:  # numbers are faster than arrays of one
            one, first, second = np.array(q[0]), np.ones(nv), np.zeros(nv)
            self.couplings.expand(one, first, second)
            return one[None], first[None], second[None]
        whole, first, second = np.array(q.T), np.ones((nv, N)), np.zeros((nv, N))
        self.couplings.expand(whole, first, second)
        return whole.T, first.T, second.T

    def _kinematics(self, q: Array) -> tuple[Array, Array]:
        """Markers less `Robot.origin`, (N, n, 3), and Jacobians about it, (N, 6, nv)."""
        model, data, views = self._model, self._data, self._views
        N, nv = len(q), model.nv
        R, at, J = (
            np.empty((N, len(views), 3, 3)),
            np.empty((N, len(views), 3)),
            np.empty((N, 6, nv)),
        )
        for i in range(N):
            J[i] = pin.computeJointJacobians(model, data, q[i])
            for b, (rotation, translation) in enumerate(views):
                R[i, b], at[i, b] = rotation, translation
        of = self._of_marker
        return np.einsum("niab,ib->nia", R[:, of], self._local) + at[:, of], J

    def _derivatives(
        self, p: Array, e: Array, w: Array, J: Array, bent: Array
    ) -> tuple[Array, Array]:
        """Slope and Hessian of the markers' share by all velocities."""
        N, n, _ = p.shape
        shares = np.empty((N, n, _SHARES))
        wp = w[:, :, None] * p
        shares[:, :, 0], shares[:, :, 1:4] = w, wp
        shares[:, :, 4:13] = (wp[:, :, :, None] * p[:, :, None, :]).reshape(N, n, 9)
        shares[:, :, 13:16] = w[:, :, None] * e
        shares[:, :, 16:25] = (wp[:, :, :, None] * e[:, :, None, :]).reshape(N, n, 9)
        sums = self._moved @ shares  # (N, nv, 25)
        w0, w1, F = sums[:, :, :1], sums[:, :, 1:4], sums[:, :, 13:16]
        C = sums[:, :, 16:25]
        v, omega = J[:, :3].transpose(0, 2, 1), J[:, 3:].transpose(0, 2, 1)
        spin = C[:, :, [5, 6, 1]] - C[:, :, [7, 2, 3]]  # of p x e
        slope = (v * F).sum(axis=2) + (omega * spin).sum(axis=2)
        part = bent[:, None, None]
        turned = (part * C - sums[:, :, 4:13]).reshape(N, J.shape[2], 3, 3)
        linear = w0 * v + cross(omega, w1)
        angular = cross(v, part * F - w1) + _less_trace(turned, omega)
        half = v @ linear.transpose(0, 2, 1) + omega @ angular.transpose(0, 2, 1)
        half *= self._order
        return slope, half + half.transpose(0, 2, 1)


class Seen(NamedTuple):
    """Marker positions in some frames.

    Attributes:
        places: Markers in the world less `Robot.origin` [m], shape (N, n, 3); anything finite
            where they were not seen.
        weights: Of the markers, 0 where they were not seen, shape (N, n); with a sum of 1, or 0.
        targets: Positions that coordinate tasks ask for [rad or m], shape (N, nv).
        times: [s], shape (N,).
    """

    places: Array
    weights: Array
    targets: Array
    times: Array

    def of(self, frames: Frames) -> Seen:
        """Some of the frames."""
        return Seen(*(each[frames] for each in self))


class Cost(NamedTuple):
    """The objective f in some frames.

    Attributes:
        value: f [m^2], shape (N,).
        slope: By the independent coordinates, shape (N, ny).
        hessian: Shape (N, ny, ny).
        G: dq/dy, shape (N, nv, ny).
        misses: Markers less where they were seen [m], shape (N, n, 3).
    """

    value: Array
    slope: Array
    hessian: Array
    G: Array
    misses: Array


def orders(model: pin.Model, carriers: list[int]) -> tuple[Array, Array]:
    """Dependence of coordinates on one another, and of markers on coordinates.

    Returns:
        1 where j stands before k on a chain, 1/2 where both belong to one joint, else 0, shape
        (nv, nv); 1 where a coordinate moves a marker, shape (nv, n).
    """
    joint_of = np.zeros(model.nv, dtype=np.intp)
    for j, joint in enumerate(model.joints):
        if j:
            joint_of[joint.idx_v : joint.idx_v + joint.nv] = j
    above = np.zeros((model.njoints, model.njoints))
    for j in range(model.njoints):
        above[list(model.supports[j]), j] = 1.0
    np.fill_diagonal(above, 0.5)
    order = above[np.ix_(joint_of, joint_of)]
    moved = above[np.ix_(joint_of, np.array(carriers, dtype=np.intp))] > 0.0
    return order, moved.astype(np.float64)


def ancestry_of(couplings: Couplings, nv: int) -> Array:
    """1 where a joint follows an independent one, or is it, shape (nv, ny)."""
    ancestry = np.zeros((nv, len(couplings.v_index)))
    ancestry[couplings.v_index, np.arange(len(couplings.v_index))] = 1.0
    for pair in couplings.pairs:
        ancestry[pair.child_v] = ancestry[pair.parent_v]
    return ancestry


def q_of_v(model: pin.Model) -> Array:
    """Place in q of every velocity coordinate; those of free bodies get that of the body."""
    place = np.zeros(model.nv, dtype=np.intp)
    for joint in list(model.joints)[1:]:
        place[joint.idx_v : joint.idx_v + joint.nv] = joint.idx_q
    return place


def _less_trace(A: Array, vectors: Array) -> Array:
    """(A - tr(A) 1) x of every matrix and vector."""
    trace = A[..., 0, 0] + A[..., 1, 1] + A[..., 2, 2]
    return np.array((A @ vectors[..., None])[..., 0] - trace[..., None] * vectors)
