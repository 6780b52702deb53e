"""Linear motion beside a motion, of as many coordinates as there are freedoms."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import SINGULAR
from mbd_ros.errors import ModelError

_STEP = 1.0e-6  # of a central difference of J v: errors of its square and of rounding over it
_FLAT = 1.0e-4  # least singular value of a choice of coordinates, 0 at a toggle


class IndependentSlopes:
    """Derivatives of accelerations by the independent coordinates of what a system integrates.

    Where loops hold, deviations of some coordinates say those of all: dy = T de, with J T = 0 and
    T the identity in the chosen ones, and dy' = T de' + W de since J turns with the motion.

    Args:
        system: The system, with exact `derivatives` or others.
        motion: States of what it integrates.

    Attributes:
        chosen: Places of the independent coordinates, increasing, shape (d,).

    Raises:
        ModelError: No choice of coordinates says all others along the whole motion.
    """

    def __init__(self, system: Any, motion: list[State]) -> None:
        self._system = system
        self._has_rows = bool(system.held.rows)
        self.chosen = self._choose(motion)

    def at(self, y: State, u: Array) -> tuple[Array, Array]:
        """A and B of e' = A e + B du, shape (2 d, 2 d) and (2 d, k).

        Args:
            y: A consistent state of what is integrated.
            u: Inputs, shape (k,).
        """
        slopes, d = self._system.derivatives(y, u), len(self.chosen)
        T, W = self._tangents(y)
        by_e = slopes.q.dot(T) + slopes.v.dot(W)
        A = np.zeros((2 * d, 2 * d))
        A[:d, d:] = np.eye(d)
        A[d:, :d], A[d:, d:] = by_e[self.chosen], slopes.v.dot(T)[self.chosen]
        B = np.zeros((2 * d, slopes.u.shape[1]))
        B[d:] = slopes.u[self.chosen]
        return A, B

    def beside(self, y: State, e: Array) -> State:
        """The state with a deviation, consistent to first order.

        Args:
            y: A consistent state of what is integrated.
            e: Of the independent coordinates, then of their velocities, shape (2 d,).
        """
        (T, W), d = self._tangents(y), len(self.chosen)
        q = self._system.chart.integrate(y.q, T.dot(e[:d]))
        return y._replace(q=q, v=y.v + T.dot(e[d:]) + W.dot(e[:d]))

    def _choose(self, motion: list[State]) -> NDArray[np.intp]:
        n = self._system.nv
        if not self._has_rows:
            return np.arange(n)
        bases = [_null_space(self._jacobian(y.t, y.q)) for y in motion]
        d = max(base.shape[1] for base in bases)
        chosen: list[int] = []
        for _ in range(d):
            rest = [i for i in range(n) if i not in chosen]
            worst = [min(_least(base, [*chosen, i]) for base in bases) for i in rest]
            chosen.append(rest[int(np.argmax(worst))])
        if d == 0 or min(_least(base, chosen) for base in bases) < _FLAT:
            raise ModelError(
                "no choice of coordinates says where all joints are along the whole motion: it "
                "comes too near to a toggle of its loops"
            )
        return np.array(sorted(chosen), dtype=np.intp)

    def _tangents(self, y: State) -> tuple[Array, Array]:
        n = self._system.nv
        if not self._has_rows:
            return np.eye(n), np.zeros((n, n))
        J, picked = self._jacobian(y.t, y.q), np.eye(n)[self.chosen]
        inverse = np.linalg.pinv(np.concatenate([J, picked]))
        T = inverse[:, len(J) :]
        integrate, turns = self._system.chart.integrate, []
        for way in T.T:
            ahead, behind = (
                self._jacobian(y.t, integrate(y.q, s * way)).dot(y.v) for s in (_STEP, -_STEP)
            )
            turns.append((ahead - behind) / (2.0 * _STEP))
        return T, -inverse[:, : len(J)].dot(np.stack(turns, axis=1))

    def _jacobian(self, t: float, q: Array) -> Array:
        J: Array = self._system.held.jacobian(t, q)
        return J


def _null_space(J: Array) -> Array:
    _, sizes, rows = np.linalg.svd(J)
    rank = int((sizes > SINGULAR * sizes[0]).sum())
    return rows[rank:].T


def _least(base: Array, chosen: list[int]) -> float:
    """Smallest of the singular values that the rows of a basis have."""
    if len(chosen) > base.shape[1]:
        return 0.0
    return float(np.linalg.svd(base[chosen], compute_uv=False)[-1])
