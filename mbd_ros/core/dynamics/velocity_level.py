"""Impacts: jumps of the velocity, solved for at once.

    M (v+ - v-) = J' p

Restitution is Poisson's for every impact. In its compression impulses p_c end the approach,

    p_c >= 0,   g'_c >= 0,   p_c g'_c = 0       at v_c = v- + M^-1 J' p_c

and in its expansion a row gives back at least its share e of them,

    p_e >= e p_c,   g'+ >= 0,   (p_e - e p_c) g'+ = 0       at v+ = v_c + M^-1 J' p_e

So the expansion leaves the least kinetic energy that impulses p_e >= e p_c can. p_e = p_c is one
of them and gives back what v- had: no impact gains energy, whatever the e of its rows. Bilateral
rows and couplings hold in both. Source: F. Pfeiffer, C. Glocker, Multibody Dynamics with
Unilateral Contacts, 1996, ch. 8.
"""

from collections.abc import Sequence
from typing import NamedTuple

import eigenpy
import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.dynamics.rigid_rows import RigidRows
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.optimization.active_set import least_norm
from mbd_ros.core.optimization.box_qp import BoxQp, exchanged
from mbd_ros.core.row_laws import Kind
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import CONTRADICTION, HELD_BY_ROWS, NEARLY_SINGULAR, TINY
from mbd_ros.errors import SolveError

_FACTORISED = eigenpy.ComputationInfo.Success
_CLOSED = 1.0e-12  # g' of rows that do not open, of the largest velocity
Slots = NDArray[np.intp]


class Impact(NamedTuple):
    """A jump of the velocity.

    Attributes:
        v: Velocity of all joints after it [rad/s or m/s], shape (nv,).
        p: Impulses, one a multiplier of the scene [N·s or N·m·s], shape (m,).
    """

    v: Array
    p: Array


