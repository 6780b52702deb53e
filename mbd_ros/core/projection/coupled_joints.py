"""All joints as functions of the independent ones, q = F(y), with two derivatives.

Every dependent joint follows one other joint, so that it has one independent ancestor z_k: row i
of G = dF/dy holds one number, dF_i/dz_k, and so do its second derivatives.
"""

from collections.abc import Sequence
from typing import NamedTuple

import eigenpy
import numpy as np

from mbd_ros.core.model.couplings import CoupledPair
from mbd_ros.core.state import Array

_SUCCESS = eigenpy.ComputationInfo.Success


class Place(NamedTuple):
    """F and its derivatives at one y.

    Attributes:
        q: All positions [rad or m], shape (n,).
        slope: dF_i/dz_k of its ancestor, shape (n,).
        curvature: d2F_i/dz_k2, shape (n,).
        link_slopes: f' of each coupling at its parent, length m.
    """

    q: Array
    slope: Array
    curvature: Array
    link_slopes: list[float]


class CoupledJoints:
    """Couplings of a fixed-base robot; each function is evaluated once a place.

    Args:
        n: Number of joints.
        pairs: The couplings, parents before children.

    Attributes:
        free: The independent joints, shape (ny,).
        ancestry: 1 where a joint moves with an independent one, shape (n, ny).
    """

    def __init__(self, n: int, pairs: Sequence[CoupledPair]) -> None:
        self._pairs = tuple((pair.child_v, pair.parent_v, pair.function) for pair in pairs)
        self.free = np.setdiff1d(np.arange(n), [child for child, _, _ in self._pairs])
        self.ancestry = np.zeros((n, len(self.free)))
        self.ancestry[self.free, np.arange(len(self.free))] = 1.0
        for child, parent, _ in self._pairs:
            self.ancestry[child] = self.ancestry[parent]
        self._ones, self._zeros = [1.0] * n, [0.0] * n

    def at(self, start: Array) -> Place:
        """F and its derivatives.

        Args:
            start: Positions whose independent ones are y [rad or m], shape (n,).
        """
        q, slope, curvature = start.tolist(), self._ones.copy(), self._zeros.copy()
        slopes = []
        for child, parent, function in self._pairs:
            q[child], first, second = function(q[parent])
            up = slope[parent]
            slope[child] = first * up
            curvature[child] = second * up * up + first * curvature[parent]
            slopes.append(first)
        values = np.array((q, slope, curvature))
        return Place(values[0], values[1], values[2], slopes)

    def multipliers(self, forces: Array, link_slopes: list[float]) -> Array:
        """Multipliers of the couplings that carry forces to the independent joints, shape (m,).

        Args:
            forces: On all joints, shape (n,); those on the independent ones have no influence.
            link_slopes: Those of a `Place`.
        """
        carried = forces.tolist()
        for (child, parent, _), slope in zip(
            reversed(self._pairs), reversed(link_slopes), strict=True
        ):
            carried[parent] += slope * carried[child]
        return np.array([carried[child] for child, _, _ in self._pairs])

    def violation(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Residual g and its rate g' at any state of all joints, shapes (m,) and (m,)."""
        at, speed, g, rate = q.tolist(), v.tolist(), [], []
        for child, parent, function in self._pairs:
            follows, slope, _ = function(at[parent])
            g.append(at[child] - follows)
            rate.append(speed[child] - slope * speed[parent])
        return np.array(g), np.array(rate)


class Tangent:
    """Moves along the couplings, p = G dy, that cost 1/2 dy' H dy with H = G' W G + diag(h).

    Args:
        ancestry: That of the `CoupledJoints`, shape (n, ny).
        slope: dF_i/dz_k, shape (n,).
        W: Metric, shape (n, n).
        bend: What each joint adds to h, shape (n,).
    """

    def __init__(self, ancestry: Array, slope: Array, W: Array, bend: Array | None = None) -> None:
        self._ancestry, self._G = ancestry, ancestry * slope[:, None]
        H = self._G.T.dot(W.dot(self._G))
        if bend is not None:
            H += ancestry.T.dot(bend[:, None] * ancestry)
        self._cholesky = eigenpy.LLT(H)

    @property
    def is_convex(self) -> bool:
        """Whether H is definite."""
        return bool(self._cholesky.info() == _SUCCESS)

    def along(self, reduced: Array) -> Array:
        """Moves that forces on the independent joints cause, one a column."""
        return self._G.dot(self._cholesky.solve(reduced).reshape(reduced.shape))

    def moves(self, forces: Array) -> Array:
        """Moves that forces on all joints cause, one a column."""
        return self.along(self._G.T.dot(forces))

    def mobility(self) -> Array:
        """Moves per force of the independent joint that each one follows, shape (n,)."""
        reduced = self._ancestry.T
        moves = self._cholesky.solve(reduced).reshape(reduced.shape)
        return np.array((moves * reduced).sum(axis=0))
