"""The factorised Delassus matrix A = J M^-1 J' with its rank, and characteristic sizes of rows.

At a toggle a row may vanish altogether: scaled by itself, rounding would look like a direction.
The characteristic sizes of masses and rows are those of many configurations, so that one which
vanishes shows.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import eigenpy
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import (
    CONTRADICTION,
    NEARLY_SINGULAR,
    NO_CONTRADICTION,
    ROUNDED_ROW,
    SMALL_ROW,
    TINY,
    ZERO_ROW,
    redundant,
)
from mbd_ros.errors import SolveError

_FACTORISED = eigenpy.ComputationInfo.Success
_PROBES = 9


class RowFactor:
    """Factor of A = J M^-1 J' with scaled rows, which solves A lam = r.

    Well-conditioned rows go through a Cholesky factor. Otherwise the eigenvalues decide:
    directions below `NEARLY_SINGULAR` are left out, because at a toggle they would turn rounding
    into motion, and among redundant rows lam has the smallest norm.

    Args:
        M: Mass matrix, shape (nv, nv).
        J: Rows, shape (m, nv).
        usual: Usual A_ii of each row, (m,); it separates a row that vanishes at a toggle from one
            that is small everywhere. Without it, A_ii itself.

    Attributes:
        X: M^-1 J', shape (nv, m).
        A: J M^-1 J', shape (m, m).
        rank: Rows that are independent.
        condition: Square root of the condition number of the scaled A, that is, the condition
            number of the scaled rows in the mass metric; inf for redundant rows.
    """

    def __init__(self, M: Array, J: Array, usual: Array | None = None) -> None:
        self.X = eigenpy.LLT(M).solve(J.T).reshape(J.T.shape)  # eigenpy flattens one column
        self.A = J.dot(self.X)
        diagonal = self.A.diagonal()
        self._unmoved = np.zeros(len(J), dtype=np.bool_)
        if diagonal.min(initial=1.0) < SMALL_ROW and (unmoved := is_rounding(J)).any():
            self.X[:, unmoved] = self.A[unmoved] = self.A[:, unmoved] = 0.0
            self._unmoved = unmoved
            diagonal = self.A.diagonal()
        size = diagonal if usual is None else np.maximum(diagonal, usual)
        floor = ZERO_ROW * float(size.max(initial=0.0)) or 1.0
        self._scale = 1.0 / np.sqrt(np.maximum(size, floor))
        scaled = self._scale[:, None] * self.A * self._scale
        self.rank = len(J)
        self._cholesky = eigenpy.LLT(scaled)
        reciprocal = self._cholesky.rcond() if self._cholesky.info() == _FACTORISED else 0.0
        self.condition = reciprocal**-0.5 if reciprocal > 0 else np.inf
        self._is_regular = reciprocal > NEARLY_SINGULAR
        if not self._is_regular:
            self._decompose(scaled)

    def _decompose(self, scaled: Array) -> None:
        if not np.isfinite(scaled).all():
            raise SolveError("constraint rows or masses are not finite")
        values, vectors = np.linalg.eigh(scaled)
        largest = max(float(values[-1]), TINY)
        is_regular = values > NEARLY_SINGULAR * largest
        null = values <= redundant(len(values)) * largest
        self.rank = len(values) - int(np.count_nonzero(null))
        self.condition = float(np.sqrt(largest / values[0])) if not null.any() else np.inf
        self._inverse = (vectors[:, is_regular] / values[is_regular]).dot(vectors[:, is_regular].T)
        self._null = vectors[:, null]
        self._silent, _ = np.linalg.qr(self._scale[:, None] * self._null)

    def solve(self, r: Array) -> Array:
        """Return lam with A lam = r, of smallest norm among redundant rows, shape as r."""
        if self._is_regular:
            return self._scaled(self._cholesky.solve(self._scaled(r)).reshape(r.shape))
        lam = self._scaled(self._inverse.dot(self._scaled(r)))
        return lam - self._silent.dot(self._silent.T.dot(lam))

    def motion(self, r: Array) -> Array:
        """Return the smallest change of v or a, in the mass metric, that changes the rows by r."""
        return self.X.dot(self.solve(r))

    def contradiction(self, r: Array, drift: Array, motion: float) -> int | None:
        """Return the row that most contradicts the others in A lam = r, or None.

        Args:
            r: Right-hand side -(J a + drift), shape (m,).
            drift: Its part that does not depend on a, shape (m,).
            motion: Norm of a in the mass metric, which no scaled row exceeds.
        """
        if self._is_regular or self._null.shape[1] == 0:
            return None
        r = np.where(self._unmoved, -drift, r)  # their J a is rounding
        left = self._null.T.dot(self._scale * r)
        worst = int(np.argmax(np.abs(left)))
        size = motion + float(np.abs(self._scale * drift).max())
        if abs(left[worst]) <= CONTRADICTION * size + NO_CONTRADICTION:
            return None
        return int(np.argmax(np.abs(self._null[:, worst])))

    def _scaled(self, r: Array) -> Array:
        return self._scale * r if r.ndim == 1 else self._scale[:, None] * r


def is_rounding(J: Array) -> NDArray[np.bool_]:
    """Whether rows are rounding alone, since no joint moves them, shape (m,)."""
    return np.abs(J).max(axis=1, initial=0.0) <= ROUNDED_ROW


class UsualSizes(NamedTuple):
    """Characteristic sizes: medians over configurations in the whole range of the joints.

    They do not depend on the course of a motion, and loops need not be closed.

    Attributes:
        inertia: Diagonal of M [kg·m^2 or kg], shape (nv,).
        mobility: Diagonal of J M^-1 J', shape (m,).
        square: Diagonal of J J', shape (m,).
        weights: Row i times entry i gives rows of length one where M is its diagonal, (m, nv).
    """

    inertia: Array
    mobility: Array
    square: Array
    weights: Array


def usual_sizes(robot: Robot, at: Callable[[Array], tuple[Array, Array]]) -> UsualSizes:
    """Return the characteristic sizes of rows; 0 where nothing is finite.

    Args:
        robot: The robot.
        at: Function from a configuration to M, shape (nv, nv), and the rows, shape (m, nv).
    """
    sizes = []
    with np.errstate(all="ignore"):
        for q in configurations(robot):
            M, J = at(q)
            sizes.append((M.diagonal().copy(), _squares(M, J.T), J * J))
    inertia, mobility, square = (_median(each) for each in zip(*sizes, strict=True))
    share = 1.0 / np.where(inertia > 0.0, inertia, 1.0)
    length = square.dot(share)
    weights = np.sqrt(share / np.where(length > 0.0, length, 1.0)[:, None])
    return UsualSizes(inertia, mobility, square.sum(axis=1), weights)


def _squares(M: Array, columns: Array) -> Array:
    """Return c' M^-1 c of every column, shape (k,)."""
    X = eigenpy.LLT(M).solve(columns).reshape(columns.shape)  # eigenpy flattens one column
    return np.asarray(np.einsum("ij,ij->j", columns, X), dtype=np.float64)


