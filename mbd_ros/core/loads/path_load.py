"""Loads that pull along a path."""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.contracts import Load, Now, Output, Value, Wrench
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.kinematics.paths.paths import Path
from mbd_ros.core.state import Array, State


class PathLoad(Load):
    """A tension F along a path of length l: tau = -J' F with J = dl/dq."""

    outputs: tuple[Output, ...] = (Output("tension", "N"), Output("length", "m"))

    def __init__(self, path: Path) -> None:
        self.path = path
        self.reads = path.reads

    def tension(self, k: Kinematics, x: State, u: Array, length: float, speed: float) -> float:
        """The F [N]; positive shortens the path.

        Args:
            length: The l [m].
            speed: The l' [m/s].
        """
        raise NotImplementedError

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force, shape (nv,)."""
        length, slope = self.path.measured(k, x)
        tau: Array = slope * -self.tension(k, x, u, length, k.dot(slope, x.v))
        return tau

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
        """Forces at the points that the path goes through."""
        tension, _ = self._now(k, x, u)
        free = np.zeros(3)
        pulls = self.path.pulls(k, x)
        return tuple(Wrench(p.frame, p.point, p.force * tension, free) for p in pulls)

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> Sequence[Value]:
        """Tension and length."""
        return self._now(k, x, u)

    def _now(self, k: Kinematics, x: State, u: Array) -> tuple[float, float]:
        length, slope = self.path.measured(k, x)
        return self.tension(k, x, u, length, k.dot(slope, x.v)), length
