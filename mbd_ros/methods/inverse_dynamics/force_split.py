"""Split of a generalized force into efforts of actuators and multipliers of constraints.

    E e + J' lam = b

With the motions Z that the rows allow, J Z = 0 and Z' M Z = 1, the multipliers drop out:
Z' E e = Z' b. Source: Y. Nakamura, M. Ghodoussi, IEEE Trans. Robotics and Automation 5 (1989)
294, doi:10.1109/70.34765; there with Z from the derivative of the joint positions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.optimization.least_norm import Least, Limits, least_in_bounds, least_in_cones
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import SINGULAR
from mbd_ros.errors import SolveError

_REST_RATE = 1.0e-3  # scaled rates of rows below this norm count as rest
_TAKES_PART = 1.0e-6  # least share of an unknown in the null space; rounding leaves 1e-9 there
_FREE = -np.inf, np.inf
_BOUND_TOLERANCE = 1.0e-9  # excess over a limit of a contact, relative to the largest force
_PRIORITIES = 1.0, 1.0e-3, 1.0e-6, 1.0e-8  # weights of the goals, the most important one first


class ForceSplit:
    """Factorization of E e + J' lam = b at one state.

    The effort e has the smallest Euclidean norm in SI numbers among those that fit, which does not
    depend on how the constraints are formulated. For this e, lam has the smallest norm. Ranks are
    those of columns scaled in the metric M^-1, so that units have no influence on them.

    Args:
        M: Mass matrix, shape (nv, nv).
        E: Generalized force of every effort, one a column, shape (nv, ne).
        J: Constraint Jacobian, shape (m, nv).
        usual: Characteristic norm of each column of E and J', shape (ne + m,). It distinguishes a
            column that vanishes at a toggle from one that is small everywhere.

    Attributes:
        freedom: Number of independent motions that the constraints allow.
        driven: Number of these that the efforts can accelerate.
        rank: Number of independent forces that efforts and multipliers exert together.
        null_space: Dimension of the (e, lam) that together exert no force.
        condition: Largest ratio of singular values; beyond 1e6 the result is unreliable.

    Raises:
        SolveError: The mass matrix is singular or not finite.
    """

    def __init__(self, M: Array, E: Array, J: Array, usual: Array) -> None:
        self._E, self._J, n = E, J, E.shape[1]
        try:
            self._L = np.linalg.cholesky(M)
            columns = np.linalg.solve(self._L, np.concatenate((E, J.T), axis=1))
            self._size = np.maximum(np.sqrt(np.einsum("ij,ij->j", columns, columns)), usual)
            scale = 1.0 / np.where(self._size > 0.0, self._size, 1.0)
            columns *= scale
            self._rows = _Inverse(columns[:, n:], scale[n:])
            self._Z = self._rows.outside
            self._efforts = _Inverse(self._Z.T.dot(columns[:, :n]), scale[:n])
        except np.linalg.LinAlgError as error:
            raise SolveError("the mass matrix or the rows are singular or not finite") from error
        self.freedom, self.driven = self._Z.shape[1], self._efforts.rank
        self.rank = self.driven + self._rows.rank
        self.null_space = n + len(J) - self.rank
        self.condition = max(self._rows.condition, self._efforts.condition)

    def solve(self, b: Array) -> Split:
        """Split a generalized force b, shape (nv,), with one step of iterative refinement."""
        e, lam = self._solve(b)
        more_e, more_lam = self._solve(b - self._E.dot(e) - self._J.T.dot(lam))
        return self.evaluate(b, e + more_e, lam + more_lam)

    def evaluate(self, b: Array, e: Array, lam: Array) -> Split:
        """Return a split of b, shape (nv,), with its residual."""
        weighted = np.linalg.solve(self._L, b - self._E.dot(e) - self._J.T.dot(lam))
        norm = float(np.linalg.norm(weighted))
        return Split(e, lam, np.linalg.solve(self._L.T, weighted), norm)

    def norm(self, b: Array) -> float:
        """Return the norm of a generalized force in the metric M^-1."""
        return float(np.linalg.norm(np.linalg.solve(self._L, b)))

    def null_basis(self) -> Array:
        """Return a basis of the (e, lam) that exert no force, shape (ne + m, null_space)."""
        efforts, size = self._efforts.null, len(self._size)
        if not self.null_space:
            return np.zeros((size, 0))
        reaction = -self._rows.solve(np.linalg.solve(self._L, self._E.dot(efforts)))
        basis, (n, k) = np.zeros((size, self.null_space)), efforts.shape
        basis[:n, :k], basis[n:, :k], basis[n:, k:] = efforts, reaction, self._rows.null
        return basis

    def base_residual(self, b: Array, R: Array) -> Array:
        """Return the smallest forces r such that the efforts can exert b - R r, shape (k,).

        They are smallest in the metric M^-1, which makes forces and moments of a base comparable.

        Args:
            b: Force on all joints, shape (nv,).
            R: Independent forces, one a column, shape (nv, k).
        """
        Q, T = self._normalised(R)
        beyond = self._efforts.outside.T.dot(self._Z.T)
        unreached = beyond.dot(np.linalg.solve(self._L, b))
        shortest: Any = np.linalg.lstsq(beyond.dot(Q), unreached, rcond=SINGULAR)[0]
        forces: Array = np.linalg.solve(T, shortest)
        return forces

    def with_base_forces(self, R: Array) -> tuple[ForceSplit, Array]:
        """Return a factorization with base forces before the efforts, and their scaling T.

        The unknowns are s = T r, whose Euclidean norm is that of R r in the metric M^-1.

        Args:
            R: Independent forces, one a column, shape (nv, k).
        """
        T = self._normalised(R)[1]
        E = np.concatenate((np.linalg.solve(T.T, R.T).T, self._E), axis=1)
        size = np.concatenate((np.ones(len(T)), self._size))
        return ForceSplit(self._L.dot(self._L.T), E, self._J, size), T

    def _normalised(self, R: Array) -> tuple[Array, Array]:
        """Return the QR factors Q and T of L^-1 R."""
        Q, T = np.linalg.qr(np.linalg.solve(self._L, R))
        return Q, T

    def undetermined(self, basis: Array) -> NDArray[np.bool_]:
        """Return which efforts and multipliers take part in a `null_basis`, shape (ne + m,)."""
        share = np.linalg.norm(basis * self._size[:, None], axis=1)
        return share > _TAKES_PART

    def motions(self) -> Array:
        """Return the motions that the constraints allow, Z' M Z = 1, one a column."""
        return np.linalg.solve(self._L.T, self._Z)

    def undriven(self) -> Array:
        """Return the allowed motions that no effort can accelerate, Z' M Z = 1, one a column."""
        return np.linalg.solve(self._L.T, self._Z.dot(self._efforts.outside))

    def violation(self, r: Array, terms: Array) -> float:
        """Return how far rates of the rows are from zero, without directions lost at a toggle.

        Args:
            r: Rates of the rows, shape (m,).
            terms: Size of the terms that should cancel in each rate, shape (m,).

        Returns:
            Norm of the rates, relative to the norm of the terms.
        """
        deviation = float(np.linalg.norm(self._rows.project(r)))
        return deviation / max(self._rows.norm(terms), _REST_RATE)

    def _solve(self, b: Array) -> tuple[Array, Array]:
        weighted = np.linalg.solve(self._L, b)
        e = self._efforts.solve(self._Z.T.dot(weighted))
        remainder = np.linalg.solve(self._L, b - self._E.dot(e))
        return e, self._rows.solve(remainder)


