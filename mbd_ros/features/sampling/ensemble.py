"""The canonical ensemble of a space: Langevin and Metropolis steps."""

from __future__ import annotations

from math import exp, sqrt
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import redundant
from mbd_ros.errors import DivergedError
from mbd_ros.features.sampling.space import Block, Marks, Space, inverse, log_determinant, solve

_CLOSED = 1.0e-13  # of the scale: distance from the rows at which a step ends
_KEPT = 1.0e-11  # of the scale: what rounding may leave open far from the origin
_MOST = 12  # corrections of a step
_APART = 1.0e-5  # of the scale: steps of differences of Jacobians
_BACK = 1.0e-8  # of the scale: how near a step back has to come
_VARIED = 0.2  # of the step, so that no motion comes back to its start


class Ensemble:
    """exp(-H / kT) of configurations that keep rows and of velocities along them.

    Args:
        kT: Thermal energy, in the unit of its energies, > 0.
        fixman: Whether 1/2 kT ln det J M^-1 J' is added to the potential: configurations are then
            those of very stiff springs in place of the rows. Source: M. Fixman, PNAS 71, 1974,
            3050.
    """

    def __init__(self, space: Space, kT: float, *, fixman: bool = False) -> None:
        self.space = space
        self.kT = kT
        self.fixman = fixman
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

    def draw_velocities(
        self, random: np.random.Generator, places: list[Place], chains: int
    ) -> Array:
        """Draw random velocities along the constraints, shape (size, chains)."""
        v = self._spread * random.standard_normal((self.space.size, chains))
        return self.manifold.project(places, v)

    def at(self, q: Array, v: Array) -> Walkers:
        """Return states of chains, whose velocities are along the constraints already."""
        places = self.manifold.at(q)
        is_closed = np.ones(q.shape[1], dtype=np.bool_)
        return Walkers(q, v, places, self.force(q, places), is_closed)

    def kick(self, at: Walkers, h: float) -> Walkers:
        """Apply forces for a time h; velocities stay along the constraints."""
        v = self.manifold.project(at.places, at.v + (h / self._mass) * at.force)
        return at._replace(v=v)

    def move(self, at: Walkers, h: float) -> Walkers:
        """Move along the constraints without forces, to q + h v - D s, which closes them."""
        q, is_closed = self.manifold.close(at.places, at.q + h * at.v)
        places, v = self.manifold.at(q), (q - at.q) / h
        return Walkers(
            q, self.manifold.project(places, v), places, at.force, at.is_closed & is_closed
        )

    def step(self, at: Walkers, h: float) -> tuple[Walkers, Array]:
        """Take a step of RATTLE; also return the velocity before the last projection (SHAKE).

        Source: H. C. Andersen, J. Comput. Phys. 52, 1983, 24.
        """
        q, is_closed = self.manifold.close(
            at.places, at.q + h * (at.v + (0.5 * h / self._mass) * at.force)
        )
        places = self.manifold.at(q)
        force = self.force(q, places)
        v = (q - at.q) / h + (0.5 * h / self._mass) * force
        now = Walkers(q, self.manifold.project(places, v), places, force, at.is_closed & is_closed)
        return now, v


class Place(NamedTuple):
    """Constraint rows at configurations.

    Attributes:
        J: Jacobian, shape (m, size, n).
        D: M^-1 J', as (m, size, n).
        A: J M^-1 J', shape (m, m, n).
    """

    J: Array
    D: Array
    A: Array


