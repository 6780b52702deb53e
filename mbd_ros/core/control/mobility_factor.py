"""Efforts that give accelerations, also where actuation is redundant."""

import eigenpy
import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import NEARLY_SINGULAR
from mbd_ros.errors import SolveError

_SUCCESS = eigenpy.ComputationInfo.Success


class MobilityFactor:
    """Solves A tau = a for a mobility A, symmetric and positive semidefinite.

    A Cholesky factor serves a regular A. Otherwise, with more drives than freedoms or near a
    toggle, the eigenvectors v_i of A decide:

        tau = sum of v_i (v_i' a) / l_i  over  l_i > 1e-9 l_max

    This is the effort of least norm whose acceleration comes nearest to a; a part that no
    effort can give is left out, instead of asked for with huge efforts.

    Args:
        mobility: A [acceleration per effort], shape (n, n).

    Attributes:
        is_regular: Whether every acceleration can be given.

    Raises:
        SolveError: A is not finite.

    Source: G. H. Golub, C. F. Van Loan, Matrix Computations, 4th ed., 2013, sec. 5.5.2
        (truncated pseudo-inverse).
    """

    def __init__(self, mobility: Array) -> None:
        self._cholesky = eigenpy.LLT(mobility)
        self.is_regular = bool(
            self._cholesky.info() == _SUCCESS and self._cholesky.rcond() > NEARLY_SINGULAR
        )
        if self.is_regular:
            return
        if not np.isfinite(mobility).all():
            raise SolveError("the mobility of the controlled joints is not finite")
        solver = eigenpy.SelfAdjointEigenSolver(mobility)
        values, vectors = solver.eigenvalues(), solver.eigenvectors()
        kept = values > NEARLY_SINGULAR * values[-1]
        self._values, self._vectors = values[kept], vectors[:, kept]

    def solve(self, a: Array) -> Array:
        """Efforts for accelerations, shape (n,); or for one acceleration a column."""
        if self.is_regular:
            return self._cholesky.solve(a).reshape(a.shape)  # eigenpy has its own for n = 1
        return (self._vectors / self._values).dot(self._vectors.T.dot(a))

    def reachable(self, a: Array) -> Array:
        """The part of accelerations that efforts can give, shape (n,)."""
        return a if self.is_regular else self._vectors.dot(self._vectors.T.dot(a))