def _median(values: Any) -> Array:
    """Return medians with 0 in place of values that are not finite."""
    stacked = np.array(values)
    finite = np.where(np.isfinite(stacked), stacked, 0.0)
    return np.asarray(np.median(finite, axis=0), dtype=np.float64)


def usual_norms(robot: Robot, at: Callable[[Array], tuple[Array, Array]]) -> Array:
    """Return characteristic norms of columns in the metric M^-1, shape (k,).

    Args:
        robot: The robot.
        at: Function from a configuration to M, shape (nv, nv), and the columns, shape (nv, k).
    """
    norms = []
    with np.errstate(all="ignore"):
        for q in configurations(robot):
            M, columns = at(q)
            norms.append(np.sqrt(_squares(M, columns)))
    return _median(norms)


def configurations(robot: Robot) -> list[Array]:
    """Return configurations over the range of all joints; a turn or a metre where unlimited."""
    turns = np.sin(np.outer(np.arange(1, _PROBES + 1), np.arange(1.0, robot.model.nv + 1)))
    middle, half = np.zeros(robot.model.nv), np.ones(robot.model.nv)
    for joint in robot.joints:
        half[joint.v] = most = 1.0 if joint.kind == "prismatic" else np.pi
        if joint.upper - joint.lower < np.inf:
            middle[joint.v] = 0.5 * (joint.lower + joint.upper)
            half[joint.v] = min(0.5 * (joint.upper - joint.lower), most)
    neutral = robot.neutral()
    return [pin.integrate(robot.model, neutral, middle + half * turn) for turn in turns]