class Metropolis:
    """Hybrid Monte Carlo: new velocities, some steps of RATTLE, and a Metropolis decision.

    A step counts only if the step back leads to its start. The equations of the multipliers may
    have several solutions, and one that the step back does not find would bias the samples.

    Sources: E. Zappa, M. Holmes-Cerfon, J. Goodman, Comm. Pure Appl. Math. 71, 2018, 2609;
    T. Lelievre, M. Rousset, G. Stoltz, Numer. Math. 143, 2019, 379.
    """

    def __init__(self, ensemble: Ensemble, dt: float) -> None:
        self._ensemble = ensemble
        self.dt = dt

    def sweep(self, at: Walkers, random: np.random.Generator, steps: int) -> tuple[Walkers, Marks]:
        """Make one proposal for every chain.

        Args:
            at: States of the chains.
            random: Random numbers of this sweep.
            steps: Steps of RATTLE.

        Returns:
            States with new velocities, and whether proposals were accepted, shape (chains,).
        """
        ensemble, chains = self._ensemble, at.q.shape[1]
        h = self.dt * random.uniform(1.0 - _VARIED, 1.0 + _VARIED)
        at = at._replace(v=ensemble.draw_velocities(random, at.places, chains))
        chosen = random.random(chains)
        there = at._replace(is_closed=np.ones(chains, dtype=np.bool_))
        with np.errstate(all="ignore"):
            before = self._total(at)
            for _ in range(steps):
                there = self._reversible_step(there, h)
            rise = self._total(there) - before
            accepted: Marks = there.is_closed & (
                chosen < np.exp(np.minimum(-rise / ensemble.kT, 0.0))
            )
        return _chosen(accepted, there, at), accepted

    def _total(self, at: Walkers) -> Array:
        total: Array = self._ensemble.energy(at.q, at.places) + self._ensemble.kinetic(at.v)
        return total

    def _reversible_step(self, at: Walkers, h: float) -> Walkers:
        ensemble = self._ensemble
        there, _ = ensemble.step(at, h)
        if not ensemble.manifold.parts:
            return there
        back = there.q - h * (there.v - (0.5 * h / ensemble.space.mass[:, None]) * there.force)
        back, is_closed = ensemble.manifold.close(there.places, back)
        near = np.abs(back - at.q).max(axis=0) <= _BACK * ensemble.space.scale
        return there._replace(is_closed=there.is_closed & is_closed & near)


def _chosen(is_taken: Marks, there: Walkers, here: Walkers) -> Walkers:
    """Return the states of `there` for chosen chains, those of `here` for the others."""
    places = [
        type(a)(*(_where(is_taken, *pair) for pair in zip(a, b, strict=True)))
        for a, b in zip(there.places, here.places, strict=True)
    ]
    q, v, force = (
        np.where(is_taken, a, b)
        for a, b in ((there.q, here.q), (there.v, here.v), (there.force, here.force))
    )
    return Walkers(q, v, places, force, np.ones(len(is_taken), dtype=np.bool_))


def _where(is_taken: Marks, there: Array, here: Array) -> Array:
    copies = there.shape[-1] // len(is_taken)
    return np.where(np.tile(is_taken, copies), there, here)


class Langevin:
    """Langevin dynamics by the splitting g-BAOAB: kick, move, friction and noise, move, kick.

    Configurations have an error of second order in dt; velocities of every step are along the
    constraints.

    Source: B. Leimkuhler, C. Matthews, Proc. R. Soc. A 472, 2016, 20160138.

    Args:
        ensemble: The ensemble; masses of its space are constant.
        dt: Step.
        friction: Rate at which velocities are damped, >= 0.
    """

    def __init__(self, ensemble: Ensemble, dt: float, friction: float) -> None:
        self._ensemble = ensemble
        self.dt = dt
        self._decay = exp(-friction * dt)
        self._noise = sqrt(1.0 - self._decay**2)

    def sweep(self, at: Walkers, random: np.random.Generator, steps: int) -> tuple[Walkers, Marks]:
        """Take some steps.

        Args:
            at: States of the chains.
            random: Random numbers of this sweep.
            steps: Number of steps.

        Returns:
            States, and True for every chain, shape (chains,).

        Raises:
            DivergedError: A step does not end on the constraints.
        """
        ensemble, h = self._ensemble, self.dt
        for _ in range(steps):
            at = ensemble.move(ensemble.kick(at, 0.5 * h), 0.5 * h)
            noise = ensemble.draw_velocities(random, at.places, at.q.shape[1])
            at = ensemble.move(at._replace(v=self._decay * at.v + self._noise * noise), 0.5 * h)
            at = at._replace(force=ensemble.force(at.q, at.places))
            at = ensemble.kick(at, 0.5 * h)
            if not at.is_closed.all():
                raise DivergedError(
                    f"langevin: no step of {h:g} ends on the constraints in "
                    f"{(~at.is_closed).sum()} of {at.is_closed.size} chains; "
                    "try a smaller dt, or the method metropolis"
                )
        return at, at.is_closed


