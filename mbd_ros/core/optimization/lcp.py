"""The linear complementarity problem of bounds that may only push.

    w = A f + gap,   f >= 0,   w >= 0,   f' w = 0

A is positive semidefinite with ones on its diagonal, and singular where joints are coupled: then
two of their bounds may be one and the same. `move_qp.LimitForces` asks it of the limits of joints.
Source: R. Cottle, J.-S. Pang, R. Stone, The Linear Complementarity Problem, 1992, ch. 3.
"""

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.optimization.box_qp import BoxQp, Statistics, least_norm, on_active_set
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import CLOSED_GAP
from mbd_ros.errors import SolveError

_DAMPING = 1.0e-6  # for the QP, whose check is relative to forces that A would not limit
_SLIGHT = 1.0e-10  # the same while bounds are exchanged
_ROUNDING = 1.0e-14  # a gap of that size is none; scaled gaps are of the order of 1 or less


class ComplementarityProblem:
    """Solves the problem above; every answer is exact on its acting bounds, and checked.

    The bounds that acted last are tried first. Otherwise a kept QP says which ones act. Where its
    damping decided that, or where it fails, single bounds are exchanged until all conditions hold.

    Args:
        n: Number of bounds.
    """

    def __init__(self, n: int) -> None:
        self._qp = BoxQp(n)
        self._identity = np.eye(n)
        self._none = np.zeros(n)
        self._infinite = np.full(n, np.inf)
        self._acting = np.zeros(n, dtype=np.bool_)

    @property
    def statistics(self) -> Statistics:
        """How the QPs went."""
        return self._qp.statistics

    def solve(self, A: Array, gap: Array) -> Array:
        """The forces, shape (n,), of smallest norm where bounds depend on one another.

        Raises:
            SolveError: There are none: the bounds contradict what A leaves movable.
        """
        if not (np.isfinite(A).all() and np.isfinite(gap).all()):
            raise SolveError("mobilities or distances to limits are not finite")
        force = _closing(A, gap, self._acting)
        if not _holds(A, gap, force):
            guess = self._guess(A, gap)
            force = _closing(A, gap, guess > 0.0)
            if not _holds(A, gap, force):
                force = _exchanged(A, gap, guess)
            if not _holds(A, gap, force):
                raise SolveError("the joint limits contradict the constraints")
        self._acting = force > 0.0
        return force

    def _guess(self, A: Array, gap: Array) -> Array:
        """Forces >= 0 that tell which bounds may act; none where the QP finds none."""
        try:
            damped = A + _DAMPING * self._identity
            return np.maximum(self._qp.solve(damped, gap, self._none, self._infinite), 0.0)
        except SolveError:
            return self._none


def _closing(A: Array, gap: Array, acting: NDArray[np.bool_]) -> Array:
    """Forces of smallest norm that close the gaps of the acting bounds."""
    return on_active_set(A, gap, np.zeros(len(gap)), acting, least_norm)


def _least(gap: Array) -> Array:
    """What may be left of each gap, or reach beyond it."""
    return CLOSED_GAP * (np.abs(gap) - min(float(gap.min()), 0.0)) + _ROUNDING


def _holds(A: Array, gap: Array, force: Array) -> bool:
    """Whether no force pulls, no gap is negative, and every bound that pushes is closed."""
    left, least = A.dot(force) + gap, _least(gap)
    is_open = (left > least) & (force > 0.0)
    return bool((left >= -least).all() and (force >= 0.0).all() and not is_open.any())


def _exchanged(A: Array, gap: Array, force: Array) -> Array:
    """Bounds added and removed one at a time, from forces >= 0 on.

    Source: C. Lawson and R. Hanson, Solving Least Squares Problems, 1974, ch. 23.
    """
    slight, none = A + _SLIGHT * np.eye(len(A)), np.zeros(len(gap))
    acting = force > 0.0
    for _ in range(4 * len(gap)):
        target = on_active_set(slight, gap, none, acting)
        pulls = (acting & (target <= 0.0)).nonzero()[0]
        if len(pulls):
            shares = force[pulls] / np.maximum(force[pulls] - target[pulls], _ROUNDING)
            force = force + shares.min() * (target - force)
            acting[pulls[shares.argmin()]] = False
            force = np.where(acting, np.maximum(force, 0.0), 0.0)
            continue
        force = target
        left = np.where(acting, 0.0, A.dot(force) + gap)
        if (left >= -_least(gap)).all():
            break
        acting[left.argmin()] = True
    return _closing(A, gap, acting)