class _Inverse:
    """Pseudoinverse and null space of a matrix A, from its scaled form W = A scale.

    Attributes:
        outside: Orthonormal basis of the complement of the range of A, one vector a column.
        null: Basis of the null space of A, orthonormal before scaling.
    """

    def __init__(self, W: Array, scale: Array) -> None:
        U, s, Vt = np.linalg.svd(W)
        rank = numerical_rank(s)
        self.rank, self.outside = rank, U[:, rank:]
        self.condition = float(s[0] / s[rank - 1]) if rank else 1.0
        self._range, self._V, self._scale = U[:, :rank], Vt[:rank].T, scale
        self._inverse = scale[:, None] * self._V / s[:rank]
        self.null = scale[:, None] * Vt[rank:].T
        self._null_directions, _ = np.linalg.qr(self.null)

    def solve(self, b: Array) -> Array:
        """Return the least-squares solution of A x = b of smallest norm, shape (n,) or (n, k)."""
        x = self._inverse.dot(self._range.T.dot(b))
        return x - self._null_directions.dot(self._null_directions.T.dot(x))

    def project(self, r: Array) -> Array:
        """Return the coordinates of the scaled r in the row space of A."""
        return self._V.T.dot(self._scale * r)

    def norm(self, r: Array) -> float:
        """Return the norm of the scaled r."""
        return float(np.linalg.norm(self._scale * r))


def numerical_rank(sizes: Array) -> int:
    """Count the singular values of scaled columns that exceed rounding and toggles."""
    return int(np.count_nonzero(sizes > SINGULAR * max(1.0, sizes.max(initial=0.0))))


