"""A motion to follow, with the gains that lead back to it."""

from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

_UPRIGHT = 1.0e-9  # share of the largest cost that a cost may be below 0, by rounding


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

    Attributes:
        joints: As given.
        inputs: As given.
        times: As given.
        level: As given.

    Raises:
        ModelError: Shapes that do not belong together, or what is not finite.
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

    def with_level(self, level: float) -> "TrackingPlan":
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
            if not np.isfinite(values).all():
                raise ModelError(f"plan: {name} is not finite")
        if n < 2 or not (np.diff(self.times) > 0.0).all():
            raise ModelError("plan: times must be two or more, increasing")
        lowest = np.linalg.eigvalsh(self.cost)[:, 0]
        if (lowest < -_UPRIGHT * np.abs(self.cost).max()).any():
            raise ModelError("plan: cost must be positive")
