"""A motion to follow, with the gains that lead back to it, and its linearization."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.ranges import LARGEST
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import SINGULAR
from mbd_ros.errors import ModelError

_UPRIGHT = 1.0e-9  # share of the largest cost that a cost may be below 0, by rounding
_STEP = 1.0e-6  # of a central difference of J v: errors of its square and of rounding over it
_FLAT = 1.0e-4  # least singular value of a choice of coordinates, 0 at a toggle


class TrackingPlan:
    """Samples of a motion, of its inputs and of the gains along it.

        u = u_plan(t) - K(t) e,   e = [q - q_plan(t); v - v_plan(t)] of independent joints

    Positions and velocities are cubic between samples, the rest straight lines. Before the first
    and after the last sample the plan stands at it.

    Args:
        joints: Independent joints, which say where all others are.
        inputs: Joints of the efforts.
        times: [s], increasing, shape (n,), n >= 2.
        q: Positions [rad or m], shape (n, d).
        v: Velocities [rad/s or m/s], shape (n, d).
        u: Efforts [N·m or N], shape (n, k).
        gain: Shape (n, k, 2 d).
        cost: S of the cost to go e'S e, shape (n, 2 d, 2 d).
        level: Cost to go within which motions return to the plan; 0 where nobody has looked.

    Raises:
        ModelError: Shapes that do not belong together, or numbers that are not finite or huge.
    """

    def __init__(
        self,
        joints: tuple[str, ...],
        inputs: tuple[str, ...],
        times: Array,
        q: Array,
        v: Array,
        u: Array,
        gain: Array,
        cost: Array,
        level: float = 0.0,
    ) -> None:
        self.joints, self.inputs, self.times, self.level = joints, inputs, times, level
        self.q, self.v, self.u, self.gain, self.cost = q, v, u, gain, cost
        self._check()

    @property
    def begin(self) -> float:
        """Time of the first sample [s]."""
        return float(self.times[0])

    @property
    def end(self) -> float:
        """Time of the last sample [s]."""
        return float(self.times[-1])

    def at(self, t: float) -> Tracked:
        """The plan at a time [s]; fresh arrays."""
        t = min(max(t, self.begin), self.end)
        i = min(max(int(np.searchsorted(self.times, t, side="right")) - 1, 0), len(self.times) - 2)
        h = self.times[i + 1] - self.times[i]
        s = (t - self.times[i]) / h
        q, v = self._cubic(i, s, h)
        u, gain, cost = ((1.0 - s) * a[i] + s * a[i + 1] for a in (self.u, self.gain, self.cost))
        return Tracked(q, v, u, gain, cost)

    def with_level(self, level: float) -> TrackingPlan:
        """The same plan with another tube."""
        given = self.times, self.q, self.v, self.u, self.gain, self.cost
        return TrackingPlan(self.joints, self.inputs, *given, level)

    def _cubic(self, i: int, s: float, h: float) -> tuple[Array, Array]:
        q0, q1, v0, v1 = self.q[i], self.q[i + 1], h * self.v[i], h * self.v[i + 1]
        square, cube = 3.0 * (q1 - q0) - 2.0 * v0 - v1, v0 + v1 - 2.0 * (q1 - q0)
        q = q0 + s * (v0 + s * (square + s * cube))
        return q, (v0 + s * (2.0 * square + 3.0 * s * cube)) / h

    def _check(self) -> None:
        n, d, k = len(self.times), len(self.joints), len(self.inputs)
        shapes = {
            "q": (n, d),
            "v": (n, d),
            "u": (n, k),
            "gain": (n, k, 2 * d),
            "cost": (n, 2 * d, 2 * d),
        }
        for name, shape in shapes.items():
            values = getattr(self, name)
            if values.shape != shape:
                raise ModelError(f"plan: {name} has shape {values.shape}, accepted: {shape}")
            if not (np.abs(values) <= LARGEST).all():
                raise ModelError(f"plan: {name} is not finite, or beyond a size of {LARGEST:g}")
        is_rising = (np.diff(self.times) > 0.0).all() and (np.abs(self.times) <= LARGEST).all()
        if n < 2 or not is_rising:
            raise ModelError("plan: times must be two or more, finite and increasing")
        lowest = np.linalg.eigvalsh(self.cost)[:, 0]
        if (lowest < -_UPRIGHT * np.abs(self.cost).max()).any():
            raise ModelError("plan: cost must be positive")


class Tracked(NamedTuple):
    """A plan at one time.

    Attributes:
        q: Of the independent joints [rad or m], shape (d,).
        v: Their velocities [rad/s or m/s], shape (d,).
        u: Efforts of the inputs [N·m or N], shape (k,).
        gain: Effort per deviation of positions, then of velocities, shape (k, 2 d).
        cost: Cost to go: S, symmetric, shape (2 d, 2 d).
    """

    q: Array
    v: Array
    u: Array
    gain: Array
    cost: Array


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
        self._has_rows = bool(system.bilateral.rows)
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
        J: Array = self._system.bilateral.jacobian(t, q)
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
