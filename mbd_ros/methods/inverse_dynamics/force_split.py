"""A force on all joints split into efforts of actuators and multipliers of constraints.

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

_NOTHING = 1.0e-3  # norm of rates below which they count as rest
_TAKES_PART = 1.0e-6  # share of an unknown in the null space; rounding leaves 1e-9 there
_FREE = -np.inf, np.inf
_KEPT = 1.0e-9  # of the largest force, by which limits of contacts may be passed
_WEIGHTS = 1.0, 1.0e-3, 1.0e-6, 1.0e-8  # of what comes first, and then


class ForceSplit:
    """Factors of one state.

    Efforts come first: the e of smallest Euclidean norm in SI numbers that fits, which does not
    depend on how the constraints are written down. Then comes, for this e, the lam of smallest
    norm. Ranks are those of columns scaled in the metric M^-1, so that units play no
    role in them.

    Args:
        M: Mass matrix, shape (nv, nv).
        E: Force of every effort, one a column, shape (nv, ne).
        J: Rows, shape (m, nv).
        usual: Usual norm of each column of E and J', shape (ne + m,); it separates a column that
            vanishes at a toggle from one that is small everywhere.

    Attributes:
        freedom: Motions that the rows allow.
        driven: How many of them the efforts reach.
        rank: How many independent forces efforts and multipliers exert together.
        null_space: Dimension of the (e, lam) that exert nothing together.
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
        """Efforts and multipliers of a force on all joints, shape (nv,)."""
        e, lam = self._solve(b)
        more_e, more_lam = self._solve(b - self._E.dot(e) - self._J.T.dot(lam))
        return self.left(b, e + more_e, lam + more_lam)

    def left(self, b: Array, e: Array, lam: Array) -> Split:
        """What efforts and multipliers leave of a force on all joints, shape (nv,)."""
        left = np.linalg.solve(self._L, b - self._E.dot(e) - self._J.T.dot(lam))
        share = float(np.linalg.norm(left))
        return Split(e, lam, np.linalg.solve(self._L.T, left), share)

    def norm(self, b: Array) -> float:
        """Size of a force on all joints in the metric of `Split.share`."""
        return float(np.linalg.norm(np.linalg.solve(self._L, b)))

    def null_basis(self) -> Array:
        """Efforts above multipliers that together exert nothing, shape (ne + m, null_space)."""
        efforts, size = self._efforts.null, len(self._size)
        if not self.null_space:
            return np.zeros((size, 0))
        held = -self._rows.solve(np.linalg.solve(self._L, self._E.dot(efforts)))
        basis, (n, k) = np.zeros((size, self.null_space)), efforts.shape
        basis[:n, :k], basis[n:, :k], basis[n:, k:] = efforts, held, self._rows.null
        return basis

    def out_of_reach(self, b: Array, R: Array) -> Array:
        """Smallest forces along R that bring b into the reach of the efforts, shape (k,).

        Smallest in the metric M^-1: moments of a base and its forces count as what they do.

        Args:
            b: Force on all joints, shape (nv,).
            R: Independent forces, one a column, shape (nv, k).
        """
        Q, T = self._normalised(R)
        beyond = self._efforts.outside.T.dot(self._Z.T)
        lacking = beyond.dot(np.linalg.solve(self._L, b))
        shortest: Any = np.linalg.lstsq(beyond.dot(Q), lacking, rcond=SINGULAR)[0]
        forces: Array = np.linalg.solve(T, shortest)
        return forces

    def beside(self, R: Array) -> tuple[ForceSplit, Array]:
        """A split with forces along R before the efforts, and the T of r = T^-1 (their values).

        The values have the norm of r in the metric M^-1.

        Args:
            R: Independent forces, one a column, shape (nv, k).
        """
        T = self._normalised(R)[1]
        E = np.concatenate((np.linalg.solve(T.T, R.T).T, self._E), axis=1)
        size = np.concatenate((np.ones(len(T)), self._size))
        return ForceSplit(self._L.dot(self._L.T), E, self._J, size), T

    def _normalised(self, R: Array) -> tuple[Array, Array]:
        """Q and T with L^-1 R = Q T."""
        Q, T = np.linalg.qr(np.linalg.solve(self._L, R))
        return Q, T

    def undetermined(self, basis: Array) -> NDArray[np.bool_]:
        """Which efforts, then multipliers, take part in a `null_basis`, shape (ne + m,)."""
        share = np.linalg.norm(basis * self._size[:, None], axis=1)
        return share > _TAKES_PART

    def motions(self) -> Array:
        """Motions that the rows allow, Z' M Z = 1, one a column."""
        return np.linalg.solve(self._L.T, self._Z)

    def undriven(self) -> Array:
        """Motions that the rows allow and no effort reaches, Z' M Z = 1, one a column."""
        return np.linalg.solve(self._L.T, self._Z.dot(self._efforts.outside))

    def violation(self, r: Array, terms: Array) -> float:
        """How far rates of the rows are from zero, toggles apart.

        Args:
            r: Rates, shape (m,).
            terms: Size of the terms that should cancel in them, shape (m,).

        Returns:
            Their norm as a share of that of the terms.
        """
        off = float(np.linalg.norm(self._rows.within(r)))
        return off / max(self._rows.size(terms), _NOTHING)

    def _solve(self, b: Array) -> tuple[Array, Array]:
        weighted = np.linalg.solve(self._L, b)
        e = self._efforts.solve(self._Z.T.dot(weighted))
        rest = np.linalg.solve(self._L, b - self._E.dot(e))
        return e, self._rows.solve(rest)


