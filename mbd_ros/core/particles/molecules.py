"""Molecules of one kind: a template, repeated; arrays of them are (atoms, 3, lanes)."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mbd_ros.core.particles import elastic, fields
from mbd_ros.core.particles.cluster import Cluster, blocks_of
from mbd_ros.core.particles.elastic import ElasticTerm
from mbd_ros.core.particles.fields import Field
from mbd_ros.core.particles.row_geometry import PointRow
from mbd_ros.core.particles.settle import SettledCluster, triangle_of
from mbd_ros.core.state import Array


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
        of_fields = fields.energy_of(self.fields, self.masses, x)
        return of_fields + elastic.energy_of(self.terms, x)

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