class Walkers(NamedTuple):
    """States of chains, with constraint rows and forces there.

    Attributes:
        q: Configurations, shape (size, chains).
        v: Velocities with J v = 0.
        places: Constraint rows at q.
        force: Forces on the coordinates at q.
        is_closed: Whether the step of a chain has ended on the constraints, shape (chains,).
    """

    q: Array
    v: Array
    places: list[Place]
    force: Array
    is_closed: Marks


class Manifold:
    """All configurations of a space that keep its rows."""

    def __init__(self, space: Space) -> None:
        self.space = space
        self.parts = [BlockRows(block, space.mass, space.scale) for block in space.blocks]

    def at(self, q: Array) -> list[Place]:
        """Rows of all blocks at configurations, shape (size, chains)."""
        return [part.at(part.of(q)) for part in self.parts]

    def project(self, places: list[Place], v: Array) -> Array:
        """The nearest velocities with J v = 0, shape as v."""
        for part, place in zip(self.parts, places, strict=True):
            v = part.put(v, part.project(place, part.of(v)))
        return v

    def close(self, places: list[Place], q: Array) -> tuple[Array, Marks]:
        """Configurations on the rows from those near them, and which were found, (chains,)."""
        is_closed: Marks = np.asarray(np.isfinite(q).all(axis=0))
        for part, place in zip(self.parts, places, strict=True):
            x, well = part.close(place, part.of(q))
            q = part.put(q, x)
            is_closed = is_closed & well.reshape(part.block.copies, -1).all(axis=0)
        return q, is_closed

    def log_gram(self, places: list[Place]) -> Array:
        """Logarithm of det J M^-1 J', the sum of all blocks, shape (chains,)."""
        total = np.zeros(1)
        for part, place in zip(self.parts, places, strict=True):
            total = total + log_determinant(place.A).reshape(part.block.copies, -1).sum(axis=0)
        return total

    def log_gradient(self, places: list[Place], q: Array) -> Array:
        """Gradient of 1/2 ln det J M^-1 J', shape (size, chains)."""
        total = np.zeros(q.shape)
        for part, place in zip(self.parts, places, strict=True):
            total = part.put(total, part.log_gradient(place, part.of(q)))
        return total


