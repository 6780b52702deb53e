"""Points with rows between them, as a system: no joints, no Pinocchio model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, Protocol

import numpy as np

from mbd_ros.core.dynamics.chart import Chart
from mbd_ros.core.dynamics.system import Accelerator
from mbd_ros.core.loads.internal_states import Internals
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.rows.constraint import Row
from mbd_ros.core.rows.constraint_rows import RowLayout
from mbd_ros.core.rows.delassus import RowFactor
from mbd_ros.core.state import NONE, Array, Evaluation, Mode, State
from mbd_ros.methods.particles.molecules import Molecules

Spread = Callable[[Molecules, Array], Array]


class ParticleSystem:
    """Points in space: q is x, y, z of each, kind by kind, molecule by molecule.

    It answers what `System` asks, without a robot: integrators, bilateral rows of positions,
    energy and multipliers. Rows are blocks, solved side by side; `jacobian` and `factorise` are
    dense, for scenes that can pay.

    Args:
        pairs: Forces between molecules; None without any.
        force_unit: For the names of multipliers.
        steps: What takes half steps of a kind, called as `KindSteps`; None for that.

    Attributes:
        slices: Where each kind stands in q and v.
        masses: Of each point, shape (n,).
    """

    tier = "particles"
    robot = None
    model = None
    k = None
    bounded = None
    event_rows = None
    sizes = None
    condition = 1.0

    def __init__(
        self,
        kinds: Sequence[Molecules],
        pairs: PairForces | None = None,
        force_unit: str = "N",
        steps: Callable[[Molecules, float, bool], Any] | None = None,
    ) -> None:
        self.kinds, self.pairs, self.steps = tuple(kinds), pairs, steps
        ends = (3 * np.cumsum([0, *(kind.size for kind in kinds)])).tolist()
        self.slices = [slice(*pair) for pair in pairwise(ends)]
        self.masses = np.concatenate([np.tile(kind.masses, kind.count) for kind in kinds])
        self._force_unit = force_unit
        self.nq = self.nv = 3 * len(self.masses)
        self.chart = Chart(SimpleNamespace(nq=self.nq, nv=self.nv, joints=()))
        self.internals, self.loads, self.layout = Internals(()), Loads(self.nv), RowLayout()
        rows = ParticleRows(self.kinds, self.slices)
        self.split, self.row_count = rows.split, rows.count
        self.residual, self.jacobian, self.rate = rows.residual, rows.jacobian, rows.rate
        self.rate_of_rows, self.multipliers = rows.rate_of_rows, rows.multipliers
        self.pushed = rows.pushed
        self.evaluations = 0
        self._mass = ParticleMass(np.repeat(self.masses, 3))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Return the value of each point."""
        return tuple(name for kind in self.kinds for name in kind.labels)

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """One entry a row, in the order of the multipliers."""
        names = (name for kind in self.kinds for name in kind.row_names)
        return tuple(Row(f"{name}.force", self._force_unit) for name in names)

    @property
    def multiplier_rows(self) -> tuple[Row, ...]:
        """The same."""
        return self.rows

    @property
    def bilateral(self) -> ParticleSystem:
        """All bilateral rows: those of positions, there are no others."""
        return self

    def joined(self, lanes: Sequence[Array]) -> Array:
        """A vector of all coordinates, fresh, from (atoms, 3, lanes) of each kind."""
        return np.concatenate([part.transpose(2, 0, 1).ravel() for part in lanes])

    def forces(self, lanes: Sequence[Array]) -> list[Array | None]:
        """Forces without those of the rows on each kind, None where there are none.

        Args:
            lanes: Places, (atoms, 3, lanes) of each kind.
        """
        self.evaluations += 1
        forces: list[Array | None] = []
        of_pairs = None
        if self.pairs is not None:
            flat = np.zeros(self.nv)
            self.pairs.add_force(self.joined(lanes).reshape(-1, 3), flat.reshape(-1, 3))
            of_pairs = self.split(flat)
        for number, (kind, x) in enumerate(zip(self.kinds, lanes, strict=True)):
            force = None if of_pairs is None else of_pairs[number]
            if kind.has_forces:
                force = np.zeros_like(x) if force is None else force
                kind.add_force(x, force)
            forces.append(force)
        return forces

    def applied(self, t: float, q: Array, v: Array, u: Array | None = None) -> Array:
        """Forces without those of the rows, shape (nv,)."""
        return self.force_and_energy(q)[0]

    def force_and_energy(self, q: Array) -> tuple[Array, float]:
        """Forces without those of the rows, shape (nv,), and the energy of the pairs alone."""
        self.evaluations += 1
        force = np.zeros(self.nv)
        for kind, x, f in zip(self.kinds, self.split(q), self.split(force), strict=True):
            kind.add_force(x, f)
        energy = 0.0
        if self.pairs is not None:
            energy = self.pairs.add_force(q.reshape(-1, 3), force.reshape(-1, 3))
        return force, energy

    def potential_of_molecules(self, q: Array) -> float:
        """Potential energy of fields and elastic terms."""
        parts = zip(self.kinds, self.split(q), strict=True)
        return sum(float(kind.energy(x).sum()) for kind, x in parts)

    def potential(self, q: Array) -> float:
        """Potential energy of fields, elastic terms and pairs."""
        own = self.potential_of_molecules(q)
        return own + (0.0 if self.pairs is None else self.force_and_energy(q)[1])

    def kinetic(self, v: Array) -> float:
        """Kinetic energy."""
        return 0.5 * float(v.dot(self._mass.dot(v)))

    def energy(self, y: State) -> float:
        """Kinetic and potential energy."""
        return self.kinetic(y.v) + self.potential(y.q)

    def mass(self, q: Array) -> ParticleMass:
        """The mass matrix as an operator."""
        return self._mass

    def factorise(self, t: float, q: Array) -> RowFactor:
        """Factor of the rows, dense; brings `condition` up to date."""
        factor = RowFactor(self._mass.dense, self.jacobian(t, q))
        self.condition = factor.condition
        return factor

    factor_at = factorise

    def accelerations(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Accelerations, shape (nv,), and multipliers, shape (m,)."""
        force = self.applied(0.0, q, v)
        lam = self.multipliers(q, v, force)
        return self._mass.solve(force + self.pushed(q, lam)), lam

    def evaluate(self, x: State, u: Array | None = None) -> Evaluation:
        """Accelerations, multipliers and the response to forces."""
        a, lam = self.accelerations(x.q, x.v)
        return Evaluation(x, a, NONE, lam, lambda force: self._respond(x.q, force))

    def _respond(self, q: Array, force: Array) -> Array:
        rest = np.zeros(self.nv)
        columns = force.reshape(self.nv, -1).T
        pushed = [f + self.pushed(q, self.multipliers(q, rest, f)) for f in columns]
        return self._mass.solve(np.array(pushed).T).reshape(force.shape)

    def accelerator(self, mode: Mode = ()) -> Accelerator:
        """The function of t, q, v, u that writes accelerations, shape (nv,)."""

        def accelerate(t: float, q: Array, v: Array, u: Array | None, out: Array) -> None:
            out[...] = self.accelerations(q, v)[0]

        return accelerate

    def projected(self, x: State) -> State:
        """The nearest state, in the mass metric, on the rows; one that is there stays as it is.

        Raises:
            SolveError: Rows cannot all hold near it; names the worst one.
        """
        q, v = x.q.copy(), x.v.copy()
        for kind, position, velocity in zip(self.kinds, *map(self.split, (q, v)), strict=True):
            for cluster in kind.clusters:
                cluster.assemble(position)
            kind.project(position, velocity)
        return x._replace(q=q, v=v)

    def expand(self, y: State) -> State:
        """The same state: all coordinates are integrated."""
        return y

    reduce = expand

    def lift(self, y: State, a: Array) -> Array:
        """The same accelerations."""
        return a

    def with_gains(self, kp: float, kd: float) -> ParticleSystem:
        """The same system: rows are kept by projection or by the method.

        Raises:
            ModelError: Gains other than 0.
        """
        return self

    def repeated(self, count: int) -> ParticleSystem:
        """As many independent copies side by side, such as chains of samples.

        Points of a kind follow one another copy by copy: a vector of the copies is that of each
        kind in turn, repeated. A system with pair forces has none.
        """
        from dataclasses import replace

        kinds = [replace(kind, count=count * kind.count) for kind in self.kinds]
        return ParticleSystem(kinds, None, self._force_unit, self.steps)


class PairForces(Protocol):
    """Forces between points of different molecules."""

    def add_force(self, x: Array, force: Array) -> float:
        """Adds forces at positions, both of shape (n, 3); returns their potential energy."""


class ParticleRows:
    """Rows of all molecules, kind by kind, molecule by molecule.

    Args:
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
            kind_rows = [row for cluster in kind.clusters for row in cluster.rows]
            directions = [row_of_kind.direction(x) for row_of_kind in kind_rows]
            for lane in range(kind.count):
                first = mine.start + 3 * len(kind.atoms) * lane
                for row_of_kind, D in zip(kind_rows, directions, strict=True):
                    for i, sign in row_of_kind.ends:
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


class ParticleMass:
    """The diagonal mass matrix of points; products and solutions cost as much as a vector.

    Args:
        diagonal: Mass of each coordinate, shape (nv,).
    """

    def __init__(self, diagonal: Array) -> None:
        self._diagonal = diagonal

    @property
    def dense(self) -> Array:
        """The matrix, for who can pay."""
        return np.diag(self._diagonal)

    def dot(self, v: Array) -> Array:
        """M v, shape as v."""
        product: Array = (self._diagonal * v.T).T
        return product

    def diagonal(self) -> Array:
        """Entries of the diagonal, shape (nv,)."""
        return self._diagonal

    def solve(self, force: Array) -> Array:
        """M^-1 force, shape as `force`, (nv,) or (nv, k)."""
        a: Array = (force.T / self._diagonal).T
        return a
