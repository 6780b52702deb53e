"""Points without mass that carry charges: weighted means of the atoms of their molecule.

x_s = sum_i w_i x_i,   f_i += w_i f_s
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array


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
    """All sites of a scene; they follow the atoms, group by group, molecule by molecule.

    Args:
        groups: The groups.
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
