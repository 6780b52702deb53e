"""Molecules of one kind: bonds, angles, torsions, charges, external fields.

Arrays of positions and forces have the shape (atoms, 3, lanes), one lane a molecule. Each elastic
term and field adds its force and gives its energy, a number a lane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import TINY
from mbd_ros.methods.particles.rigid_bonds import Cluster, PointRow, blocks_of, product
from mbd_ros.methods.particles.settle import SettledCluster, triangle_of


class ElasticBond(NamedTuple):
    """V = k/2 (|x_i - x_j| - L)^2.

    Attributes:
        i: Number of the first point in the molecule.
        j: Number of the second.
    """

    i: int
    j: int
    length: float
    stiffness: float

    def energy(self, x: Array) -> Array:
        """V, shape (lanes,)."""
        stretch = _norm(x[self.i] - x[self.j]) - self.length
        energy: Array = 0.5 * self.stiffness * stretch**2
        return energy

    def add_force(self, x: Array, force: Array) -> None:
        """Adds -dV/dx."""
        d = x[self.i] - x[self.j]
        r = np.maximum(_norm(d), TINY)
        pull = (self.stiffness * (self.length / r - 1.0)) * d
        force[self.i] += pull
        force[self.j] -= pull


class ElasticAngle(NamedTuple):
    """V = k/2 (theta - theta_0)^2, theta the angle at the second of three points.

    Attributes:
        i: Number of the first point in the molecule.
        j: Number of that at the corner.
        k: Number of the third.
        angle: theta_0 [rad].
    """

    i: int
    j: int
    k: int
    angle: float
    stiffness: float

    def energy(self, x: Array) -> Array:
        """V, shape (lanes,)."""
        theta = self._corner(x)[0]
        energy: Array = 0.5 * self.stiffness * (theta - self.angle) ** 2
        return energy

    def add_force(self, x: Array, force: Array) -> None:
        """Adds -dV/dx; a straight angle has no direction of its force, and none is exerted."""
        theta, along, across, e, f, c, s = self._corner(x)
        size = -self.stiffness * (theta - self.angle) / np.maximum(s, TINY)
        size = np.where(s > TINY, size, 0.0)
        first = (size / along) * (c * e - f)
        third = (size / across) * (c * f - e)
        force[self.i] += first
        force[self.k] += third
        force[self.j] -= first + third

    def _corner(self, x: Array) -> tuple[Array, ...]:
        a, b = x[self.i] - x[self.j], x[self.k] - x[self.j]
        along, across = _norm(a), _norm(b)
        e, f = a / along, b / across
        c, s = product(e, f), _norm(np.cross(e, f, axis=0))
        return np.arctan2(s, c), along, across, e, f, c, s


class Torsion(NamedTuple):
    """V = sum_n c_n cos(phi)^n of the dihedral angle of four points, phi = 0 where cis.

    Attributes:
        points: Their numbers in the molecule.
        coefficients: c, from n = 0 on.

    Source: J.-P. Ryckaert, A. Bellemans, Chem. Phys. Lett. 30, 1975, 123-125, for the form;
        their angle is phi - pi.
    """

    points: tuple[int, int, int, int]
    coefficients: tuple[float, ...]

    def energy(self, x: Array) -> Array:
        """V, shape (lanes,)."""
        m, n = self._normals(x)[3:]
        cosine = product(m, n) / np.sqrt(product(m, m) * product(n, n))
        energy: Array = np.polynomial.polynomial.polyval(cosine, np.array(self.coefficients))
        return energy

    def add_force(self, x: Array, force: Array) -> None:
        """Adds -dV/dx."""
        i, j, k, end = self.points
        a, b, c, m, n = self._normals(x)
        mm, nn = product(m, m), product(n, n)
        size = np.sqrt(mm * nn)
        cosine = product(m, n) / size
        slopes = np.polynomial.polynomial.polyder(np.array(self.coefficients))
        slope = -np.polynomial.polynomial.polyval(cosine, slopes)
        by_m = slope * (n / size - (cosine / mm) * m)
        by_n = slope * (m / size - (cosine / nn) * n)
        of_a = np.cross(b, by_m, axis=0)
        of_b = np.cross(by_m, a, axis=0) + np.cross(c, by_n, axis=0)
        of_c = np.cross(by_n, b, axis=0)
        force[i] -= of_a
        force[j] += of_a - of_b
        force[k] += of_b - of_c
        force[end] += of_c

    def _normals(self, x: Array) -> tuple[Array, Array, Array, Array, Array]:
        i, j, k, end = self.points
        a, b, c = x[j] - x[i], x[k] - x[j], x[end] - x[k]
        return a, b, c, np.cross(a, b, axis=0), np.cross(b, c, axis=0)


ElasticTerm = ElasticBond | ElasticAngle | Torsion


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


@dataclass(frozen=True, eq=False)
class Molecules:
    """Molecules of one kind.

    Attributes:
        name: Of the kind.
        atoms: Names of the points of one of them.
        masses: Shape (atoms,).
        at: The template, shape (atoms, 3).
        count: How many there are.
        rows: Rigid rows of one of them.
        terms: Elastic bonds, angles and torsions of one of them.
        fields: External fields that act on them.
        clusters: The rows, in blocks that share no point.
        mobility: 1/m, shape (atoms, 1, 1).
    """

    name: str
    atoms: tuple[str, ...]
    masses: Array
    at: Array
    count: int
    rows: tuple[PointRow, ...] = ()
    terms: tuple[ElasticTerm, ...] = ()
    fields: tuple[Field, ...] = ()
    clusters: tuple[Cluster, ...] = field(init=False)
    mobility: Array = field(init=False)

    def __post_init__(self) -> None:
        found = (cluster_of(rows, self.masses, self.at) for rows in blocks_of(self.rows))
        object.__setattr__(self, "clusters", tuple(found))
        object.__setattr__(self, "mobility", (1.0 / self.masses)[:, None, None])

    @property
    def size(self) -> int:
        """Points of all molecules."""
        return self.count * len(self.atoms)

    @property
    def labels(self) -> list[str]:
        """Names of all points: O for one molecule, water_3_O for the third of several."""
        return self._numbered(self.atoms)

    @property
    def row_names(self) -> list[str]:
        """Names of all rows, molecule by molecule, in the order of the multipliers."""
        return self._numbered([row.name for cluster in self.clusters for row in cluster.rows])

    def _numbered(self, names: Sequence[str]) -> list[str]:
        if self.count == 1:
            return list(names)
        return [f"{self.name}_{k + 1}_{name}" for k in range(self.count) for name in names]

    def lanes(self, flat: Array) -> Array:
        """A view of their part of a vector, (3 size,), as (atoms, 3, lanes)."""
        return flat.reshape(-1, len(self.atoms), 3).transpose(1, 2, 0)

    def energy(self, x: Array) -> Array:
        """Potential energy of each molecule without pair forces, shape (lanes,)."""
        of_fields = field_energy(self.fields, self.masses, x)
        return of_fields + energy_of(self.terms, x)

    def kinetic(self, v: Array) -> Array:
        """Kinetic energy of each molecule, shape (lanes,)."""
        kinetic: Array = 0.5 * np.einsum("a,akl,akl->l", self.masses, v, v)
        return kinetic

    def add_force(self, x: Array, force: Array) -> None:
        """Adds the forces of fields and elastic terms, shape (atoms, 3, lanes)."""
        for one in self.fields:
            one.add_force(self.masses, x, force)
        for term in self.terms:
            term.add_force(x, force)

    @property
    def has_forces(self) -> bool:
        """Whether fields or elastic terms act on them."""
        return bool(self.fields or self.terms)

    def accelerations(self, force: Array) -> Array:
        """M^-1 force, shape (atoms, 3, lanes)."""
        a: Array = force * self.mobility
        return a

    def residual(self, x: Array) -> Array:
        """G of all rows, shape (rows, lanes)."""
        return self._stacked([cluster.residual(x) for cluster in self.clusters], x)

    def rate(self, x: Array, v: Array) -> Array:
        """G' of all rows, shape (rows, lanes)."""
        return self._stacked([cluster.rate(x, v) for cluster in self.clusters], x)

    def multipliers(self, x: Array, v: Array, a: Array) -> Array:
        """Multipliers of all rows, shape (rows, lanes), from accelerations without rows."""
        return self._stacked([c.multipliers(x, v, a) for c in self.clusters], x)

    def pushed(self, x: Array, lam: Array) -> Array:
        """J' lam, shape (atoms, 3, lanes)."""
        force, first = np.zeros_like(x), 0
        for cluster in self.clusters:
            last = first + len(cluster.rows)
            force += cluster.pushed(x, lam[first:last])
            first = last
        return force

    def project(self, x: Array, v: Array) -> None:
        """Moves velocities onto the rows, the nearest ones in the mass metric."""
        for cluster in self.clusters:
            cluster.project(x, v)

    @staticmethod
    def _stacked(parts: list[Array], x: Array) -> Array:
        return np.vstack(parts) if parts else np.zeros((0, x.shape[2]))


