"""Equation of motion of a mechanism with loops at one state."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.dynamics.body_loads import BodyLoads
from mbd_ros.core.dynamics.external_wrench import ExternalWrench
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.parts import Constraint, Load
from mbd_ros.core.row_laws import Kind
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.rows.coupling_rows import CouplingRows
from mbd_ros.core.rows.row_layout import RowLayout
from mbd_ros.core.state import NONE, Array, State


class Terms(NamedTuple):
    """Generalized forces of a motion, shape (nv,) each.

    Attributes:
        inertial: M a.
        bias: h, gravity included.
        loads: Forces of wrenches and force terms.
    """

    inertial: Array
    bias: Array
    loads: Array


class LoopBalance:
    """Rows, mass matrix and forces of a mechanism.

    One instance owns one Pinocchio `Data`. `place` comes first; all other methods refer to that
    state, and `rows` comes before them.

    Args:
        robot: The robot.
        couplings: Its dependent joints; they become rows.
        constraints: Constraints of the scene. Bounded ones are left out, limited drives apart.
        wrenches: External loads.
        forces: Force terms.

    Attributes:
        constraints: The rows: couplings, then constraints in the order of the scene.
        is_drive: Which rows are drives, shape (m,).
    """

    def __init__(
        self,
        robot: Robot,
        couplings: Couplings,
        constraints: Sequence[Constraint],
        wrenches: Sequence[ExternalWrench] = (),
        forces: Sequence[Load] = (),
    ) -> None:
        coupled: list[Constraint] = [CouplingRows(robot, couplings)] if couplings.dependent else []
        layout = RowLayout([*coupled, *constraints])
        known = layout.having(Kind.BILATERAL, Kind.DRIVE)
        self.constraints = ConstraintRows(known, robot.model.nv)
        drives = [
            np.full(len(part.rows), part.law.kind is Kind.DRIVE) for part in self.constraints.parts
        ]
        self.is_drive = np.concatenate([np.zeros(0, dtype=np.bool_), *drives])
        self._model, self._data = robot.model, pin.Data(robot.model)
        self._forces, self._loads = tuple(forces), BodyLoads(robot, wrenches)
        self._k = Kinematics(robot, self._data)
        read = (force.reads for force in forces)
        self._reads = max(self.constraints.reads, *read, Reads.POSITION)  # wrenches read positions

    def place(self, x: State) -> None:
        """Bring placements, velocities and joint Jacobians to a state."""
        self._k.refresh(x.q, x.v, self._reads)

    def rows(self, x: State) -> tuple[Array, Array]:
        """J and drift of all rows, (m, nv) and (m,), overwritten by the next call."""
        return self.constraints.accelerations(self._k, x)

    def residual(self, x: State) -> Array:
        """Residual g of all rows, shape (m,); that of a drive is zero."""
        return np.where(self.is_drive, 0.0, self.constraints.residual(self._k, x))

    def rate(self, x: State) -> Array:
        """What time alone changes in g of all rows, shape (m,)."""
        return self.constraints.rate(self._k, x)

    def terms(self, x: State, a: Array, wrenches: Sequence[Array]) -> Terms:
        """Forces of a motion; overwrites the last state in `data`."""
        loads = np.zeros_like(a)
        for force in self._forces:
            loads += force.force(self._k, x, NONE)
        self._loads.set(self._k, wrenches)
        model, data = self._model, self._data
        loaded = pin.rnea(model, data, x.q, x.v, a, self._loads.forces)
        bias = pin.nonLinearEffects(model, data, x.q, x.v)
        inertial = pin.rnea(model, data, x.q, x.v, a) - bias
        return Terms(inertial, bias, loads + inertial + bias - loaded)