class BlockRows:
    """The rows of a block in the metric of masses.

    Args:
        mass: Masses of all coordinates, shape (size of the space,).
        scale: A usual length.
    """

    def __init__(self, block: Block, mass: Array, scale: float) -> None:
        self.block = block
        self._scale = scale
        mine = mass[:, None] if block.coordinates is None else mass[block.coordinates]
        self._lightness = 1.0 / mine[:, :, None]  # (size, copies, 1)

    def of(self, q: Array) -> Array:
        """The coordinates of the block, shape (size, copies * chains)."""
        at = self.block.coordinates
        return q if at is None else q[at].reshape(len(at), -1)

    def put(self, q: Array, x: Array) -> Array:
        """Configurations with other coordinates in the block."""
        at = self.block.coordinates
        if at is None:
            return x
        q = q.copy()
        q[at] = x.reshape(*at.shape, -1)
        return q

    def at(self, x: Array) -> Place:
        """Rows at coordinates of the block."""
        J = self.block.jacobian(x)
        by_copy = J.reshape(*J.shape[:2], self.block.copies, -1)
        D = (by_copy * self._lightness).reshape(J.shape)
        return Place(J, D, np.einsum("aib,cib->acb", J, D))

    def project(self, place: Place, v: Array) -> Array:
        """The nearest velocity in the metric of masses with J v = 0."""
        s = solve(place.A, np.einsum("aib,ib->ab", place.J, v))
        nearest: Array = v - np.einsum("aib,ab->ib", place.D, s)
        return nearest

    def close(self, place: Place, x: Array) -> tuple[Array, Marks]:
        """The configurations x - D s on the rows, and which were found, shape (n,).

        Args:
            place: Rows in whose directions D x is moved.
            x: Coordinates off the rows.
        """
        size = np.sqrt(np.einsum("aib,aib->ab", place.J, place.J))
        x, is_closed = x.copy(), np.zeros(x.shape[1], dtype=np.bool_)
        left, D, at = np.arange(x.shape[1]), place.D, x
        last = np.full(len(left), np.inf)
        with np.errstate(all="ignore"):
            for _ in range(_MOST):
                g = self.block.residual(at)
                off = np.abs(g / size).max(axis=0)
                is_there = off <= _CLOSED * self._scale
                is_there |= (off <= _KEPT * self._scale) & (off >= 0.5 * last)
                goes_on = ~is_there & np.isfinite(off)
                if not goes_on.all():
                    x[:, left], is_closed[left] = at, is_there
                    left, at, D, g = left[goes_on], at[:, goes_on], D[:, :, goes_on], g[:, goes_on]
                    size, off = size[:, goes_on], off[goes_on]
                    if not len(left):
                        break
                slope = np.einsum("aib,cib->acb", self.block.jacobian(at), D)
                at, last = at - np.einsum("aib,ab->ib", D, solve(slope, g)), off
        return x, is_closed

    def log_gradient(self, place: Place, x: Array) -> Array:
        """Gradient of 1/2 ln det A: the sum over rows a of H_a (A^-1 D)_a, shape (size, n)."""
        W = np.einsum("acb,cib->aib", inverse(place.A), place.D)
        total = np.zeros(x.shape)
        for a, w in enumerate(W):
            total += self.jacobian_rate(x, w)[a]
        return total

    def jacobian_rate(self, x: Array, w: Array) -> Array:
        """Change of the Jacobian along w: H_a w of every row a, shape (m, size, n)."""
        long = np.sqrt((w * w).sum(axis=0))
        step = _APART * self._scale / np.where(long > 0.0, long, 1.0)
        ahead, behind = self.block.jacobian(x + step * w), self.block.jacobian(x - step * w)
        change: Array = (ahead - behind) / (2.0 * step)
        return change


def degrees_of_freedom(space: Space, q: Array, conserved: int = 0) -> int:
    """Number of coordinates less the rank of the rows and what else is conserved.

    Args:
        q: A configuration, shape (size,).
        conserved: Momenta that nothing changes: 3 where the centre of mass keeps its velocity.
    """
    rank = 0
    for block in space.blocks:
        at = block.coordinates
        x = q[:, None] if at is None else q[at]
        mass = space.mass[:, None] if at is None else space.mass[at]
        J = np.moveaxis(block.jacobian(x) / np.sqrt(mass), 2, 0)
        sizes = np.linalg.svd(J, compute_uv=False)
        least = np.sqrt(redundant(sizes.shape[1])) * sizes[:, :1]
        rank += int(np.count_nonzero(sizes > least))
    return space.size - rank - conserved


def kinetic_after_step(ensemble: Ensemble, at: Walkers, h: float) -> Array:
    """Kinetic energy after a step, as RATTLE and as SHAKE leave it, shape (2, chains).

    SHAKE's velocities keep a part normal to the rows, -h/2 M^-1 J' lam, which carries the energy
    h^2/8 f . M^-1 f, f = J' lam.

    Args:
        at: States before the step.
    """
    after, unprojected = ensemble.step(at, h)
    return np.array([ensemble.kinetic(after.v), ensemble.kinetic(unprojected)])


def stream(seed: int, number: int, index: int) -> np.random.Generator:
    """The generator of one index of one stream; what was drawn before does not matter.

    Args:
        seed: >= 0.
        number: Of the stream, as that of a block of chains.
        index: In the stream, as that of a sweep.
    """
    key = np.array([seed, number], dtype=np.uint64)
    counter = np.array([0, 0, 0, index], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key, counter=counter))
