"""A mechanism as what is sampled: the coordinates that a tier integrates, and its loops."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.rows.constraint_rows import independent
from mbd_ros.core.state import NONE, Array, State

_SCALE = 1.0  # rad or m
Wall = Callable[[State], bool]  # whether a state of all joints is within


class JointSpace:
    """Coordinates of a mechanism, a `Space`.

    The kinetic energy has the mass matrix M(q); velocities are drawn with the constant masses on
    the diagonal of M at the start, and `volume` makes up for the difference.

    Args:
        system: The system: no free bodies, no internal states, rows of positions alone.
        start: A state of what it integrates, on the rows.
        walls: Conditions that every configuration meets, as one-sided stops.

    Attributes:
        names: Of the coordinates.
        mass: Of the velocities that are drawn.
        blocks: The loops, one block.
        scale: 1 rad or m.
    """

    has_constant_masses = False

    def __init__(
        self, system: System, start: State, names: Sequence[str], walls: Sequence[Wall] = ()
    ) -> None:
        self.system = system
        self.names = tuple(names)
        self.size = system.nv
        self._walls = tuple(walls)
        self.scale = _SCALE
        self._still = np.zeros(system.nv)
        self.mass: Array = system.mass(start.q).diagonal().copy()
        rows = independent(system.jacobian(0.0, start.q)) if system.rows else []
        self.blocks: tuple[Any, ...] = (JointRows(system, rows),) if rows else ()

    def potential(self, q: Array) -> Array:
        """Potential energy [J], infinite beyond a wall, shape (chains,)."""
        return np.array([self._energy(one) for one in np.ascontiguousarray(q.T)])

    def force(self, q: Array) -> Array:
        """Forces of a mechanism at rest, shape (size, chains)."""
        still, applied = self._still, self.system.applied
        each = [applied(0.0, one, still) for one in np.ascontiguousarray(q.T)]
        return np.array(each).T

    def volume(self, q: Array, *, fixman: bool) -> Array:
        """1/2 ln det M + 1/2 ln det J M^-1 J' - 1/2 ln det J m^-1 J', shape (chains,).

        The second term is left out with Fixman's potential.
        """
        return np.array([self._volume(one, fixman) for one in np.ascontiguousarray(q.T)])

    def velocities(self, q: Array, drawn: Array) -> Array:
        """Velocities of the mechanism, with its own masses, from those that are drawn.

        Both are normal along the loops; in a basis of each they have the same coefficients.

        Args:
            q: Configurations, shape (size, chains).
            drawn: Velocities drawn with `mass`, shape (size, chains).
        """
        pairs = zip(np.ascontiguousarray(q.T), drawn.T, strict=True)
        return np.array([self._velocity(one, v) for one, v in pairs]).T

    def _velocity(self, q: Array, drawn: Array) -> Array:
        along = np.eye(self.size)
        for block in self.blocks:
            J = block.jacobian(q[:, None])[:, :, 0]
            along = np.linalg.qr(J.T, mode="complete")[0][:, len(J) :]
        light = np.linalg.cholesky((along.T * self.mass).dot(along))
        heavy = np.linalg.cholesky(along.T.dot(self.system.mass(q).dense).dot(along))
        normal = np.linalg.solve(light, (along.T * self.mass).dot(drawn))
        velocity: Array = along.dot(np.linalg.solve(heavy.T, normal))
        return velocity

    def _energy(self, q: Array) -> float:
        if not np.isfinite(q).all():
            return np.inf
        y = State(0.0, q, self._still, NONE)
        if self._walls:
            x = self.system.expand(y)
            if not all(is_within(x) for is_within in self._walls):
                return np.inf
        return self.system.energy(y)

    def _volume(self, q: Array, fixman: bool) -> float:
        if not np.isfinite(q).all():
            return -np.inf
        mass = self.system.mass(q)
        volume = float(np.linalg.slogdet(mass.dense)[1])
        for block in self.blocks:
            J = block.jacobian(q[:, None])[:, :, 0]
            volume -= float(np.linalg.slogdet((J / self.mass).dot(J.T))[1])
            if not fixman:
                volume += float(np.linalg.slogdet(J.dot(mass.solve(J.T)))[1])
        return 0.5 * volume


class JointRows:
    """Constraint rows of the loops of a mechanism.

    Attributes:
        coordinates: None, for all coordinates.
        copies: 1.
    """

    coordinates = None
    copies = 1

    def __init__(self, system: System, independent: Sequence[int]) -> None:
        self._system = system
        self._independent = list(independent)
        self.rows = tuple(system.rows[i].name for i in independent)

    def residual(self, x: Array) -> Array:
        """g, shape (m, n)."""
        independent, residual = self._independent, self._system.residual
        return np.array([residual(0.0, q)[independent] for q in np.ascontiguousarray(x.T)]).T

    def jacobian(self, x: Array) -> Array:
        """dg/dx, shape (m, size, n)."""
        independent, jacobian = self._independent, self._system.jacobian
        each = [jacobian(0.0, q)[independent] for q in np.ascontiguousarray(x.T)]
        return np.moveaxis(np.array(each), 0, 2)
