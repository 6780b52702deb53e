"""Forces between points of different molecules, up to a cut-off, with a list of near pairs.

    Coulomb        V = k q_i q_j (1/r + r^2 / (2 rc^3) - 3 / (2 rc))      force 0 at rc
    Lennard-Jones  V = U(r) - U(rc) - (r - rc) U'(rc)                     force 0 at rc
                   U = 4 epsilon ((sigma/r)^12 - (sigma/r)^6)

The first is that of a reaction field of infinite permittivity. Both energies and forces are
continuous at the cut-off rc. Mixed sigma are arithmetic, mixed epsilon geometric means.

Source: M. P. Allen, D. J. Tildesley, Computer Simulation of Liquids, 2nd ed., 2017, sec. 5.2.2,
    6.4 (reaction field), 1.4.2 (mixtures).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.methods.particles.molecules import Sites

_SKIN = 0.3  # of the cut-off, within which the list holds further pairs
_FEW = 1000  # points up to which lists of all pairs cost less than new ones
Whole = NDArray[np.int32]
Near = Callable[[Array, Array | None, float], Whole]


class PairModel(NamedTuple):
    """Forces between pairs of particles.

    Attributes:
        box: Edges of the periodic box, shape (3,); None without one.
        charges: sqrt(k) q of each point, atoms and then sites, shape (n,).
        types: Number of the type of each point, shape (n,).
        sigma: Of two types, shape (types, types).
    """

    cutoff: float
    box: Array | None
    charges: Array
    types: Whole
    sigma: Array
    epsilon: Array

    @property
    def powers(self) -> tuple[Array, Array, Array, Array]:
        """4 eps sigma^12, 4 eps sigma^6, U(rc) and U'(rc) of two types, (types, types) each."""
        twelve = 4.0 * self.epsilon * self.sigma**12
        six = 4.0 * self.epsilon * self.sigma**6
        rc = self.cutoff
        return (
            twelve,
            six,
            twelve / rc**12 - six / rc**6,
            (6.0 * six / rc**6 - 12.0 * twelve / rc**12) / rc,
        )


class NearPairs(NamedTuple):
    """Pairs i < j, sorted by i, then j.

    Attributes:
        first: Where the pairs of each point begin, shape (n + 1,).
        i: Shape (pairs,).
        j: Shape (pairs,).
    """

    first: Whole
    i: Whole
    j: Whole


Kernel = Callable[[NearPairs, Array, Array], float]


class PlainKernel:
    """Forces of a list of pairs, by arrays.

    Args:
        model: What pairs exert on one another.
    """

    def __init__(self, model: PairModel) -> None:
        self._model, self._powers = model, model.powers

    def __call__(self, pairs: NearPairs, x: Array, force: Array) -> float:
        """Adds forces, shape (n, 3); returns the energy."""
        model = self._model
        i, j = pairs.i, pairs.j
        d = x[i] - x[j]
        if model.box is not None:
            d -= model.box * np.rint(d / model.box)
        square = np.einsum("pk,pk->p", d, d)
        near = square < model.cutoff**2
        i, j, d, square = i[near], j[near], d[near], square[near]
        inverse = 1.0 / square
        energy, strength = self._coulomb(i, j, square, inverse)
        lj = np.flatnonzero(model.epsilon[model.types[i], model.types[j]])
        of_lj = self._lennard_jones(model.types[i[lj]], model.types[j[lj]], inverse[lj])
        strength[lj] += of_lj[1]
        pull = strength[:, None] * d
        for k in range(3):
            force[:, k] += np.bincount(i, pull[:, k], len(x)) - np.bincount(j, pull[:, k], len(x))
        return energy + of_lj[0]

    def _coulomb(self, i: Whole, j: Whole, square: Array, inverse: Array) -> tuple[float, Array]:
        rc, charges = self._model.cutoff, self._model.charges
        product = charges[i] * charges[j]
        root = np.sqrt(inverse)
        energy = float(product.dot(root + square / (2.0 * rc**3) - 1.5 / rc))
        return energy, product * (root * inverse - rc**-3.0)

    def _lennard_jones(self, a: Whole, b: Whole, inverse: Array) -> tuple[float, Array]:
        twelve, six, at_cutoff, slope = (table[a, b] for table in self._powers)
        cube, root = inverse**3, np.sqrt(inverse)
        energy = (
            (twelve * cube - six) * cube - at_cutoff - (1.0 / root - self._model.cutoff) * slope
        )
        strength = (12.0 * twelve * cube - 6.0 * six) * cube * inverse + slope * root
        return float(energy.sum()), strength


class Pairs:
    """Forces between points of different molecules.

    The list holds pairs up to a little beyond the cut-off, and is made anew once a point has moved
    by half of that: no pair is left out. A small scene has all pairs in its list, for good. Sums
    are in the order of the points, so that forces do not depend on when the list was made.

    Args:
        model: What pairs exert on one another.
        molecules: Number of the molecule of each point, shape (n,).
        near: Pairs of near points, of positions, box and distance.
        kernel: What adds their forces.
        sites: Points without mass that model and molecules name after those with; None without.
    """

    def __init__(
        self,
        model: PairModel,
        molecules: Whole,
        near: Near,
        kernel: Kernel,
        sites: Sites | None = None,
    ) -> None:
        self.model, self._molecules, self._near, self.kernel = model, molecules, near, kernel
        self.sites = sites
        self._at: Array | None = None
        self._pairs = NearPairs(*3 * (np.zeros(0, dtype=np.int32),))
        self.lists = 0

    def add_force(self, x: Array, force: Array) -> float:
        """Adds forces at positions, both of shape (n, 3); returns their potential energy."""
        if self.sites is None:
            return self._added(x, force)
        x = self.sites.with_sites(x)
        of_all = np.zeros_like(x)
        energy = self._added(x, of_all)
        self.sites.add_to_atoms(force, of_all)
        return energy

    def _added(self, x: Array, force: Array) -> float:
        if not self._lasts(x):
            reach = np.inf if len(x) <= _FEW else (1.0 + _SKIN) * self.model.cutoff
            self._pairs, self._at = self.pairs_within(x, reach), x.copy()
            self.lists += 1
        return self.kernel(self._pairs, x, force)

    def _lasts(self, x: Array) -> bool:
        """Whether no point has moved so far that the list may miss a pair."""
        if self._at is None or len(x) <= _FEW:
            return self._at is not None
        moved = float(((x - self._at) ** 2).sum(axis=1).max())
        return moved < (0.5 * _SKIN * self.model.cutoff) ** 2

    def pairs_within(self, x: Array, reach: float) -> NearPairs:
        """Pairs of different molecules that are nearer than a distance."""
        if reach == np.inf:
            indices = np.stack(np.triu_indices(len(x), 1), axis=1).astype(np.int32)
        elif np.isfinite(x).all():
            indices = self._near(x, self.model.box, reach)
        else:
            indices = np.zeros((0, 2), dtype=np.int32)
        indices = indices[self._molecules[indices[:, 0]] != self._molecules[indices[:, 1]]]
        i, j = np.ascontiguousarray(indices.T)
        first = np.searchsorted(i, np.arange(len(x) + 1)).astype(np.int32)
        return NearPairs(first, i, j)

    def with_kernel(self, kernel: Kernel) -> "Pairs":
        """The same pairs with another way to add their forces."""
        return Pairs(self.model, self._molecules, self._near, kernel, self.sites)