class Split(NamedTuple):
    """Efforts and multipliers that exert a generalized force, and their residual.

    Attributes:
        efforts: e [N·m or N], shape (ne,).
        multipliers: lam, shape (m,).
        residual: Acceleration that the remaining force would cause, M^-1 (b - E e - J' lam), shape
            (nv,).
        residual_norm: Norm of the remaining force in the metric M^-1.
    """

    efforts: Array
    multipliers: Array
    residual: Array
    residual_norm: float


def split_within_bounds(
    split: ForceSplit,
    b: Array,
    unbounded: Split,
    bases: tuple[Array, Array],
    limits: Limits,
    target: ForceTarget | None = None,
) -> BoundedSplit:
    """Split a force within bounds, with the least base residual, then efforts, then multipliers.

    Args:
        split: Factorization of the equation.
        b: Generalized force to split, shape (nv,).
        unbounded: Split of b without bounds.
        bases: Columns R of free bases, shape (nv, k), and the residual without bounds, (k,).
        limits: Bounds and cones of the efforts, then the multipliers.
        target: Goal that ranks right after the base residual.
    """
    (R, r), ne = bases, len(unbounded.efforts)
    y = np.concatenate((unbounded.efforts, unbounded.multipliers))
    slack = _BOUND_TOLERANCE * (1.0 + float(np.abs(y).max(initial=0.0))) if len(limits.mu) else 0.0
    if target is None and (limits.excess(y) <= slack).all():
        return BoundedSplit(unbounded, r, True)
    groups = slice(0, ne), slice(ne, None)
    least = _least(y, _directions(split), groups, limits, target)
    if not least.is_within and len(r):
        least, r = _with_bases(split, y, bases, limits, ne, target)
    return BoundedSplit(
        split.evaluate(b - R.dot(r), least.z[:ne], least.z[ne:]), r, least.is_within
    )


def _least(
    z: Array,
    N: Array,
    groups: Sequence[slice],
    limits: Limits,
    target: ForceTarget | None = None,
    first: int = 0,
) -> Least:
    """Minimize norms group by group within limits; a target ranks right after base forces."""
    if target is None and not len(limits.mu):
        return least_in_bounds(z, N, groups, limits.lower, limits.upper)
    every, nothing = np.eye(len(z)), np.zeros(len(z))
    rows = [(every[group], nothing[group]) for group in groups]
    if target is not None:
        rows.insert(1 if first else 0, target)
    weighted = zip(_PRIORITIES, rows, strict=False)
    A, c = zip(*((weight * A, weight * c) for weight, (A, c) in weighted), strict=True)
    return Least(*least_in_cones(z, N, np.concatenate(A), np.concatenate(c), limits))


def _directions(split: ForceSplit) -> Array:
    """Return an orthonormal basis of the (e, lam) that exert no force."""
    return np.asarray(np.linalg.qr(split.null_basis())[0], dtype=np.float64)


def _with_bases(
    split: ForceSplit,
    y: Array,
    bases: tuple[Array, Array],
    limits: Limits,
    ne: int,
    target: ForceTarget | None,
) -> tuple[Least, Array]:
    """Minimize with base forces as additional unknowns, where bounds leave a remainder."""
    R, r = bases
    k = len(r)
    wide, T = split.with_base_forces(R)
    groups = slice(0, k), slice(k, k + ne), slice(k + ne, None)
    lower, upper = (
        np.concatenate((np.full(k, end), ends))
        for end, ends in zip(_FREE, limits[:2], strict=True)
    )
    if target is not None:
        target = ForceTarget(
            np.concatenate((np.zeros((len(target.S), k)), target.S), axis=1), target.values
        )
    wider = Limits(lower, upper, limits.cones + k, limits.mu)
    least = _least(np.concatenate((T.dot(r), y)), _directions(wide), groups, wider, target, k)
    residual: Any = np.linalg.solve(T, least.z[:k])
    return least._replace(z=least.z[k:]), residual


class BoundedSplit(NamedTuple):
    """Smallest forces within bounds.

    Attributes:
        split: Efforts and multipliers.
        residual: Residual forces of free bases, shape (k,).
        is_within: Whether all bounds hold; if they cannot, the excess is the least possible.
    """

    split: Split
    residual: Array
    is_within: bool


class ForceTarget(NamedTuple):
    """Goal S y = values, met in the least-squares sense before norms are minimized.

    Attributes:
        S: Matrix of the goal, shape (k, n).
        values: Values to approach, shape (k,).
    """

    S: Array
    values: Array
