"""Rows that give way, as far as they may act in a step."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.dynamics.impulse_response import ImpulseResponse
from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.kinematics.kinematics import Reads
from mbd_ros.core.multiplier_laws import Kind
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.rows.row_layout import Cone
from mbd_ros.core.state import Array, State

Which = NDArray[np.bool_]
Slots = NDArray[np.intp]


class Acting(NamedTuple):
    """Rows that may act in a step.

    Attributes:
        at: Where they stand among all rows that give way, shape (m,).
        names: One a row.
        pushes: Which are one-sided, normals of contacts among them, shape (m,).
        decides: Which row says whether it acts: of a contact its normal, else itself.
        cones: The contacts, their slots counted here.
        tangents: Their rows along tangents, shape (2 n,).
    """

    at: NDArray[np.intp]
    names: list[str]
    pushes: Which
    decides: NDArray[np.intp]
    cones: tuple[Cone, ...]
    tangents: NDArray[np.intp]

    def chosen(self, on: NDArray[np.intp]) -> "Acting":
        """Some of them; of a contact all rows or none.

        Args:
            on: Their places here, in the order that is wanted.
        """
        own = np.full(len(self.at), -1, dtype=np.intp)
        own[on] = np.arange(len(on))
        starts = [(cone, int(own[cone.slots.start])) for cone in self.cones]
        cones = (c._replace(slots=slice(start, start + 3)) for c, start in starts if start >= 0)
        names = [self.names[i] for i in on.tolist()]
        return _acting(self.at[on], names, self.pushes[on], tuple(cones))


class RowsAt(NamedTuple):
    """Rows at one state.

    Attributes:
        acting: Which they are.
        J: Their Jacobian, shape (m, nv).
        drift: Their J' v, shape (m,).
        gap: Their g, shape (m,).
        own: Their g' without J v, shape (m,).
    """

    acting: Acting
    J: Array
    drift: Array
    gap: Array
    own: Array


def every(rows: ConstraintRows) -> Acting:
    """All rows that give way."""
    pushes = np.zeros(len(rows.rows), dtype=np.bool_)
    for block, mine in zip(rows.blocks, rows.slices, strict=True):
        pushes[mine] = block.law.kind is Kind.UNILATERAL
    for cone in rows.cones:
        pushes[cone.slots.start] = True
    return _acting(np.arange(len(pushes)), [row.name for row in rows.rows], pushes, rows.cones)


def _acting(
    at: NDArray[np.intp], names: list[str], pushes: Which, cones: tuple[Cone, ...]
) -> Acting:
    decides = np.arange(len(at))
    for cone in cones:
        decides[cone.slots] = cone.slots.start
    tangents = np.flatnonzero(decides != np.arange(len(at)))
    return Acting(at, names, pushes, decides, cones, tangents)


class StepRows:
    """All rows that give way, in every step.

    Args:
        mechanism: The mechanism.
        rows: The rows.

    Attributes:
        rows: As given.
        every: All of them.
        are_one_sided: Whether any row only pushes.
    """

    def __init__(self, mechanism: Mechanism, rows: ConstraintRows) -> None:
        self._k, self.rows, self.every = mechanism.k, rows, every(rows)
        self.are_one_sided = bool(self.every.pushes.any())
        self._of_g, self._of_J = (
            min(rows.reads, reads) for reads in (Reads.POSITION, Reads.JACOBIAN)
        )

    def turning(self, v: Array) -> float:
        """How fast bodies beside contacts turn with a velocity of all joints [rad/s]."""
        return 0.0

    def begin(self, q: Array) -> None:
        """Learn from which configuration of what is integrated a step starts."""

    def moved(self, q: Array, way: Array) -> None:
        """Learn to which configuration all joints moved, and how far, shape (nv,)."""

    def at(self, x: State, free: Array, h: float) -> RowsAt:
        """The rows at a state of all joints, with bounds that are those of it.

        Args:
            x: The state, on the way of a step.
            free: Velocity at its end without the rows, shape (nv,).
            h: Its length [s].
        """
        k, rows = self._k, self.rows
        k.refresh(x.q, x.v, rows.reads)
        if rows.varies:
            rows.limit(k, x)
        J, drift = (each.copy() for each in rows.accelerations(k, x))
        return RowsAt(self.every, J, drift, rows.residual(k, x), rows.rate(k, x))

    def gaps(self, x: State) -> Array | None:
        """The g of one-sided rows at a state of all joints, shape (m,); inf for other rows.

        Returns:
            None where no row may be beyond 0.
        """
        self._k.refresh(x.q, x.v, self._of_g)
        return np.where(self.every.pushes, self.rows.residual(self._k, x), np.inf)

    def response(self, held: ImpulseResponse, K: Array, J: Array) -> ImpulseResponse:
        """How impulses of the rows move the joints.

        Args:
            held: What moves them, for other rows.
            K: Its mass matrix, shape (nv, nv).
            J: The rows, shape (m, nv).
        """
        return held.of(J)

    def jacobian(self, x: State, on: NDArray[np.intp]) -> Array:
        """Some rows of dg/dq at a state of all joints."""
        self._k.refresh(x.q, x.v, self._of_J)
        return self.rows.jacobian(self._k, x)[on]