def cluster_of(rows: Sequence[PointRow], masses: Array, at: Array) -> Cluster:
    """A block of rows with the solver that fits: closed form of a rigid triangle, or Newton's."""
    triangle = triangle_of(rows, masses)
    if triangle is not None:
        return SettledCluster(rows, masses, at, triangle)
    return Cluster(rows, masses, at)


def field_energy(fields: Sequence[Field], masses: Array, x: Array) -> Array:
    """Sum of the energies, shape (lanes,)."""
    energy = np.zeros(x.shape[2])
    for outer in fields:
        energy += outer.energy(masses, x)
    return energy


def energy_of(terms: Sequence[ElasticTerm], x: Array) -> Array:
    """Sum of the energies, shape (lanes,)."""
    energy = np.zeros(x.shape[2])
    for term in terms:
        energy += term.energy(x)
    return energy


class SiteGroup(NamedTuple):
    """The sites of the molecules of one kind.

    Attributes:
        first: Number of the first atom of the kind.
        molecules: How many there are.
        weights: Of the atoms of a molecule, which sum to 1, shape (sites, atoms).
    """

    first: int
    molecules: int
    weights: Array


class Sites:
    """All sites of a scene: points without mass that carry charges.

    A site is a weighted mean of atoms of its molecule: x_s = sum_i w_i x_i, f_i += w_i f_s. Sites
    follow the atoms, group by group, molecule by molecule.

    Args:
        atoms: How many atoms there are.

    Attributes:
        count: How many sites there are.
    """

    def __init__(self, groups: Sequence[SiteGroup], atoms: int) -> None:
        self._groups, self._atoms = tuple(groups), atoms
        self.count = sum(group.molecules * len(group.weights) for group in groups)

    def with_sites(self, x: Array) -> Array:
        """Positions of atoms, shape (atoms, 3), then those of sites."""
        parts = [x]
        for group in self._groups:
            parts.append(np.matmul(group.weights, self._molecules(x, group)).reshape(-1, 3))
        return np.concatenate(parts)

    def add_to_atoms(self, force: Array, of_all: Array) -> None:
        """Adds forces on atoms and sites to those on atoms, shape (atoms, 3)."""
        force += of_all[: self._atoms]
        begin = self._atoms
        for group in self._groups:
            end = begin + group.molecules * len(group.weights)
            of_sites = of_all[begin:end].reshape(group.molecules, -1, 3)
            self._molecules(force, group)[...] += np.matmul(group.weights.T, of_sites)
            begin = end

    @staticmethod
    def _molecules(x: Array, group: SiteGroup) -> Array:
        """A view of the atoms of a group, shape (count, atoms, 3)."""
        size = group.weights.shape[1]
        return x[group.first : group.first + group.molecules * size].reshape(
            group.molecules, size, 3
        )


def _norm(a: Array) -> Array:
    norm: Array = np.sqrt(product(a, a))
    return norm
