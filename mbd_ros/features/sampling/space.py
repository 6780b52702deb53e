"""The sampled space: configurations of many chains at once, their rows and their energy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.features.sampling.observables import Observable

Marks = NDArray[np.bool_]
_APART = 1.0e-5  # of the scale: steps of differences of a potential
_LOOPED = 4  # rows up to which a loop over them costs less than a call a matrix


class Space(Protocol):
    """Configurations q of shape (size, chains), with constant masses.

    Attributes:
        names: Of the coordinates.
        mass: Of the velocities that are drawn, shape (size,).
        blocks: Rows that all configurations keep, in blocks that share no coordinate.
        scale: A length that is usual, in the unit of the coordinates.
        has_constant_masses: Whether `mass` is that of the kinetic energy; else `volume` says how
            the density of configurations differs.
    """

    names: Sequence[str]
    size: int
    mass: Array
    blocks: Any
    scale: float
    has_constant_masses: bool

    def potential(self, q: Array) -> Array:
        """Potential energy, infinite where a configuration is forbidden, shape (chains,)."""

    def force(self, q: Array) -> Array:
        """-dV/dq, shape (size, chains)."""

    def volume(self, q: Array, *, fixman: bool) -> Array:
        """Logarithm of the density at V = 0, relative to that of `mass`, shape (chains,).

        Args:
            fixman: Whether rows are the limit of stiff springs.
        """


class Block(Protocol):
    """Rows that see some of the coordinates only, the same for every copy of a molecule."""

    @property
    def coordinates(self) -> NDArray[np.intp] | None:
        """Numbers of its coordinates, shape (size, copies); None for all, one copy."""

    @property
    def copies(self) -> int:
        """How many copies there are."""

    @property
    def rows(self) -> Sequence[str]:
        """Names of the rows of one copy, m of them."""

    def residual(self, x: Array) -> Array:
        """g, shape (m, n).

        Args:
            x: Coordinates of the block, shape (size, n); n counts copies and chains.
        """

    def jacobian(self, x: Array) -> Array:
        """dg/dx, shape (m, size, n)."""


class FixedCoordinateSpace:
    """A `Space` with one more constraint, which fixes a coordinate.

    Args:
        space: The space, with constant masses.
        coordinate: The coordinate.
        level: Value of the coordinate.
    """

    has_constant_masses = True

    def __init__(self, space: Space, coordinate: Observable, level: float) -> None:
        self.names = space.names
        self.size = space.size
        self.mass = space.mass
        self.scale = space.scale
        self.potential = space.potential
        self.force = space.force
        self.volume = space.volume
        self.blocks = (FixedCoordinateRows(space, coordinate, level),)


class FixedCoordinateRows:
    """All constraint rows of a space and, last, that of the fixed coordinate.

    Attributes:
        coordinates: None, for all coordinates.
        copies: 1.
    """

    coordinates = None
    copies = 1

    def __init__(self, space: Space, coordinate: Observable, level: float) -> None:
        self._blocks = space.blocks
        self._coordinate = coordinate
        self.level = level
        names = [row for block in space.blocks for _ in range(block.copies) for row in block.rows]
        self.rows: Sequence[str] = (*names, coordinate.name)

    def residual(self, x: Array) -> Array:
        """g, shape (m, n)."""
        parts = []
        for block in self._blocks:
            at, n = block.coordinates, x.shape[1]
            g = block.residual(x if at is None else x[at].reshape(len(at), -1))
            parts.append(g.reshape(-1, n))
        return np.vstack((*parts, self._coordinate.value(x) - self.level))

    def jacobian(self, x: Array) -> Array:
        """dg/dx, shape (m, size, n)."""
        size, n, first = *x.shape, 0
        J = np.zeros((len(self.rows), size, n))
        for block in self._blocks:
            at, m = block.coordinates, len(block.rows)
            if at is None:
                J[first : first + m] = block.jacobian(x)
            else:
                copies = block.jacobian(x[at].reshape(len(at), -1))
                copies = copies.reshape(m, len(at), block.copies, n)
                for copy in range(block.copies):
                    rows = first + copy + block.copies * np.arange(m)
                    J[rows[:, None], at[None, :, copy]] = copies[:, :, copy]
            first += m * block.copies
        J[-1] = self._coordinate.gradient(x)
        return J


class WeightedSpace:
    """A `Space` with the potential V - kT ln(density).

    With the constant masses its configurations have the density that they have with those of the
    kinetic energy, so that what holds for constant masses holds for it.

    Args:
        space: The space, without walls.
        kT: Thermal energy, in the unit of its energies.
        fixman: Whether rows are the limit of stiff springs.
    """

    has_constant_masses = True

    def __init__(self, space: Space, kT: float, *, fixman: bool) -> None:
        self._space = space
        self._kT = kT
        self._fixman = fixman
        self.names = space.names
        self.size = space.size
        self.mass = space.mass
        self.scale = space.scale
        self.blocks = space.blocks
        self.force = space.force

    def potential(self, q: Array) -> Array:
        """V - kT ln(density), shape (chains,)."""
        space = self._space
        return space.potential(q) - self._kT * space.volume(q, fixman=self._fixman)

    def gradient(self, q: Array) -> Array:
        """Gradient of `potential` by central differences, shape (size, chains).

        `force` omits the density, since it only guides steps that are accepted or rejected.
        """
        slopes, h = np.empty(q.shape), _APART * self.scale
        for i in range(self.size):
            ahead, behind = q.copy(), q.copy()
            ahead[i] += h
            behind[i] -= h
            slopes[i] = (self.potential(ahead) - self.potential(behind)) / (2.0 * h)
        return slopes

    def volume(self, q: Array, *, fixman: bool) -> Array:
        """0: nothing is left for it, shape (chains,)."""
        return np.zeros(q.shape[1])


def solve(A: Array, b: Array) -> Array:
    """A^-1 b by elimination without exchange of rows; not finite where a pivot is 0.

    The matrices here are Gram matrices of rows or near them, for which that is stable.

    Args:
        A: Shape (m, m, n).
        b: Shape (m, n) or (m, k, n).

    Returns:
        Shape as `b`.
    """
    m = len(A)
    if m > _LOOPED:
        try:
            if b.ndim == 2:
                one: Array = np.linalg.solve(A.transpose(2, 0, 1), b.T[:, :, None])[:, :, 0].T
                return one
            many: Array = np.linalg.solve(A.transpose(2, 0, 1), b.transpose(2, 0, 1))
            return many.transpose(1, 2, 0)
        except np.linalg.LinAlgError:  # one of them is singular: the others count
            pass
    A, x = A.copy(), b.copy()
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for i in range(m):
            for j in range(i + 1, m):
                share = A[j, i] / A[i, i]
                A[j, i + 1 :] -= share * A[i, i + 1 :]
                x[j] -= share * x[i]
        for i in reversed(range(m)):
            for j in range(i + 1, m):
                x[i] -= A[i, j] * x[j]
            x[i] /= A[i, i]
    return x


def log_determinant(A: Array) -> Array:
    """Logarithms of determinants of symmetric matrices, shape (n,); -inf where det A <= 0.

    Args:
        A: Shape (m, m, n).
    """
    m = len(A)
    if m > _LOOPED:
        sign, size = np.linalg.slogdet(A.transpose(2, 0, 1))
        return np.where(sign > 0.0, size, -np.inf)
    A, total = A.copy(), np.zeros(A.shape[2])
    with np.errstate(divide="ignore", invalid="ignore"):
        for i in range(m):
            for j in range(i + 1, m):
                A[j, i + 1 :] -= A[j, i] / A[i, i] * A[i, i + 1 :]
            total += np.log(np.maximum(A[i, i], 0.0))
    return np.where(np.isnan(total), -np.inf, total)


def inverse(A: Array) -> Array:
    """A^-1, shape (m, m, n), of matrices as for `solve`."""
    unit = np.zeros(A.shape)
    unit[np.arange(len(A)), np.arange(len(A))] = 1.0
    return solve(A, unit)
