"""What is sampled: configurations of many chains at once, their rows and their energy."""

from collections.abc import Sequence
from typing import Protocol

from mbd_ros.core.state import Array


class Block(Protocol):
    """Rows that see some of the coordinates only, the same for every copy of a molecule.

    Attributes:
        coordinates: Which ones, shape (size, copies); None for all, one copy.
        copies: How many.
        rows: Names of the rows of one copy, m of them.
    """

    coordinates: Array | None
    copies: int
    rows: Sequence[str]

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
    blocks: Sequence[Block]
    scale: float
    has_constant_masses: bool

    def potential(self, q: Array) -> Array:
        """Potential energy, infinite where a configuration is forbidden, shape (chains,)."""

    def force(self, q: Array) -> Array:
        """-dV/dq, shape (size, chains)."""

    def volume(self, q: Array, *, fixman: bool) -> Array:
        """ln of the density at V = 0, against that which `mass` would give, shape (chains,).

        Args:
            q: Configurations.
            fixman: Whether rows are the limit of stiff springs.
        """