class _Inverse:
    """Pseudoinverse of a matrix A, given as W = A scale, with the null space of A.

    Attributes:
        outside: Orthonormal directions that A does not reach, one a column.
        null: Combinations of columns of A that cancel, orthonormal before scaling.
    """

    def __init__(self, W: Array, scale: Array) -> None:
        U, s, Vt = np.linalg.svd(W)
        rank = rank_of(s)
        self.rank, self.outside = rank, U[:, rank:]
        self.condition = float(s[0] / s[rank - 1]) if rank else 1.0
        self._reached, self._V, self._scale = U[:, :rank], Vt[:rank].T, scale
        self._inverse = scale[:, None] * self._V / s[:rank]
        self.null = scale[:, None] * Vt[rank:].T
        self._silent, _ = np.linalg.qr(self.null)

    def solve(self, b: Array) -> Array:
        """The x of smallest norm with A x nearest to b, shape (n,) or (n, k)."""
        x = self._inverse.dot(self._reached.T.dot(b))
        return x - self._silent.dot(self._silent.T.dot(x))

    def within(self, r: Array) -> Array:
        """The part of r, scaled, that A' can change."""
        return self._V.T.dot(self._scale * r)

    def size(self, r: Array) -> float:
        """Norm of r, scaled."""
        return float(np.linalg.norm(self._scale * r))


def rank_of(sizes: Array) -> int:
    """How many singular values of scaled columns are none that a toggle or rounding left."""
    return int(np.count_nonzero(sizes > SINGULAR * max(1.0, sizes.max(initial=0.0))))


class Split(NamedTuple):
    """Efforts and multipliers of a force on all joints.

    Attributes:
        efforts: e [N·m or N], shape (ne,).
        multipliers: lam, shape (m,).
        left: The rest, which neither can exert, as an acceleration of the motions that the rows
            allow: M^-1 (b - E e - J' lam), shape (nv,).
        share: Norm of that in the mass metric, the square root of a work per mass.
    """

    efforts: Array
    multipliers: Array
    left: Array
    share: float


def within_bounds(
    split: ForceSplit,
    b: Array,
    found: Split,
    bases: tuple[Array, Array],
    limits: Limits,
    wish: Wish | None = None,
) -> Within:
    """Keep bounds: with the least residual of free bases, then efforts, then multipliers.

    Args:
        split: Factors of the equation.
        b: The force that is split, shape (nv,).
        found: The answer without bounds.
        bases: Columns R of free bases, shape (nv, k), and the residual without bounds, (k,).
        limits: Of efforts, then multipliers.
        wish: What comes right after the residual.
    """
    (R, r), ne = bases, len(found.efforts)
    y = np.concatenate((found.efforts, found.multipliers))
    slack = _KEPT * (1.0 + float(np.abs(y).max(initial=0.0))) if len(limits.mu) else 0.0
    if wish is None and (limits.excess(y) <= slack).all():
        return Within(found, r, True)
    groups = slice(0, ne), slice(ne, None)
    least = _least(y, _directions(split), groups, limits, wish)
    if not least.is_within and len(r):
        least, r = _with_bases(split, y, bases, limits, ne, wish)
    return Within(split.left(b - R.dot(r), least.z[:ne], least.z[ne:]), r, least.is_within)


def _least(
    z: Array,
    N: Array,
    groups: Sequence[slice],
    limits: Limits,
    wish: Wish | None = None,
    first: int = 0,
) -> Least:
    """Least norms within limits; a wish comes after the first group, if that is of bases."""
    if wish is None and not len(limits.mu):
        return least_in_bounds(z, N, groups, limits.lower, limits.upper)
    every, nothing = np.eye(len(z)), np.zeros(len(z))
    rows = [(every[group], nothing[group]) for group in groups]
    if wish is not None:
        rows.insert(1 if first else 0, wish)
    weighted = zip(_WEIGHTS, rows, strict=False)
    A, c = zip(*((weight * A, weight * c) for weight, (A, c) in weighted), strict=True)
    return Least(*least_in_cones(z, N, np.concatenate(A), np.concatenate(c), limits))


def _directions(split: ForceSplit) -> Array:
    """Orthonormal directions of what exerts nothing."""
    return np.asarray(np.linalg.qr(split.null_basis())[0], dtype=np.float64)


def _with_bases(
    split: ForceSplit,
    y: Array,
    bases: tuple[Array, Array],
    limits: Limits,
    ne: int,
    wish: Wish | None,
) -> tuple[Least, Array]:
    """The same where free bases take what the bounds leave."""
    R, r = bases
    k = len(r)
    wide, T = split.beside(R)
    groups = slice(0, k), slice(k, k + ne), slice(k + ne, None)
    lower, upper = (
        np.concatenate((np.full(k, end), ends))
        for end, ends in zip(_FREE, limits[:2], strict=True)
    )
    if wish is not None:
        wish = Wish(np.concatenate((np.zeros((len(wish.S), k)), wish.S), axis=1), wish.target)
    wider = Limits(lower, upper, limits.cones + k, limits.mu)
    least = _least(np.concatenate((T.dot(r), y)), _directions(wide), groups, wider, wish, k)
    residual: Any = np.linalg.solve(T, least.z[:k])
    return least._replace(z=least.z[k:]), residual


class Within(NamedTuple):
    """Forces that are as small as bounds let them be.

    Attributes:
        split: Efforts and multipliers.
        residual: Forces of free bases, shape (k,).
        is_within: Whether the bounds are kept; otherwise they cannot be, and the excess is the
            least.
    """

    split: Split
    residual: Array
    is_within: bool


class Wish(NamedTuple):
    """Numbers S y that come as near to a target as they can, before anything is small.

    Attributes:
        S: Shape (k, n).
        target: Shape (k,).
    """

    S: Array
    target: Array
