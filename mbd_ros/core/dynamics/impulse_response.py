"""How impulses of some rows move joints that bilateral rows hold."""

from copy import copy

import eigenpy
import numpy as np

from mbd_ros.core.rows.row_factor import RowFactor
from mbd_ros.core.state import Array

_PROJECTIONS = 2  # the second one takes what rounding leaves where rows hold most of a motion


class ImpulseResponse:
    """Changes of the velocity M^-1 J' p, without what bilateral rows J_b v = goal forbid.

    Args:
        M: Mass matrix, or what stands for it, symmetric, shape (nv, nv).
        J: Rows with impulses, shape (m, nv); None where they follow by `of`.
        hold: Bilateral rows, shape (m_b, nv).
        factor: Their factor in the metric of M; None without any.

    Attributes:
        X: Changes of the velocity by each impulse, shape (nv, m).
        A: Changes of the rates of the rows, shape (m, m).
        loose: Diagonal of A without the bilateral rows, shape (m,).
    """

    def __init__(self, M: Array, J: Array | None, hold: Array, factor: RowFactor | None) -> None:
        self._mass, self._hold, self._factor = eigenpy.LLT(M), hold, factor
        if J is not None:
            self._respond(J)

    def of(self, J: Array) -> "ImpulseResponse":
        """That of other rows, shape (m, nv), under the same mass and bilateral rows."""
        other = copy(self)
        other._respond(J)
        return other

    @property
    def is_free(self) -> bool:
        """Whether no bilateral row holds."""
        return self._factor is None

    def _respond(self, J: Array) -> None:
        self.X, hold, factor = self.free(J.T), self._hold, self._factor
        self.loose = np.einsum("ij,ji->i", J, self.X)
        self._held = np.zeros((len(hold), len(J)))
        for _ in range(_PROJECTIONS if factor is not None else 0):
            assert factor is not None
            held = factor.solve(hold.dot(self.X))
            self._held, self.X = self._held + held, self.X - factor.X.dot(held)
        self.A = J.dot(self.X)

    @property
    def G(self) -> Array:
        """The X in the metric of M, A = G' G, shape (nv, m)."""
        upper: Array = self._mass.matrixU()
        return upper.dot(self.X)

    def free(self, impulse: Array) -> Array:
        """Changes of the velocity by impulses on joints that nothing holds, shape as given."""
        v: Array = self._mass.solve(impulse).reshape(impulse.shape)  # eigenpy flattens one column
        return v

    def kept(self, v: Array, goal: Array) -> tuple[Array, Array]:
        """The nearest velocity with J_b v = goal, and the bilateral impulses for it."""
        if self._factor is None:
            return v, goal
        p = self._factor.solve(goal - self._hold.dot(v))
        return v + self._factor.X.dot(p), p

    def bilateral(self, p: Array) -> Array:
        """Bilateral impulses that answer those of the rows, shape (m_b,)."""
        return -self._held.dot(p)
