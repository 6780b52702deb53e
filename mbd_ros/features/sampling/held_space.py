"""A space in which one quantity is held, beside the rows that it has."""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.features.sampling.observables import Observable
from mbd_ros.features.sampling.space import Space


class HeldRows:
    """All rows of a space and, last, that of the held quantity.

    Args:
        space: The space.
        held: The quantity.
        level: Its value.

    Attributes:
        coordinates: None: all of them.
        copies: 1.
        rows: Names.
    """

    coordinates = None
    copies = 1

    def __init__(self, space: Space, held: Observable, level: float) -> None:
        self._blocks, self._held, self.level = space.blocks, held, level
        names = [row for block in space.blocks for _ in range(block.copies) for row in block.rows]
        self.rows: Sequence[str] = (*names, held.name)

    def residual(self, x: Array) -> Array:
        """g, shape (m, n)."""
        parts = []
        for block in self._blocks:
            at, n = block.coordinates, x.shape[1]
            g = block.residual(x if at is None else x[at].reshape(len(at), -1))
            parts.append(g.reshape(-1, n))
        return np.vstack((*parts, self._held.value(x) - self.level))

    def jacobian(self, x: Array) -> Array:
        """dg/dx, shape (m, size, n)."""
        size, n, first = *x.shape, 0
        J = np.zeros((len(self.rows), size, n))
        for block in self._blocks:
            at, m = block.coordinates, len(block.rows)
            if at is None:
                J[first : first + m] = block.jacobian(x)
            else:
                own = block.jacobian(x[at].reshape(len(at), -1))
                own = own.reshape(m, len(at), block.copies, n)
                for copy in range(block.copies):
                    rows = first + copy + block.copies * np.arange(m)
                    J[rows[:, None], at[None, :, copy]] = own[:, :, copy]
            first += m * block.copies
        J[-1] = self._held.gradient(x)
        return J


class HeldSpace:
    """See the module and `space.Space`.

    Args:
        space: The space, with constant masses.
        held: The quantity.
        level: Its value.
    """

    has_constant_masses = True

    def __init__(self, space: Space, held: Observable, level: float) -> None:
        self.names, self.size, self.mass = space.names, space.size, space.mass
        self.scale, self.potential, self.force = space.scale, space.potential, space.force
        self.volume = space.volume
        self.blocks = (HeldRows(space, held, level),)
