"""Rows between bounds: joint stops, dry friction, limited drives.

    w = A p + b,   lower <= p <= upper,
    w = 0 inside the bounds, w >= 0 at the lower one, w <= 0 at the upper one

`BoundedRows` solves it for accelerations. By Gauss's principle

    M a + h = tau + J' lam,   w = J a + drift + kd g' + kp g,   A = J M^-1 J',   p = lam

and among all accelerations that the rows allow, a is the nearest to that of the system without
them, in the mass metric. `BoundedImpulses` solves it for impulses p; w are then the rates of the
rows after them. `PushImpulses` solves for rows that only push.

Source: P. Lötstedt, SIAM J. Appl. Math. 42 (1982), doi:10.1137/0142022.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.optimization.box_qp import BoxQp, exchanged
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.rows.delassus import is_rounding
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import (
    CONTRADICTION,
    FIXED_BY_OTHERS,
    HELD_BY_ROWS,
    SMALL_ROW,
    TINY,
    ZERO_ROW,
)
from mbd_ros.errors import SolveError

_ROUNDING = 1.0e-14  # a rate that is none, of the velocity
_CLOSED = 1.0e-12  # the same of rows among which impulses are shared
_SAME = 1.0e-10  # by which the rates of dependent rows may differ and count as the same
_GIVES = 1.0e-5  # root of how much rows give way that depend on one another and move apart
_ROUNDS = 10  # of exchanges, per row
_new_solution = tuple.__new__  # half the time of the constructor


class BoundedSolution(NamedTuple):
    """Accelerations with bounded rows, and the multipliers of these rows.

    Attributes:
        a: Accelerations of the integrated coordinates, shape (nv,).
        lam: Multipliers, shape (m,).
        force: J' lam on all joints, shape (nv of the robot,).
        w: What the rows leave, J a + drift + kd g' + kp g, shape (m,); 0 where no row was worth
            a solve.
        terms: Size of the terms in w, shape (m,); 0 likewise.
    """

    a: Array
    lam: Array
    force: Array
    w: Array
    terms: Array


class BoundedRows:
    """Bounded rows on top of a motion that solves everything else.

    While no row exerts a force, an evaluation costs the check and nothing more. Otherwise rows are
    exchanged between their bounds and the active set, beginning with the set that each row finds
    by itself; a QP that starts cold solves it where the exchange does not end. An evaluation does
    not depend on earlier ones.

    Args:
        constraints: The rows.
        nv: Size of the velocity of the robot.
        backend: Solver of the QP, as for `BoxQp`.

    Attributes:
        rows: One entry a row.
        qp: The solver with its statistics.
        acts: Whether any row was worth a solve in the last evaluation, for reports.
    """

    def __init__(self, constraints: ConstraintRows, nv: int, backend: str = "proxqp") -> None:
        self.constraints = constraints
        self.rows = constraints.rows
        self._lower = constraints.lower
        self._upper = constraints.upper
        self.qp = BoxQp(len(self.rows), backend, ("cold", "damped"))
        self._margins = [part.quick_margin for part in constraints.parts]
        self._no_rates = np.zeros(len(self.rows))
        self._idle = self._no_rates, np.zeros(nv), self._no_rates, self._no_rates
        self.acts = False

    def accelerate(self, motion: Any, y: State, a: Array) -> BoundedSolution:
        """Solve for the accelerations of the integrated coordinates with the rows.

        Args:
            motion: The `FreeMotion`, just evaluated at y.
            y: State of the integrated coordinates.
            a: Acceleration without the rows.

        Raises:
            SolveError: The QP solver fails on it, or a lower bound is above the upper one.
        """
        joint_q, joint_v, joint_a = motion.joint_motion(y.q, y.v, a)
        for margin in self._margins:
            if margin(joint_q, joint_v, joint_a) < 0.0:
                break
        else:
            self.acts = False
            return _new_solution(BoundedSolution, (a, *self._idle))
        k, x = motion.mechanism.k, State(y.t, joint_q, joint_v, y.z)
        k.refresh(joint_q, joint_v, self.constraints.reads)
        if self.constraints.varies:
            self.constraints.limit(k, x)
        return self.solve(motion, y.q, x, joint_a, self._lower, self._upper)

    def solve(
        self, motion: Any, q: Array, x: State, joint_a: Array, lower: Array, upper: Array
    ) -> BoundedSolution:
        """Solve for the rows between given bounds.

        Args:
            motion: The `FreeMotion`, just evaluated.
            q: Configuration of the integrated coordinates there.
            x: State of all joints, with k refreshed.
            joint_a: Accelerations of all joints without the rows.
            lower: Smallest multipliers, shape (m,).
            upper: Largest multipliers, shape (m,).
        """
        J, b = self.constraints.conditions(motion.mechanism.k, x)
        response = motion.respond(q, J.T)
        free = J.dot(joint_a) + b
        A, w, silent = self._without_silent(J, J.dot(response), free, (lower, upper))
        lam = self._multipliers(A, w, lower, upper)
        self.acts = True
        a = motion.coordinates.integrated(joint_a + response.dot(lam))
        end = A.dot(lam) + w
        if silent is not None:
            end = np.where(silent, free, end)
        terms = np.abs(A).dot(np.abs(lam)) + np.abs(w)
        return BoundedSolution(a, lam, J.T.dot(lam), end, terms)

    def _multipliers(self, A: Array, w: Array, lower: Array, upper: Array) -> Array:
        lam = exchanged(A, w, lower, upper)
        return self.qp.solve(A, w, lower, upper) if lam is None else lam

    def _without_silent(
        self, J: Array, A: Array, w: Array, bounds: tuple[Array, Array]
    ) -> tuple[Array, Array, NDArray[np.bool_] | None]:
        """Return A and w without rows that nothing moves, and which these are.

        Their multipliers are then 0, or where they demand a motion at the bound that it leads to:
        friction of a rocker that turns.

        Raises:
            SolveError: No bound limits what such a row would take.
        """
        size = A.diagonal()
        if size.min() > SMALL_ROW:
            return A, w, None
        largest = size.max(initial=0.0) or 1.0
        silent = (size <= ZERO_ROW * largest) | is_rounding(J)
        if not silent.any():
            return A, w, None
        lower, upper = bounds
        demands = silent & (np.abs(w) > CONTRADICTION * (1.0 + float(np.abs(w).max())))
        pushed = np.where(demands, np.where(w > 0.0, lower, upper), 0.0)
        if np.isinf(pushed).any():
            worst = int(np.argmax(np.where(np.isinf(pushed), np.abs(w), 0.0)))
            raise SolveError(f"nothing moves constraint row {self.rows[worst].name} as it demands")
        kept = np.outer(~silent, ~silent)
        apart = np.where(silent, -largest * pushed, w)
        return np.where(kept, A, np.diag(largest * silent)), apart, silent


class BoundedImpulses:
    """Impulses of bounded rows at one configuration.

    Rows that nothing moves exert what their bounds say, and change nothing.

    Args:
        A: Rates that impulses add, symmetric, shape (m, m).
        loose: Diagonal of A while no bilateral row holds, shape (m,).
        names: Of the rows, for messages.
    """

    def __init__(self, A: Array, loose: Array, names: Sequence[str]) -> None:
        self._names = names
        diagonal = A.diagonal()
        self._mobile = diagonal > HELD_BY_ROWS * loose
        self._unit = 1.0 / np.sqrt(diagonal[self._mobile])
        self._length = np.sqrt(np.where(loose > 0.0, loose, 1.0))
        A = self._unit[:, None] * A[np.ix_(self._mobile, self._mobile)] * self._unit
        self._A = 0.5 * (A + A.T)

    def solve(self, b: Array, lower: Array, upper: Array, speed: float) -> Array:
        """Return the impulses, shape (m,), fresh.

        Args:
            b: Rates without them, shape (m,).
            lower: Smallest impulses, shape (m,).
            upper: Largest ones, shape (m,).
            speed: Velocity in the mass metric, which no scaled rate exceeds by much.

        Raises:
            SolveError: Nothing keeps a row from moving as it must not; names it.
        """
        p = self._unmoved(b, lower, upper, speed)
        mobile, b = self._mobile, self._unit * b[self._mobile]
        size = max(float(np.abs(b).max(initial=0.0)), speed, TINY)
        unit = size * self._unit
        bounds = lower[mobile] / unit, upper[mobile] / unit
        p[mobile] = unit * self._scaled(b / size, *bounds)
        return p

    def _scaled(self, b: Array, lower: Array, upper: Array) -> Array:
        p = exchanged(self._A, b, lower, upper)
        if p is None:
            p = BoxQp(len(b), rungs=("cold", "damped")).solve(self._A, b, lower, upper)
        return p

    def _unmoved(self, b: Array, lower: Array, upper: Array, speed: float) -> Array:
        """Return impulses of rows that nothing moves; 0 for the others."""
        p = np.zeros(len(b))
        if self._mobile.all():
            return p
        b = np.where(self._mobile | (np.abs(b) <= CONTRADICTION * self._length * speed), 0.0, b)
        p = np.where(b < 0.0, upper, np.where(b > 0.0, lower, p))
        if not np.isfinite(p).all():
            name = self._names[int(np.isfinite(p).argmin())]
            raise SolveError(f"nothing can keep constraint row {name} from closing")
        return p


class PushImpulses:
    """Impulses of rows that only push, as a least-squares problem in the mass metric.

        min 1/2 |c + G p|^2   subject to   p >= 0

    c is a velocity in that metric, and G' (c + G p) are the rates of the rows: at the least
    kinetic energy they are >= 0, and 0 where a row pushes. The columns of G may depend on one
    another.
    Source: C. Lawson, R. Hanson, Solving Least Squares Problems, 1974, ch. 23.

    Args:
        G: Velocities that impulses add, shape (nv, m).
        loose: Their squares while no bilateral row holds, shape (m,).
        names: Of the rows, for messages.
    """

    def __init__(self, G: Array, loose: Array, names: Sequence[str]) -> None:
        self._names = names
        square = np.einsum("ij,ij->j", G, G)
        self._mobile = square > HELD_BY_ROWS * loose
        self._unit = 1.0 / np.sqrt(square[self._mobile])
        self._length = np.sqrt(np.where(loose > 0.0, loose, 1.0))
        self._G = G[:, self._mobile] * self._unit

    def solve(self, b: Array, speed: float) -> Array:
        """Return the impulses, shape (m,), fresh; rows that depend on one another share them.

        Args:
            b: Rates without them, shape (m,).
            speed: Velocity in the mass metric.

        Raises:
            SolveError: Nothing keeps a row from closing; names it.
        """
        left = np.where(self._mobile, 0.0, b) < -CONTRADICTION * self._length * speed
        if left.any():
            self._refuse(int(left.argmax()))
        p, rate = self.nearest(b, speed)
        if rate.min(initial=0.0) < -CONTRADICTION:
            self._refuse(int(rate.argmin()))
        return p

    def nearest(self, b: Array, speed: float) -> tuple[Array, Array]:
        """The impulses, and what they leave of the rates, of the largest one, shape (m,) each.

        Rates of rows that nothing moves count as none. Where rows depend on one another and want
        different things, a small part of their rates is left.

        Args:
            b: As for `solve`.
            speed: As for `solve`.
        """
        p, rate = np.zeros((2, len(b)))
        scaled_rates = self._unit * b[self._mobile]
        if (scaled_rates >= 0.0).all():
            return p, rate
        G, size = self._G, max(speed, float(np.abs(scaled_rates).max()))
        scaled_rates = scaled_rates / size  # c is of the order of 1, however slow the motion is
        c = np.asarray(
            np.linalg.lstsq(G.T, scaled_rates, rcond=FIXED_BY_OTHERS)[0], dtype=np.float64
        )
        off = scaled_rates - G.T.dot(c)
        if np.abs(off).max() <= _SAME:
            p[self._mobile] = size * self._unit * _shared(G, c, _least(G, c))
            return p, rate
        yielding = np.concatenate((G, _GIVES * np.eye(len(scaled_rates))))
        push = _least(yielding, np.concatenate((c, off / _GIVES)))
        rate[self._mobile] = scaled_rates + G.T.dot(G.dot(push))
        p[self._mobile] = size * self._unit * push
        return p, rate

    def _refuse(self, row: int) -> None:
        raise SolveError(f"nothing can keep constraint row {self._names[row]} from closing")


def _shared(G: Array, c: Array, p: Array) -> Array:
    """Return impulses of least norm that do the same, where they push too."""
    rate = G.T.dot(c + G.dot(p))
    least = _fitted(G, c, (rate <= _CLOSED) | (p > 0.0))
    does_the_same = np.abs(G.T.dot(c + G.dot(least)) - rate).max() <= _CLOSED
    return least if does_the_same and (least >= 0.0).all() else p


def _fitted(G: Array, c: Array, on: NDArray[np.bool_]) -> Array:
    """Return p of least norm with c + G p the shortest, 0 where a row is off."""
    p = np.zeros(G.shape[1])
    p[on] = np.linalg.lstsq(G[:, on], -c, rcond=FIXED_BY_OTHERS)[0]
    return p


def _least(G: Array, c: Array) -> Array:
    """Return some p of the problem."""
    m = G.shape[1]
    p, pushes = np.zeros(m), np.zeros(m, dtype=np.bool_)
    tried = np.zeros(m, dtype=np.bool_)
    for _ in range(_ROUNDS * m):
        rate = np.where(pushes | tried, 0.0, G.T.dot(c + G.dot(p)))
        new = int(rate.argmin())
        if rate[new] >= -_ROUNDING:
            return p
        pushes[new] = True
        target = _fitted(G, c, pushes)
        if target[new] <= 0.0:  # it depends on the others, and its rate is rounding
            pushes[new], tried[new] = False, True
            continue
        tried[:] = False
        while (pulls := pushes & (target <= 0.0)).any():
            share = p[pulls] / (p[pulls] - target[pulls])
            p = p + share.min() * (target - p)
            pushes &= ~(pulls & (p <= _ROUNDING * np.abs(p).max()))
            pushes[np.flatnonzero(pulls)[share.argmin()]] = False
            p = np.where(pushes, p, 0.0)
            target = _fitted(G, c, pushes)
        p = target
    return p
