"""Order, cost and bounds of the unknowns of inverse dynamics."""

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.inverse.efforts import Efforts
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import Array

Mask = NDArray[np.bool_]


class Unknowns:
    """Efforts, multipliers of drives, then those of all other rows.

    A solver finds y = weight (x - target), whose norm is the cost.

    Args:
        efforts: The unknown inputs.
        constraints: The rows.
        is_drive: Which rows are drives, shape (m,).

    Attributes:
        labels: `<effort>.effort` and names of rows, shape (n,).
        place: Where each stands among efforts, then multipliers, shape (n,).
        efforts: How many come before the rows: inputs and drives.
        weight: Shape (n,), 1 but for inputs.
        target: Shape (n,), 0 but for inputs.
    """

    def __init__(self, efforts: Efforts, constraints: ConstraintRows, is_drive: Mask) -> None:
        na, m = len(efforts.names), len(constraints.rows)
        names = [*(f"{name}.effort" for name in efforts.names)]
        names += [row.name for row in constraints.rows]
        order = np.concatenate((np.zeros(na), np.where(is_drive, 1, 2)))
        self.place = np.argsort(order, kind="stable")
        self.efforts = na + int(is_drive.sum())
        self.labels = tuple(names[i] for i in self.place)
        self.weight = np.concatenate((efforts.weight, np.ones(m)))[self.place]
        self.target = np.concatenate((efforts.target, np.zeros(m)))[self.place]
        self._lower = efforts.lower, constraints.lower  # the latter change with the state
        self._upper = efforts.upper, constraints.upper

    def ends(self, asked: Mask) -> tuple[Array, Array]:
        """Least and largest y of those that are asked for, as the rows are limited now."""
        lower, upper = (
            self.weight * (np.concatenate(ends)[self.place] - self.target)
            for ends in (self._lower, self._upper)
        )
        return lower[asked], upper[asked]

    def filled(self, known: Array, asked: Mask, y: Array) -> Array:
        """Efforts, then multipliers, shape (na + m,).

        Args:
            known: Those that are not asked for, 0 elsewhere, shape (na + m,).
            asked: Which unknowns y has, shape (n,).
            y: Their values.
        """
        forces = known.copy()
        forces[self.place[asked]] = self.target[asked] + y / self.weight[asked]
        return forces

    def basis(self, asked: Mask, null: Array) -> Array:
        """Directions of y as those of efforts, then multipliers, shape (na + m, k)."""
        directions = np.zeros((len(self.place), null.shape[1]))
        directions[self.place[asked]] = null / self.weight[asked, None]
        return directions

    def named(self, asked: Mask, chosen: Mask) -> tuple[str, ...]:
        """Labels of some of those that are asked for, which `chosen` has one entry for."""
        return tuple(self.labels[i] for i in asked.nonzero()[0][chosen])
