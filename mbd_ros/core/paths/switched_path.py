"""Paths that go another way while a joint is somewhere."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.kinematics.sampled_kinematics import SampledKinematics
from mbd_ros.core.paths.paths import Path, Pull
from mbd_ros.core.paths.via_points import Interval, ViaPoint
from mbd_ros.core.state import Array, State


class SwitchedPath(Path):
    """One path while a joint is in an interval, and another one elsewhere.

    The length jumps at the ends of the interval, unless both paths are as long there.

    Args:
        interval: Where the joint must be.
        inside: The path there.
        outside: The path elsewhere.
    """

    reads = Reads.JACOBIAN

    def __init__(self, interval: Interval, inside: Path, outside: Path) -> None:
        self._interval, self._inside, self._outside = interval, inside, outside
        self.over = inside.over

    def length(self, k: Kinematics, x: State) -> float:
        """The l [m]."""
        return self._asked(k, x, "length")

    def measured(self, k: Kinematics, x: State) -> tuple[float, Array]:
        """The l [m] and J, shape (nv,)."""
        return self._asked(k, x, "measured")

    def drift(self, k: Kinematics, x: State) -> float:
        """J' v [m/s^2]."""
        return self._asked(k, x, "drift")

    def pulls(self, k: Kinematics, x: State) -> tuple[Pull, ...]:
        """What a tension of 1 N exerts on bodies; of both paths where nobody knows which it is."""
        there = k.where(self._interval.holds(k, x), 1.0, 0.0)
        shares = (self._inside, there), (self._outside, 1.0 - there)
        return tuple(
            pull._replace(force=pull.force * share)
            for path, share in shares
            if k.any(np.array([share]))
            for pull in path.pulls(k, x)
        )

    def lines(self, k: Kinematics, x: State) -> tuple[Array, ...]:
        """Corners of the path that there is."""
        return self._asked(k, x, "lines")

    def corners(self) -> Sequence[ViaPoint]:
        """All points of the path inside, which has more than the other one; none with wraps."""
        return () if self._inside.wraps else self._inside.corners()

    def sampled(self, k: SampledKinematics) -> tuple[Array, Array]:
        """The l [m] and J of n samples."""
        there = self._interval.sampled(k)
        if there.all() or not there.any():
            return (self._inside if there.all() else self._outside).sampled(k)
        inside, outside = self._inside.sampled(k.of(there)), self._outside.sampled(k.of(~there))
        lengths, slopes = np.empty(len(there)), np.empty((len(there), inside[1].shape[1]))
        lengths[there], slopes[there] = inside
        lengths[~there], slopes[~there] = outside
        return lengths, slopes

    def _asked(self, k: Kinematics, x: State, what: str) -> Any:
        inside, outside = getattr(self._inside, what), getattr(self._outside, what)
        there = self._interval.holds(k, x)
        return k.either(there, lambda: inside(k, x), lambda: outside(k, x))