class VelocityLevel:
    """Solves for impacts of one system; has a `Data` of its own.

    Dry friction and limited drives are bounded forces and exert no impulse.

    Args:
        system: The system, under any tier; velocities here are those of all joints.
    """

    def __init__(self, system: System) -> None:
        nv, layout = int(system.model.nv), system.layout
        self._mechanism = Mechanism(system.robot, system.loads)
        self._rigid = RigidRows(self._mechanism, ConstraintRows(layout.rigid, nv))
        self._bilateral = self._rigid.constraints.slots
        self._rows, self._pushing = layout.rows, layout.having(Kind.UNILATERAL)
        self._restitution = np.zeros(len(layout.rows))
        for block in self._pushing:
            self._restitution[block.slots] = block.law.restitution
        self._nothing = np.zeros((0, nv)), np.zeros(0)

    def impact(self, x: State, touching: Sequence[int]) -> Impact:
        """The velocity after an impact, and its impulses; none where nothing approaches.

        Args:
            x: State of all joints before it.
            touching: Slots of the one-sided rows that are closed, in the `layout` of the system;
                they may depend on one another. Slots of other rows are passed over.

        Raises:
            SolveError: Nothing can keep a row from closing further; names it.
        """
        slots, J, rate = self._touched(x, touching)
        M = np.array(self._mechanism.mass(x.q))
        response = eigenpy.LLT(M).solve(J.T).reshape(J.T.shape)  # eigenpy flattens one column
        free = np.concatenate((x.v[:, None], response), axis=1)
        moved, held = self._holding(x, M, free)
        v, response = moved[:, 0], moved[:, 1:]
        speed = float(v.dot(M).dot(v)) ** 0.5
        loose = np.einsum("ij,ji->i", J, free[:, 1:])
        impulse = self._impulses(slots, J.dot(response), J.dot(v) + rate, loose, speed)
        p = np.zeros(len(self._rows))
        p[slots], p[self._bilateral] = impulse, held[:, 0] + held[:, 1:].dot(impulse)
        return Impact(v + response.dot(impulse), p)

    def _touched(self, x: State, touching: Sequence[int]) -> tuple[Slots, Array, Array]:
        """Slots of rows that push, their J and the part of g' without the velocity."""
        wanted = set(touching)
        slots, (no_J, no_rate) = [], self._nothing
        J, rates = [no_J], [no_rate]
        for block in self._pushing:
            here = [i for i in range(block.slots.start, block.slots.stop) if i in wanted]
            if here:
                part, own = block.part, np.array(here) - block.slots.start
                self._mechanism.k.refresh(x.q, x.v, part.reads)
                J.append(part.jacobian(self._mechanism.k, x)[own])
                rates.append(part.rate(self._mechanism.k, x)[own])
                slots += here
        return np.array(slots, dtype=np.intp), np.concatenate(J), np.concatenate(rates)

    def _holding(self, x: State, M: Array, free: Array) -> tuple[Array, Array]:
        """Velocities that bilateral rows leave, and their impulses.

        Args:
            x: State of all joints.
            M: Their mass matrix.
            free: A velocity, then changes of it, one a column.
        """
        if not len(self._bilateral):
            return free, np.zeros((0, free.shape[1]))
        J = self._rigid.jacobian(x.t, x.q)
        factor = self._rigid.factorise(M, J)
        left = -J.dot(free)
        left[:, 0] -= self._rigid.rate(x.t, x.q)
        p = factor.solve(left)
        return free + factor.X.dot(p), p

    def _impulses(
        self, slots: Slots, A: Array, approach: Array, loose: Array, speed: float
    ) -> Array:
        """Impulses of compression and expansion together, one a touching row.

        Args:
            slots: Where they stand.
            A: g' that impulses add, shape (k, k).
            approach: g' before, shape (k,).
            loose: Diagonal of A without bilateral rows, shape (k,).
            speed: Velocity in the mass metric.
        """
        mobile = A.diagonal() > HELD_BY_ROWS * loose
        size = np.sqrt(np.where(loose > 0.0, loose, 1.0))
        blocked = ~mobile & (approach < -CONTRADICTION * size * speed)
        if blocked.any():
            name = self._rows[slots[blocked.argmax()]].name
            raise SolveError(f"nothing can keep constraint row {name} from closing")
        p = np.zeros(len(slots))
        unit = 1.0 / np.sqrt(A.diagonal()[mobile])
        A = unit[:, None] * A[np.ix_(mobile, mobile)] * unit
        b = unit * approach[mobile]
        fastest = max(float(np.abs(b).max(initial=0.0)), speed, TINY)
        scaled = _impacts(A, b / fastest, self._restitution[slots[mobile]])
        p[mobile] = fastest * unit * scaled
        return p


def _impacts(A: Array, b: Array, e: Array) -> Array:
    """Impulses of compression and expansion, for rows scaled to A_ii = 1 and |b| <= 1."""
    A = 0.5 * (A + A.T)
    compression = _pushing(A, b)
    given_back = e * compression
    if not given_back.any():
        return compression
    p = compression + given_back
    return p + _pushing(A, b + A.dot(p))


def _pushing(A: Array, b: Array) -> Array:
    """The p >= 0 with A p + b >= 0 that push only where that is 0."""
    none = np.zeros(len(b))
    if (b >= 0.0).all():
        return none
    most = np.full(len(b), np.inf)
    p = exchanged(A, b, none, most)
    if p is None:
        p = BoxQp(len(b), rungs=("cold", "damped")).solve(A, b, none, most)
    return _shared(A, b, p)


def _shared(A: Array, b: Array, p: Array) -> Array:
    """The same impulses, shared among rows that depend on one another: their norm is least."""
    closed = A.dot(p) + b <= _CLOSED
    closing = A[np.ix_(closed, closed)]
    factor = eigenpy.LLT(closing)
    if factor.info() == _FACTORISED and factor.rcond() > NEARLY_SINGULAR:
        return p
    least = least_norm(closing, -b[closed])
    if not (least >= 0.0).all():
        return p
    shared = np.zeros(len(p))
    shared[closed] = least
    return shared
