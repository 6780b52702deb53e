"""The canonical ensemble of a space: its energy, its forces, and steps of RATTLE in it."""

from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.features.sampling.manifold import Manifold, Place
from mbd_ros.features.sampling.space import Marks, Space


class Walkers(NamedTuple):
    """States of chains and what is known there.

    Attributes:
        q: Configurations, shape (size, chains).
        v: Velocities with J v = 0.
        places: Rows at q.
        force: On the coordinates at q.
        whole: Which chains are there: a step that has not ended on the rows is not, (chains,).
    """

    q: Array
    v: Array
    places: list[Place]
    force: Array
    whole: Marks


class Ensemble:
    """exp(-H / kT) of configurations that keep rows and of velocities along them.

    Args:
        space: The space.
        kT: Thermal energy, in the unit of its energies, > 0.
        fixman: Whether 1/2 kT ln det J M^-1 J' is added to the potential: configurations are then
            those of very stiff springs in place of the rows. Source: M. Fixman, PNAS 71, 1974,
            3050.
    """

    def __init__(self, space: Space, kT: float, *, fixman: bool = False) -> None:
        self.space, self.kT, self.fixman = space, kT, fixman
        self.manifold = Manifold(space)
        self._mass = space.mass[:, None]
        self._spread = np.sqrt(kT / self._mass)

    def energy(self, q: Array, places: list[Place]) -> Array:
        """Potential with what the density of configurations adds to it, shape (chains,)."""
        space, energy = self.space, self.space.potential(q)
        if not space.has_constant_masses:
            return energy - self.kT * space.volume(q, fixman=self.fixman)
        if self.fixman:
            return energy + 0.5 * self.kT * self.manifold.log_gram(places)
        return energy

    def force(self, q: Array, places: list[Place]) -> Array:
        """The negative gradient of `energy`, where masses are constant, shape (size, chains)."""
        force = self.space.force(q)
        if self.fixman and self.space.has_constant_masses:
            force = force - self.kT * self.manifold.log_gradient(places, q)
        return force

    def kinetic(self, v: Array) -> Array:
        """Kinetic energy of the velocities that are drawn, shape (chains,)."""
        energy: Array = 0.5 * (self._mass * v * v).sum(axis=0)
        return energy

    def drawn(self, random: np.random.Generator, places: list[Place], chains: int) -> Array:
        """Velocities at random, shape (size, chains)."""
        v = self._spread * random.standard_normal((self.space.size, chains))
        return self.manifold.project(places, v)

    def at(self, q: Array, v: Array) -> Walkers:
        """States of chains; velocities are along the rows already."""
        places = self.manifold.at(q)
        whole = np.ones(q.shape[1], dtype=np.bool_)
        return Walkers(q, v, places, self.force(q, places), whole)

    def kick(self, at: Walkers, h: float) -> Walkers:
        """Forces for a time; velocities stay along the rows."""
        v = self.manifold.project(at.places, at.v + (h / self._mass) * at.force)
        return at._replace(v=v)

    def move(self, at: Walkers, h: float) -> Walkers:
        """A step along the rows without forces: to q + h v - D s, where the rows are closed."""
        q, whole = self.manifold.close(at.places, at.q + h * at.v)
        places, v = self.manifold.at(q), (q - at.q) / h
        return Walkers(q, self.manifold.project(places, v), places, at.force, at.whole & whole)

    def step(self, at: Walkers, h: float) -> tuple[Walkers, Array]:
        """A step of RATTLE, and its velocity before the last projection, as SHAKE leaves it.

        Source: H. C. Andersen, J. Comput. Phys. 52, 1983, 24.
        """
        q, whole = self.manifold.close(
            at.places, at.q + h * (at.v + (0.5 * h / self._mass) * at.force)
        )
        places = self.manifold.at(q)
        force = self.force(q, places)
        v = (q - at.q) / h + (0.5 * h / self._mass) * force
        now = Walkers(q, self.manifold.project(places, v), places, force, at.whole & whole)
        return now, v
