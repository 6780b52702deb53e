"""Molecules as what is sampled: coordinates of all points, rows of each kind side by side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.rows.constraint_rows import independent
from mbd_ros.core.state import Array
from mbd_ros.methods.particles.molecules import Molecules
from mbd_ros.methods.particles.particle_system import PairForces
from mbd_ros.methods.particles.rigid_bonds import DistanceRow, PointRow, SurfaceRow


class ParticleSpace:
    """Positions of all points of molecules, a `Space`.

    Args:
        kinds: The molecules, in the order of the coordinates.
        pair_forces: Forces between points; None without any.

    Attributes:
        names: x, y and z of every point.
        size: Three times the number of points.
        mass: Of every coordinate.
        blocks: Rows a kind.
        scale: Usual distance of the points of a molecule.
    """

    has_constant_masses = True

    def __init__(self, kinds: Sequence[Molecules], pair_forces: PairForces | None = None) -> None:
        self.kinds = tuple(kinds)
        self.pair_forces = pair_forces
        labels = [label for kind in kinds for label in kind.labels]
        self.names = tuple(f"{label}.{axis}" for label in labels for axis in "xyz")
        self.size = len(self.names)
        masses = [np.tile(kind.masses, kind.count) for kind in kinds]
        self.mass: Array = np.repeat(np.concatenate(masses), 3)
        self._first = np.cumsum([0, *(3 * kind.size for kind in kinds)]).tolist()
        self.blocks = tuple(
            MoleculeRows(kind, first, is_alone=len(kinds) == 1)
            for kind, first in zip(kinds, self._first, strict=False)
            if kind.rows
        )
        self.scale = _usual_size(self.kinds)

    def potential(self, q: Array) -> Array:
        """Potential energy, shape (chains,)."""
        energy = np.zeros(q.shape[1])
        for kind, x in self._lanes(q):
            energy += kind.energy(x).reshape(kind.count, -1).sum(axis=0)
        if self.pair_forces is not None:
            energy += np.array([self._pairs_of(one)[0] for one in q.T])
        return energy

    def force(self, q: Array) -> Array:
        """-dV/dq, shape (size, chains)."""
        force, chains = np.zeros(q.shape), q.shape[1]
        for (kind, x), first in zip(self._lanes(q), self._first, strict=False):
            if kind.terms or kind.fields:
                own = np.zeros(x.shape)
                kind.add_force(x, own)
                by_copy = own.reshape(x.shape[0] * 3, kind.count, chains).transpose(1, 0, 2)
                force[first : first + 3 * kind.size] = by_copy.reshape(-1, chains)
        if self.pair_forces is not None:
            for i, one in enumerate(q.T):
                force[:, i] += self._pairs_of(one)[1]
        return force

    def _pairs_of(self, q: Array) -> tuple[float, Array]:
        """Energy and forces of the pairs of one chain, the forces of shape (size,)."""
        assert self.pair_forces is not None
        force = np.zeros((self.size // 3, 3))
        energy = self.pair_forces.add_force(np.ascontiguousarray(q).reshape(-1, 3), force)
        return energy, force.ravel()

    def volume(self, q: Array, *, fixman: bool) -> Array:
        """Nothing: masses are constant."""
        return np.zeros(q.shape[1])

    def kinetic_parts(self, q: Array, v: Array) -> Array:
        """Return mean energies of translation, rotation and internal motion of each kind.

        Returns:
            Shape (3 kinds, chains).
        """
        means, chains = [], q.shape[1]
        for (kind, x), (_, w) in zip(self._lanes(q), self._lanes(v), strict=True):
            parts = kinetic_parts(kind.masses, x, w)
            means.append(parts.reshape(3, kind.count, chains).mean(axis=1))
        return np.concatenate(means)

    def _lanes(self, q: Array) -> list[tuple[Molecules, Array]]:
        """Return the positions of each kind of molecules, (atoms, 3, copies * chains)."""
        lanes = []
        for kind, first in zip(self.kinds, self._first, strict=False):
            atoms, chains = len(kind.atoms), q.shape[1]
            mine = q[first : first + 3 * kind.size].reshape(kind.count, 3 * atoms, chains)
            lanes.append((kind, mine.transpose(1, 0, 2).reshape(atoms, 3, -1)))
        return lanes


def _usual_size(kinds: Sequence[Molecules]) -> float:
    """Median of the lengths between points of a molecule, of points from the origin else."""
    lengths = []
    for kind in kinds:
        apart = np.linalg.norm(kind.at[:, None] - kind.at[None, :], axis=2)
        lengths += list(apart[np.triu_indices(len(kind.at), 1)])
        lengths += [row.length for row in kind.rows if isinstance(row, DistanceRow)]
    lengths = [x for x in lengths if x > 0.0]
    if not lengths:
        lengths = [float(np.linalg.norm(kind.at, axis=1).max()) for kind in kinds]
    found = float(np.median(lengths))
    return found if found > 0.0 else 1.0


class MoleculeRows:
    """Rows of a kind of molecules; those that others imply are left out.

    Args:
        first: Number of their first coordinate.

    Attributes:
        coordinates: Shape (3 atoms, copies); None where they are all there are.
        copies: Number of molecules.
        rows: Names of the rows of one of them.
    """

    coordinates: Array | None

    def __init__(self, kind: Molecules, first: int, *, is_alone: bool) -> None:
        self._atoms = len(kind.atoms)
        self.copies = kind.count
        size = 3 * self._atoms
        self.coordinates = first + np.arange(size * self.copies).reshape(-1, size).T
        if is_alone and self.copies == 1:
            self.coordinates = None
        self._take(list(kind.rows))
        J = self.jacobian(kind.at.reshape(-1, 1))[:, :, 0]
        ordered: list[PointRow] = [*self._bonds, *self._surfaces]
        self._take([ordered[i] for i in independent(J)])
        kept: list[PointRow] = [*self._bonds, *self._surfaces]
        self.rows = tuple(row.name for row in kept)

    def _take(self, rows: Sequence[PointRow]) -> None:
        self._bonds = [row for row in rows if isinstance(row, DistanceRow)]
        self._surfaces = [row for row in rows if isinstance(row, SurfaceRow)]
        self._i = np.array([row.i for row in self._bonds], dtype=np.intp)
        self._j = np.array([row.j for row in self._bonds], dtype=np.intp)
        self._length = np.array([row.length for row in self._bonds])[:, None, None]
        self._at = np.array([row.i for row in self._surfaces], dtype=np.intp)
        self._level = np.array([row.level for row in self._surfaces])[:, None]
        self._squares, self._normal, self._center = (
            np.array([getattr(row, name) for row in self._surfaces]).reshape(-1, 3, 1)
            for name in ("squares", "normal", "center")
        )

    def residual(self, x: Array) -> Array:
        """g, shape (m, n)."""
        at, n = x.reshape(self._atoms, 3, -1), len(self._bonds)
        g = np.empty((n + len(self._surfaces), x.shape[1]))
        d = at[self._i] - at[self._j]
        length = self._length[:, 0]
        g[:n] = 0.5 * (np.einsum("kcn,kcn->kn", d, d) / length - length)
        if self._surfaces:
            d = at[self._at] - self._center
            g[n:] = np.einsum("kcn,kcn->kn", self._squares * d + self._normal, d) - self._level
        return g

    def jacobian(self, x: Array) -> Array:
        """dg/dx, shape (m, 3 atoms, n)."""
        at, n = x.reshape(self._atoms, 3, -1), len(self._bonds)
        J = np.zeros((n + len(self._surfaces), *at.shape))
        d = (at[self._i] - at[self._j]) / self._length
        rows = np.arange(n)
        J[rows, self._i], J[rows, self._j] = d, -d
        if self._surfaces:
            d = at[self._at] - self._center
            J[np.arange(n, len(J)), self._at] = 2.0 * self._squares * d + self._normal
        return J.reshape(len(J), *x.shape)


def kinetic_parts(masses: Array, x: Array, v: Array) -> Array:
    """Kinetic energy of translation, rotation and what is left of molecules, shape (3, n).

    Rotation is L . I^-1 L / 2 about the centre of mass, with the angular momentum and the inertia
    of the instant: a frame that is tied to one bond counts other motion as rotation.

    Args:
        masses: Shape (atoms,).
        x: Positions, shape (atoms, 3, n).
    """
    m, total = masses[:, None, None], float(masses.sum())
    V = (m * v).sum(axis=0) / total
    r, w = x - (m * x).sum(axis=0) / total, v - V
    L = (m * np.cross(r, w, axis=1)).sum(axis=0)
    unit = np.eye(3)[:, :, None]
    inertia = (m * r * r).sum(axis=(0, 1)) * unit - np.einsum("a,acn,adn->cdn", masses, r, r)
    inverse = np.linalg.pinv(inertia.transpose(2, 0, 1), rcond=1.0e-9, hermitian=True)
    translation = 0.5 * total * (V * V).sum(axis=0)
    rotation = 0.5 * np.einsum("cn,ncd,dn->n", L, inverse, L)
    kinetic = 0.5 * np.einsum("a,acn,acn->n", masses, v, v)
    return np.array([translation, rotation, kinetic - translation - rotation])
