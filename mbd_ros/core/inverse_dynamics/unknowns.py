"""Order, cost and bounds of the unknowns of inverse dynamics."""

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.inverse_dynamics.bounded_split import Wish
from mbd_ros.core.inverse_dynamics.efforts import Efforts
from mbd_ros.core.optimization.cone_limits import Limits
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
        with_bounds: Whether efforts and drives keep their bounds.

    Attributes:
        labels: `<effort>.effort` and names of rows, shape (n,).
        place: Where each stands among efforts, then multipliers, shape (n,).
        efforts: How many come before the rows: inputs and drives.
        weight: Shape (n,), 1 but for inputs.
        target: Shape (n,), 0 but for inputs.
    """

    def __init__(
        self,
        efforts: Efforts,
        constraints: ConstraintRows,
        is_drive: Mask,
        *,
        with_bounds: bool = True,
    ) -> None:
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
        self._bounded = slice(None if with_bounds else self.efforts, None)
        found = np.argsort(self.place)[na:]
        slots = [found[cone.slots] for cone in constraints.cones]
        self._cones = np.array(slots, dtype=np.intp).reshape(-1, 3)
        self._mu = np.array([cone.mu for cone in constraints.cones])

    def limits(self, asked: Mask) -> Limits:
        """Bounds and cones of the y of those that are asked for, as the rows are limited now."""
        n, mine = len(self.place), self._bounded
        lower, upper = np.full(n, -np.inf), np.full(n, np.inf)
        for ends, of in ((lower, self._lower), (upper, self._upper)):
            whole = self.weight * (np.concatenate(of)[self.place] - self.target)
            ends[mine] = whole[mine]
        stands = asked[self._cones[:, 0]] if len(self._cones) else np.zeros(0, np.bool_)
        at = np.cumsum(asked) - 1
        cones = at[self._cones[stands]].reshape(-1, 3)
        return Limits(lower[asked], upper[asked], cones, self._mu[stands])

    @property
    def of_contacts(self) -> Mask:
        """Which are forces of contacts, shape (n,)."""
        are = np.zeros(len(self.place), np.bool_)
        are[self._cones.ravel()] = True
        return are

    def wished(self, asked: Mask, wish: Wish) -> Wish:
        """A wish of the forces of all contacts as one of those that are asked for."""
        S = np.zeros((len(wish.S), len(self.place)))
        S[:, self._cones.ravel()] = wish.S
        return Wish(S[:, asked], wish.target)

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
