"""Rows of molecules, block by block."""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.particles.molecules import Molecules
from mbd_ros.core.state import Array


class ParticleRows:
    """Rows of all molecules, kind by kind, molecule by molecule.

    Args:
        kinds: The molecules.
        slices: Where each kind stands in a vector of all coordinates.

    Attributes:
        count: How many rows there are.
    """

    def __init__(self, kinds: Sequence[Molecules], slices: Sequence[slice]) -> None:
        self._kinds, self._slices = tuple(kinds), tuple(slices)
        self._size = slices[-1].stop
        self.count = sum(kind.count * len(kind.rows) for kind in kinds)

    def split(self, flat: Array) -> list[Array]:
        """Views of a vector of all coordinates, (atoms, 3, lanes) of each kind."""
        pairs = zip(self._kinds, self._slices, strict=True)
        return [kind.lanes(flat[mine]) for kind, mine in pairs]

    def residual(self, t: float, q: Array) -> Array:
        """G of all rows, shape (m,)."""
        parts = zip(self._kinds, self.split(q), strict=True)
        return _joined([kind.residual(x) for kind, x in parts])

    def rate_of_rows(self, q: Array, v: Array) -> Array:
        """G' = J v of all rows, shape (m,), without forming J."""
        parts = zip(self._kinds, self.split(q), self.split(v), strict=True)
        return _joined([kind.rate(x, w) for kind, x, w in parts])

    def rate(self, t: float, q: Array) -> Array:
        """dg/dt, shape (m,)."""
        return np.zeros(self.count)

    def jacobian(self, t: float, q: Array) -> Array:
        """dg/dq, shape (m, nv), dense."""
        J, row = np.zeros((self.count, self._size)), 0
        for kind, x, mine in zip(self._kinds, self.split(q), self._slices, strict=True):
            own = [row for cluster in kind.clusters for row in cluster.rows]
            directions = [one.direction(x) for one in own]
            for lane in range(kind.count):
                first = mine.start + 3 * len(kind.atoms) * lane
                for one, D in zip(own, directions, strict=True):
                    for i, sign in one.ends:
                        J[row, first + 3 * i : first + 3 * i + 3] += sign * D[:, lane]
                    row += 1
        return J

    def multipliers(self, q: Array, v: Array, force: Array) -> Array:
        """Multipliers of all rows, shape (m,), block by block."""
        parts = zip(self._kinds, *map(self.split, (q, v, force)), strict=True)
        lam = [kind.multipliers(x, w, kind.accelerations(f)) for kind, x, w, f in parts]
        return _joined(lam)

    def pushed(self, q: Array, lam: Array) -> Array:
        """J' lam, shape (nv,), block by block."""
        force, first = np.zeros(self._size), 0
        for kind, x, mine in zip(self._kinds, self.split(q), self._slices, strict=True):
            m = sum(len(cluster.rows) for cluster in kind.clusters) * kind.count
            of_kind = lam[first : first + m].reshape(kind.count, -1).T
            kind.lanes(force[mine])[...] = kind.pushed(x, of_kind)
            first += m
        return force


def _joined(parts: Sequence[Array]) -> Array:
    """Rows of shape (m, lanes) of each kind as one vector, molecule by molecule."""
    return np.concatenate([part.T.ravel() for part in parts])
