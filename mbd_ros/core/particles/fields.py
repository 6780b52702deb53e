"""External fields that act on every particle: accelerations, and potentials of the position."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array


class UniformField(NamedTuple):
    """V = -m g . x: the same acceleration for all.

    Attributes:
        acceleration: g, shape (3,).
    """

    acceleration: Array

    def energy(self, masses: Array, x: Array) -> Array:
        """V, shape (lanes,).

        Args:
            masses: Shape (atoms,).
            x: Positions, shape (atoms, 3, lanes).
        """
        energy: Array = -np.einsum("a,k,akl->l", masses, self.acceleration, x)
        return energy

    def add_force(self, masses: Array, x: Array, force: Array) -> None:
        """Adds -dV/dx."""
        force += masses[:, None, None] * self.acceleration[:, None]


class PolynomialField(NamedTuple):
    """V = sum c x^p y^q z^r for each particle.

    Attributes:
        coefficients: c, shape (terms,).
        powers: p, q and r >= 0, shape (terms, 3).
    """

    coefficients: Array
    powers: Array

    def energy(self, masses: Array, x: Array) -> Array:
        """V, shape (lanes,)."""
        energy = np.zeros(x.shape[2])
        for c, powers in zip(self.coefficients, self.powers, strict=True):
            energy += c * np.prod(x ** powers[:, None], axis=1).sum(axis=0)
        return energy

    def add_force(self, masses: Array, x: Array, force: Array) -> None:
        """Adds -dV/dx."""
        for c, powers in zip(self.coefficients, self.powers, strict=True):
            for k in np.flatnonzero(powers):
                lowered = powers - (np.arange(3) == k)
                slope = c * powers[k] * np.prod(x ** lowered[:, None], axis=1)
                force[:, k] -= slope


Field = UniformField | PolynomialField


def energy_of(fields: Sequence[Field], masses: Array, x: Array) -> Array:
    """Sum of the energies, shape (lanes,)."""
    energy = np.zeros(x.shape[2])
    for field in fields:
        energy += field.energy(masses, x)
    return energy
