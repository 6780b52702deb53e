"""Free bodies of a model: their axes, and velocities and ways in these or others."""

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.dynamics.chart import Chart
from mbd_ros.core.state import Array

_BASE_V = 6  # velocities of a free body


class FreeBodies:
    """The free bodies of a model, their order that of its joints.

    Args:
        model: The Pinocchio model.

    Attributes:
        spins: Where their angular velocities stand.
    """

    def __init__(self, model: Any) -> None:
        joints = [joint for joint in model.joints if joint.nv == _BASE_V]
        starts = [int(joint.idx_v) for joint in joints]
        self.spins = [slice(v + 3, v + 6) for v in starts]
        self._q = _places([joint.idx_q for joint in joints], 3)
        self._turns = _places([joint.idx_q + 3 for joint in joints], 4)
        self._v = _places([joint.idx_v for joint in joints], 3)
        self._spins = _places([joint.idx_v + 3 for joint in joints], 3)
        self._vectors = np.stack((self._v, self._spins), axis=-1)

    def axes(self, q: Array) -> Array:
        """From axes of the bodies to those of the world, shape (n, 3, 3)."""
        if len(self._q) == 1:
            axes: Array = pin.Quaternion(q[self._turns[0]]).matrix()[None]
            return axes
        x, y, z, w = q[self._turns].T
        rows = (
            *(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
            *(2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)),
            *(2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
        )
        return np.array(rows).T.reshape(-1, 3, 3)

    def turned(self, v: Array, before: Array, after: Array) -> Array:
        """A velocity with linear parts in other axes.

        Args:
            v: Velocity, shape (nv,).
            before: Axes in which its linear parts stand, shape (n, 3, 3).
            after: Those in which they shall stand.
        """
        turned = v.copy()
        world = np.einsum("nij,nj->ni", before, v[self._v])
        turned[self._v] = np.einsum("nij,ni->nj", after, world)
        return turned

    def moved(self, chart: Chart, q: Array, way: Array, axes: Array) -> Array:
        """A configuration after a way with linear parts in some axes, bodies on straight lines.

        Args:
            chart: Of the configuration.
            q: Configuration, shape (nq,).
            way: Shape (nv,).
            axes: Shape (n, 3, 3).
        """
        turn = way.copy()
        turn[self._v] = 0.0
        moved = chart.integrate(q, turn)
        moved[self._q] += np.einsum("nij,nj->ni", axes, way[self._v])
        return moved

    def gone(self, chart: Chart, q0: Array, q1: Array) -> Array:
        """The way between configurations in the axes of the world, bodies on straight lines."""
        way = self.in_world(chart.difference(q0, q1), self.axes(q0))
        way[self._v] = q1[self._q] - q0[self._q]
        return way

    def in_world(self, v: Array, axes: Array) -> Array:
        """Velocities or accelerations in the axes of the world, both parts of them.

        Args:
            v: In the axes of the bodies, shape (nv,).
            axes: Of the bodies, shape (n, 3, 3).
        """
        turned = v.copy()
        turned[self._vectors] = axes @ v[self._vectors]
        return turned

    def in_own_axes(self, v: Array, axes: Array) -> Array:
        """The reverse of `in_world`."""
        turned = v.copy()
        turned[self._vectors] = axes.transpose(0, 2, 1) @ v[self._vectors]
        return turned

    def add_turning(self, a: Array, v: Array) -> None:
        """Add w x v to accelerations of the bodies, both in the axes of the world."""
        for spin in self.spins:
            start = spin.start - 3
            x, y, z, p, q, r = v[start : spin.stop].tolist()
            a[start : spin.start] += (q * z - r * y, r * x - p * z, p * y - q * x)

    def turning(self, v: Array) -> Array:
        """What accelerations in the axes of the bodies lack, w x v, shape (nv,)."""
        turning = np.zeros(len(v))
        (a, b, c), (x, y, z) = v[self._spins].T, v[self._v].T
        turning[self._v] = np.column_stack((b * z - c * y, c * x - a * z, a * y - b * x))
        return turning


def _places(starts: list[int], count: int) -> NDArray[np.intp]:
    return np.array(starts, dtype=np.intp)[:, None] + np.arange(count)
