"""What is sampled: configurations of many chains at once, their rows and their energy."""

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array

Marks = NDArray[np.bool_]


class Block(Protocol):
    """Rows that see some of the coordinates only, the same for every copy of a molecule.

    Attributes:
        coordinates: Which ones, shape (size, copies); None for all, one copy.
        copies: How many.
        rows: Names of the rows of one copy, m of them.
    """

    @property
    def coordinates(self) -> Any:
        """See the attributes of the class."""

    @property
    def copies(self) -> int:
        """See there."""

    @property
    def rows(self) -> Sequence[str]:
        """See there."""

    def residual(self, x: Array) -> Array:
        """g, shape (m, n).

        Args:
            x: Coordinates of the block, shape (size, n); n counts copies and chains.
        """

    def jacobian(self, x: Array) -> Array:
        """dg/dx, shape (m, size, n)."""


class Space(Protocol):
    """Configurations q of shape (size, chains), with constant masses.

    Attributes:
        names: Of the coordinates.
        size: How many.
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
            q: Configurations.
            fixman: Whether rows are the limit of stiff springs.
        """
