"""The mass matrix of points as an operator: a diagonal."""

import numpy as np

from mbd_ros.core.state import Array


class ParticleMass:
    """M of points; products and solutions cost as much as a vector.

    Args:
        diagonal: Mass of each coordinate, shape (nv,).
    """

    def __init__(self, diagonal: Array) -> None:
        self._diagonal = diagonal

    @property
    def dense(self) -> Array:
        """The matrix, for who can pay."""
        return np.diag(self._diagonal)

    def dot(self, v: Array) -> Array:
        """M v, shape as v."""
        product: Array = (self._diagonal * v.T).T
        return product

    def diagonal(self) -> Array:
        """Entries of the diagonal, shape (nv,)."""
        return self._diagonal

    def solve(self, force: Array) -> Array:
        """M^-1 force, shape as `force`, (nv,) or (nv, k)."""
        a: Array = (force.T / self._diagonal).T
        return a
