"""Loads that act as a tension along a path."""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.contracts import Load, Now, Output, Value, Wrench
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.kinematics.paths.paths import Path
from mbd_ros.core.state import Array, State


class PathLoad(Load):
    """Tension F along a path of length l: tau = -J' F with J = dl/dq.

    Args:
        path: Path of the load.
    """

    outputs: tuple[Output, ...] = (Output("tension", "N"), Output("length", "m"))

    def __init__(self, path: Path) -> None:
        self.path = path
        self.reads = path.reads

    def tension(self, k: Kinematics, x: State, u: Array, length: float, speed: float) -> float:
        """Return the tension F [N]; a positive one shortens the path.

        Args:
            k: Kinematics at the state.
            x: State of all joints.
            u: All inputs.
            length: Length l of the path [m].
            speed: Rate l' of the length [m/s].
        """
        raise NotImplementedError

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the generalized force, shape (nv,)."""
        length, slope = self.path.measured(k, x)
        tau: Array = slope * -self.tension(k, x, u, length, k.dot(slope, x.v))
        return tau

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
        """Return the forces at the points of the path."""
        tension, _ = self._now(k, x, u)
        free = np.zeros(3)
        pulls = self.path.pulls(k, x)
        return tuple(Wrench(p.frame, p.point, p.force * tension, free) for p in pulls)

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> Sequence[Value]:
        """Return tension and length."""
        return self._now(k, x, u)

    def _now(self, k: Kinematics, x: State, u: Array) -> tuple[float, float]:
        length, slope = self.path.measured(k, x)
        return self.tension(k, x, u, length, k.dot(slope, x.v)), length
