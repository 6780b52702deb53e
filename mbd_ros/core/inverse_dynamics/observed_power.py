"""Powers of a motion that is observed sample by sample."""

from collections.abc import Mapping, Sequence

import numpy as np

from mbd_ros.core.contracts.parts import Load
from mbd_ros.core.inverse_dynamics.observed_loops import ObservedLoops
from mbd_ros.core.inverse_dynamics.power_balance import Exerted, PowerBalance
from mbd_ros.core.inverse_dynamics.torques import SampleSolver, Torques
from mbd_ros.core.loads.external_wrench import ExternalWrench
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.rows.coupling_rows import CouplingRows
from mbd_ros.core.rows.row_layout import RowLayout
from mbd_ros.core.state import Array, State


class ObservedPower:
    """Powers of the independent joints, parts and segments, from what a solver found.

    One instance owns its Pinocchio data: not for two threads.

    Args:
        robot: The robot.
        solver: Solves the samples; asked about the newest of them.
        wrenches: External loads by name.
        forces: Force terms.

    Attributes:
        outputs: As those of `PowerBalance`.
    """

    def __init__(
        self,
        robot: Robot,
        solver: SampleSolver,
        wrenches: Mapping[str, ExternalWrench],
        forces: Sequence[Load],
    ) -> None:
        couplings, nv = solver.couplings, int(robot.model.nv)
        self._couplings, self._loops = couplings, None
        if isinstance(solver, ObservedLoops):
            self._loops, rows = solver, solver.inverse.constraints
        else:
            ties = [CouplingRows(robot, couplings)] if couplings.dependent else []
            rows = ConstraintRows(RowLayout(ties).blocks, nv)
        free = () if self._loops is None else self._loops.inverse.carriers
        driven = [name for name in couplings.independent if name not in free]
        self._balance = PowerBalance(robot, rows, driven, wrenches, forces)
        self.outputs = self._balance.outputs
        self._neutral, self._nv, self._base = robot.neutral(), nv, robot.base_v

    def values(
        self,
        position: Array,
        velocity: Array,
        acceleration: Array,
        found: Torques,
        wrenches: Sequence[Array] = (),
    ) -> Array:
        """Values of `outputs` of the newest sample, shape (len(outputs),).

        Args:
            position: y, as it was solved, shape (ny,).
            velocity: y', shape (nv_y,).
            acceleration: y'', shape (nv_y,).
            found: What the solver found for it.
            wrenches: One (6,) array for every load; none means unloaded.
        """
        efforts, residual = np.zeros(self._nv), np.zeros(self._nv)
        efforts[self._couplings.v_index] = found.tau
        if self._loops is not None and self._loops.motion is not None:
            x, a = self._loops.motion
            residual = self._loops.inverse.carried(found)
        else:
            x, a = self._whole(position, velocity, acceleration)
            residual[self._base] = found.residual
        exerted = Exerted(efforts - residual, residual, found.multipliers)
        return self._balance.values(x, a, exerted, wrenches)

    def _whole(self, y: Array, rate: Array, acceleration: Array) -> tuple[State, Array]:
        q, v, a = self._neutral.copy(), np.zeros(self._nv), np.zeros(self._nv)
        index = self._couplings.v_index
        q[self._couplings.q_index], v[index], a[index] = y, rate, acceleration
        self._couplings.expand(q, v, a)
        return State(0.0, q, v), a
