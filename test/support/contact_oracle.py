"""Laws of contact along a motion, looked at from its states alone.

Pinocchio gives mass matrix and velocities of points; shapes, touches, cones and forces are found
here. An impulse that a step needs, M (v+ - v) + h nle, must be one that the touches can give: it
is fitted by rays of their cones, non-negative, as least squares in the mass metric.
"""

import itertools
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from contact_geometry import Placed, touches, turned
from scipy.optimize import nnls

RAYS = 24
ROUNDING = 1e-12  # of the energy beside the ground: what a heavy body at rest gains and loses
NEAR = 2.0  # ways of a step: touches that may have acted in it


class Side(NamedTuple):
    """A shape of a scene: link or body, kind, sizes, placement in it."""

    frame: str
    kind: str
    size: object
    xyz: tuple = (0.0, 0.0, 0.0)
    rpy: tuple = (0.0, 0.0, 0.0)


class Pair(NamedTuple):
    """Two shapes that may touch, and what a scene says of them."""

    name: str
    a: Side
    b: Side
    mu: float = 0.0
    e: float = 0.0


class Worst(NamedTuple):
    """Largest faults of a motion; none of them has a sign that excuses it.

    Attributes:
        depth: Penetration [m].
        gain: Energy gained in a step, of the largest energy that was to be had.
        unlike: Impulse that no touch can give, of the largest one or of the loads, by mass metric.
    """

    depth: float
    gain: float
    unlike: float


class Oracle:
    """Looks at the states of one scene.

    Args:
        model: Pinocchio model of the scene.
        pairs: What may touch.
        origin: Where the model's world stands, shape (3,).
        G: Function of q that gives the coupling Jacobian; none without couplings.
        tau: Constant torques of all coordinates.
    """

    def __init__(self, model, pairs, origin=(0.0, 0.0, 0.0), G=None, tau=0.0):
        self.model, self.data, self.pairs = model, model.createData(), pairs
        self.origin, self.G, self.tau = np.array(origin), G, tau
        index = {side.frame: self._frame(side.frame) for pair in pairs for side in pair[1:3]}
        self.index = index

    def _frame(self, name):
        return self.model.getFrameId(name) if name != "world" else 0

    def _placed(self, side):
        M = self.data.oMf[self.index[side.frame]]
        R, p = M.rotation, M.translation
        if side.frame == "world":
            p = p - self.origin
        return Placed(side.kind, side.size, R @ turned(side.rpy), p + R @ np.array(side.xyz))

    def touches(self, q):
        """Every touch with its pair, at a configuration."""
        pin.framesForwardKinematics(self.model, self.data, q)
        for pair in self.pairs:
            for touch in touches(self._placed(pair.a), self._placed(pair.b)):
                yield pair, touch

    def gaps(self, q):
        return np.array([touch.gap for _, touch in self.touches(q)])

    def energy(self, x):
        kinetic = pin.computeKineticEnergy(self.model, self.data, x.q, x.v)
        return kinetic + pin.computePotentialEnergy(self.model, self.data, x.q) - self._work(x.q)

    def _work(self, q):
        """Of constant torques, on joints alone."""
        return float(np.sum(self.tau * q)) if np.any(self.tau) else 0.0

    def jacobian(self, q, frame, point):
        """Of the velocity of a point that moves with a frame, world axes, shape (3, nv)."""
        J = pin.computeFrameJacobian(
            self.model, self.data, q, self.index[frame], pin.LOCAL_WORLD_ALIGNED
        )
        arm = point - self.data.oMf[self.index[frame]].translation
        return J[:3] - pin.skew(arm) @ J[3:]

    def rays(self, q, reach):
        """Generalised impulses of the edges of all cones that are near, shape (nv, rays)."""
        found = []
        for pair, touch in list(self.touches(q)):
            if touch.gap > reach:
                continue
            J = self.jacobian(q, pair.a.frame, touch.point)
            if pair.b.frame != "world":
                J = J - self.jacobian(q, pair.b.frame, touch.point)
            x = np.cross(touch.normal, np.eye(3)[np.argmin(np.abs(touch.normal))])
            x /= np.linalg.norm(x)
            y = np.cross(touch.normal, x)
            mu = pair.mu / np.cos(np.pi / RAYS)
            for t in 2 * np.pi * np.arange(RAYS if mu else 1) / RAYS:
                way = touch.normal + mu * (np.cos(t) * x + np.sin(t) * y)
                found.append(J.T @ way)
        return np.array(found).T if found else np.zeros((self.model.nv, 0))

    def unlike(self, x0, x1):
        """What a step needs and touches cannot give, and how large impulses are, in sqrt(J)."""
        h = x1.t - x0.t
        q = pin.integrate(self.model, x0.q, 0.5 * pin.difference(self.model, x0.q, x1.q))
        v = 0.5 * (x0.v + x1.v)
        M = pin.crba(self.model, self.data, q)
        M = np.triu(M) + np.triu(M, 1).T
        load = pin.nonLinearEffects(self.model, self.data, q, v) - self.tau
        needed = M @ (x1.v - x0.v) + h * load
        if self.G is not None:
            G = self.G(q)
            M, needed, load = G.T @ M @ G, G.T @ needed, G.T @ load
        rays = self.rays(q, NEAR * h * self._speed(x0, x1) + 1e-9)
        if self.G is not None:
            rays = G.T @ rays
        L = np.linalg.cholesky(M)
        b, A = np.linalg.solve(L, needed), np.linalg.solve(L, rays)
        A = A / np.maximum(np.linalg.norm(A, axis=0), 1e-300)
        left = nnls(A, b, maxiter=100 * max(A.shape))[1] if A.size else np.linalg.norm(b)
        weight = np.linalg.norm(np.linalg.solve(L, h * load))
        return left, max(np.linalg.norm(b), weight)

    def _speed(self, *states):
        """Largest speed of a body's corner, roughly."""
        fastest = 0.0
        for x in states:
            pin.forwardKinematics(self.model, self.data, x.q, x.v)
            for side in (
                side for pair in self.pairs for side in pair[1:3] if side.frame != "world"
            ):
                frame = self.index[side.frame]
                speed = pin.getFrameVelocity(self.model, self.data, frame, pin.LOCAL)
                size = np.abs(np.hstack([np.ravel(_numbers(side.size)), np.ravel(side.xyz)])).sum()
                fastest = max(
                    fastest, np.linalg.norm(speed.linear) + np.linalg.norm(speed.angular) * size
                )
        return fastest + 9.81 * (states[-1].t - states[0].t)

    def worst(self, states):
        """Faults of a motion whose states are the steps."""
        depth, gain, unlike, most = 0.0, 0.0, 0.0, 0.0
        energies = [self.energy(x) for x in states]
        scale = max(
            np.ptp(energies),
            max(pin.computeKineticEnergy(self.model, self.data, x.q, x.v) for x in states),
            1e-300,
        )
        for x in states:
            depth = max(depth, -self.gaps(x.q).min())
        for x0, x1 in itertools.pairwise(states):
            left, needed = self.unlike(x0, x1)
            unlike, most = max(unlike, left), max(most, needed)
        rounding = ROUNDING * np.abs(energies).max()
        gain = max(np.diff(energies).max() - rounding, 0.0) / scale
        return Worst(depth, gain, unlike / max(most, 1e-300))


def _numbers(size):
    return list(size.values()) if isinstance(size, dict) else size
