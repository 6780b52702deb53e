"""The way out of one-sided rows that are beyond 0, the least in the mass metric."""

import numpy as np

from mbd_ros.core.complementarity.unilateral_impulses import PushImpulses
from mbd_ros.core.dynamics.impulse_response import ImpulseResponse
from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.dynamics.rigid_rows import RigidRows
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import HELD_BY_ROWS, LANDED
from mbd_ros.core.time_stepping.unilateral_rows import StepRows

_NEAR = 10.0  # gaps that count while others are closed, of how far one of these is beyond 0


class MovesOut:
    """Finds ways out of one-sided rows.

    Args:
        mechanism: The mechanism.
        rigid: Its bilateral rows, which hold on the way.
        rows: The rows that give way.
    """

    def __init__(self, mechanism: Mechanism, rigid: RigidRows, rows: StepRows) -> None:
        self._mechanism, self._rigid, self._rows = mechanism, rigid, rows
        self._no_rows = np.zeros((0, int(mechanism.model.nv)))

    def way(self, x: State) -> Array | None:
        """The way of all joints from a state of them, shape (nv,); None where no row is beyond 0.

        Args:
            x: The state.
        """
        rows, rigid = self._rows, self._rigid
        gap = rows.gaps(x)
        if gap is None or (least := float(gap.min())) >= -LANDED:
            return None
        near = np.flatnonzero(gap <= -_NEAR * least)
        J = rows.jacobian(x, near)
        M = np.array(self._mechanism.mass(x.q))
        hold = rigid.jacobian(x.t, x.q) if rigid.rows else self._no_rows
        factor = rigid.factorise(M, hold) if rigid.rows else None
        response = ImpulseResponse(M, J, hold, factor)
        if len(near) == 1 and response.A[0, 0] > HELD_BY_ROWS * response.loose[0]:
            alone: Array = response.X[:, 0] * (-least / float(response.A[0, 0]))
            return alone
        names = [rows.every.names[i] for i in near]
        p, _ = PushImpulses(response.G, response.loose, names).nearest(gap[near], 0.0)
        together: Array = response.X.dot(p)
        return together
