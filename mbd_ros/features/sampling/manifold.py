"""Configurations that keep rows: projection of velocities, steps along them, their metric."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.features.sampling.space import Block, Marks, Space, inverse, log_determinant, solve

_CLOSED = 1.0e-13  # of the scale: distance from the rows at which a step ends
_KEPT = 1.0e-11  # of the scale: what rounding may leave open far from the origin
_MOST = 12  # corrections of a step
_APART = 1.0e-5  # of the scale: steps of differences of Jacobians


class Manifold:
    """All configurations of a space that keep its rows.

    Attributes:
        parts: Its blocks.
    """

    def __init__(self, space: Space) -> None:
        self.space = space
        self.parts = [BlockRows(block, space.mass, space.scale) for block in space.blocks]

    def at(self, q: Array) -> list[Place]:
        """Rows of all blocks at configurations, shape (size, chains)."""
        return [part.at(part.of(q)) for part in self.parts]

    def project(self, places: list[Place], v: Array) -> Array:
        """The nearest velocities with J v = 0, shape as v."""
        for part, place in zip(self.parts, places, strict=True):
            v = part.put(v, part.project(place, part.of(v)))
        return v

    def close(self, places: list[Place], q: Array) -> tuple[Array, Marks]:
        """Configurations on the rows from those near them, and which were found, (chains,)."""
        found: Marks = np.asarray(np.isfinite(q).all(axis=0))
        for part, place in zip(self.parts, places, strict=True):
            x, well = part.close(place, part.of(q))
            q = part.put(q, x)
            found = found & well.reshape(part.block.copies, -1).all(axis=0)
        return q, found

    def log_gram(self, places: list[Place]) -> Array:
        """Logarithm of det J M^-1 J', the sum of all blocks, shape (chains,)."""
        total = np.zeros(1)
        for part, place in zip(self.parts, places, strict=True):
            total = total + log_determinant(place.A).reshape(part.block.copies, -1).sum(axis=0)
        return total

    def log_gradient(self, places: list[Place], q: Array) -> Array:
        """Gradient of 1/2 ln det J M^-1 J', shape (size, chains)."""
        total = np.zeros(q.shape)
        for part, place in zip(self.parts, places, strict=True):
            total = part.put(total, part.log_gradient(place, part.of(q)))
        return total


class BlockRows:
    """The rows of a block in the metric of masses.

    Args:
        mass: Masses of all coordinates, shape (size of the space,).
        scale: A usual length.
    """

    def __init__(self, block: Block, mass: Array, scale: float) -> None:
        self.block = block
        self._scale = scale
        mine = mass[:, None] if block.coordinates is None else mass[block.coordinates]
        self._lightness = 1.0 / mine[:, :, None]  # (size, copies, 1)

    def of(self, q: Array) -> Array:
        """The coordinates of the block, shape (size, copies * chains)."""
        at = self.block.coordinates
        return q if at is None else q[at].reshape(len(at), -1)

    def put(self, q: Array, x: Array) -> Array:
        """Configurations with other coordinates in the block."""
        at = self.block.coordinates
        if at is None:
            return x
        q = q.copy()
        q[at] = x.reshape(*at.shape, -1)
        return q

    def at(self, x: Array) -> Place:
        """Rows at coordinates of the block."""
        J = self.block.jacobian(x)
        by_copy = J.reshape(*J.shape[:2], self.block.copies, -1)
        D = (by_copy * self._lightness).reshape(J.shape)
        return Place(J, D, np.einsum("aib,cib->acb", J, D))

    def project(self, place: Place, v: Array) -> Array:
        """The nearest velocity in the metric of masses with J v = 0."""
        s = solve(place.A, np.einsum("aib,ib->ab", place.J, v))
        nearest: Array = v - np.einsum("aib,ab->ib", place.D, s)
        return nearest

    def close(self, place: Place, x: Array) -> tuple[Array, Marks]:
        """The configurations x - D s on the rows, and which were found, shape (n,).

        Args:
            place: Rows in whose directions D x is moved.
            x: Coordinates off the rows.
        """
        size = np.sqrt(np.einsum("aib,aib->ab", place.J, place.J))
        x, found = x.copy(), np.zeros(x.shape[1], dtype=np.bool_)
        left, D, at = np.arange(x.shape[1]), place.D, x
        last = np.full(len(left), np.inf)
        with np.errstate(all="ignore"):
            for _ in range(_MOST):
                g = self.block.residual(at)
                off = np.abs(g / size).max(axis=0)
                is_there = off <= _CLOSED * self._scale
                is_there |= (off <= _KEPT * self._scale) & (off >= 0.5 * last)
                goes_on = ~is_there & np.isfinite(off)
                if not goes_on.all():
                    x[:, left], found[left] = at, is_there
                    left, at, D, g = left[goes_on], at[:, goes_on], D[:, :, goes_on], g[:, goes_on]
                    size, off = size[:, goes_on], off[goes_on]
                    if not len(left):
                        break
                slope = np.einsum("aib,cib->acb", self.block.jacobian(at), D)
                at, last = at - np.einsum("aib,ab->ib", D, solve(slope, g)), off
        return x, found

    def log_gradient(self, place: Place, x: Array) -> Array:
        """Gradient of 1/2 ln det A: the sum over rows a of H_a (A^-1 D)_a, shape (size, n)."""
        W = np.einsum("acb,cib->aib", inverse(place.A), place.D)
        total = np.zeros(x.shape)
        for a, w in enumerate(W):
            total += self.turned(x, w)[a]
        return total

    def turned(self, x: Array, w: Array) -> Array:
        """Change of the Jacobian along w: H_a w of every row a, shape (m, size, n)."""
        long = np.sqrt((w * w).sum(axis=0))
        step = _APART * self._scale / np.where(long > 0.0, long, 1.0)
        ahead, behind = self.block.jacobian(x + step * w), self.block.jacobian(x - step * w)
        change: Array = (ahead - behind) / (2.0 * step)
        return change


class Place(NamedTuple):
    """Rows at configurations.

    Attributes:
        J: Their Jacobian, shape (m, size, n).
        D: M^-1 J', as (m, size, n).
        A: J M^-1 J', shape (m, m, n).
    """

    J: Array
    D: Array
    A: Array
