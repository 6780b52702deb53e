"""A space whose density of configurations stands in its potential, so that masses are constant."""

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.features.sampling.space import Space

_APART = 1.0e-5  # of the scale: steps of differences


class WeightedSpace:
    """A space with the potential V - kT ln(density); see `space.Space`.

    With the constant masses its configurations have the density that they have with those of the
    kinetic energy, so that what holds for constant masses holds for it.

    Args:
        space: The space, without walls.
        kT: Thermal energy, in the unit of its energies.
        fixman: Whether rows are the limit of stiff springs.
    """

    has_constant_masses = True

    def __init__(self, space: Space, kT: float, *, fixman: bool) -> None:
        self._space, self._kT, self._fixman = space, kT, fixman
        self.names, self.size, self.mass = space.names, space.size, space.mass
        self.scale, self.blocks = space.scale, space.blocks
        self.force = space.force

    def potential(self, q: Array) -> Array:
        """V - kT ln(density), shape (chains,)."""
        space = self._space
        return space.potential(q) - self._kT * space.volume(q, fixman=self._fixman)

    def gradient(self, q: Array) -> Array:
        """Gradient of `potential` by central differences, shape (size, chains).

        `force` leaves the density out: it leads steps, which are accepted or not.
        """
        found, h = np.empty(q.shape), _APART * self.scale
        for i in range(self.size):
            ahead, behind = q.copy(), q.copy()
            ahead[i] += h
            behind[i] -= h
            found[i] = (self.potential(ahead) - self.potential(behind)) / (2.0 * h)
        return found

    def volume(self, q: Array, *, fixman: bool) -> Array:
        """0: nothing is left for it, shape (chains,)."""
        return np.zeros(q.shape[1])
