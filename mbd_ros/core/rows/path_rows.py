"""The row of a path with a fixed or a largest length."""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.contracts import Now, Output, Value, Wrench
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.kinematics.paths.paths import Path
from mbd_ros.core.rows.constraint import Constraint, Row
from mbd_ros.core.state import Array, State


class PathRow(Constraint):
    """Row g = length - l(q) of a path; its multiplier is the tension [N].

    Args:
        path: The path, of length l(q).
        length: Prescribed or largest length [m].
    """

    rows = (Row("tension", "N"),)
    outputs = (Output("length", "m"),)

    def __init__(self, path: Path, length: float) -> None:
        self.path = path
        self._length = length
        self.reads = Reads.DRIFT if path.reads else Reads.NOTHING

    def residual(self, k: Kinematics, x: State) -> Array:
        """Return g [m], shape (1,)."""
        return k.array((self._length - self.path.length(k, x),))

    def jacobian(self, k: Kinematics, x: State) -> Array:
        """Return -dl/dq, shape (1, nv)."""
        return k.row(-self.path.measured(k, x)[1])

    def drift(self, k: Kinematics, x: State) -> Array:
        """Return -l'' at zero joint acceleration, shape (1,)."""
        return k.array((-self.path.drift(k, x),))

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> Sequence[Value]:
        """Return l [m]."""
        return (self.path.length(k, x),)

    def wrenches(self, k: Kinematics, x: State, lam: Array) -> tuple[Wrench, ...]:
        """Return the forces at the points of the path."""
        free = np.zeros(3)
        pulls = self.path.pulls(k, x)
        return tuple(Wrench(p.frame, p.point, p.force * lam[0], free) for p in pulls)
