"""Equation of motion of a mechanism with loops at one state."""

from collections.abc import Collection, Sequence
from math import inf
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.contracts.parts import Load
from mbd_ros.core.inverse_dynamics.efforts import Efforts
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.loads.body_loads import BodyLoads
from mbd_ros.core.loads.external_wrench import ExternalWrench
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.multiplier_laws import Kind
from mbd_ros.core.rows.constraint import Constraint
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.rows.coupling_rows import CouplingRows
from mbd_ros.core.rows.row_layout import RowBlock, RowLayout
from mbd_ros.core.state import NONE, Array, State
from mbd_ros.errors import ModelError

_HOLDS = 1.0e-6  # of the terms that cancel in w where a row holds, and of 1 m/s^2 or rad/s^2


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
        constraints: Constraints of the scene.
        efforts: The unknown inputs.
        with_bounds: Whether rows that give way are among the unknowns; drives always are.
        contacts: Names of contacts whose forces are unknown; those of others are loads.
        wrenches: External loads.
        forces: Force terms.

    Attributes:
        constraints: The rows: couplings, then constraints in the order of the scene.
        is_drive: Which rows are drives, shape (m,).
        is_held: Which rows the motion must keep, shape (m,).
        contacts: The contacts of unknown forces, in the order of their rows.

    Raises:
        ModelError: A law of multipliers that has no bounds in numbers.
    """

    def __init__(
        self,
        robot: Robot,
        couplings: Couplings,
        constraints: Sequence[Constraint],
        efforts: Efforts,
        wrenches: Sequence[ExternalWrench] = (),
        forces: Sequence[Load] = (),
        *,
        with_bounds: bool = False,
        contacts: Collection[str] = (),
    ) -> None:
        coupled: list[Constraint] = [CouplingRows(robot, couplings)] if couplings.dependent else []
        layout, kinds = RowLayout([*coupled, *constraints]), {Kind.BILATERAL, Kind.DRIVE}
        if with_bounds:
            kinds = {*Kind} - {Kind.CONE}
        known = [
            block
            for block in layout.blocks
            if block.law.kind in kinds
            or (block.law.kind is Kind.CONE and block.part.name in contacts)
        ]
        _check_bounds(known)
        self.constraints = ConstraintRows(known, robot.model.nv)
        self.is_drive = _of_kind(self.constraints, Kind.DRIVE)
        self.is_held = _of_kind(self.constraints, Kind.BILATERAL)
        of_contacts = _of_kind(self.constraints, Kind.CONE)
        self._gives_way = ~(self.is_drive | self.is_held | of_contacts)
        self._of_contacts = np.flatnonzero(of_contacts)
        self.contacts = tuple(b.part for b in known if b.law.kind is Kind.CONE)
        for _, slots, _, _ in self.constraints.cones:  # tangents have no bounds of their own
            self.constraints.lower[slots], self.constraints.upper[slots] = (0.0, -inf, -inf), inf
        self._model, self._data = robot.model, pin.Data(robot.model)
        self._forces, self._loads = tuple(forces), BodyLoads(robot, wrenches)
        self._k = Kinematics(robot, self._data)
        read = (efforts.reads, *(force.reads for force in forces))
        self._reads = max(self.constraints.reads, *read, Reads.POSITION)  # wrenches read positions
        self._columns, self._rest = efforts.columns, efforts.rest

    def place(self, x: State) -> None:
        """Bring placements, velocities and joint Jacobians to a state."""
        self._k.refresh(x.q, x.v, self._reads)

    def columns(self, x: State) -> Array:
        """B of the efforts, shape (nv, na)."""
        return self._columns(self._k, x)

    def rows(self, x: State) -> tuple[Array, Array]:
        """J and drift of all rows, (m, nv) and (m,), overwritten by the next call."""
        return self.constraints.accelerations(self._k, x)

    def shown(self, x: State, a: Array, standing: NDArray[np.bool_]) -> Array:
        """Multipliers that the motion shows, NaN where it does not, shape (m,).

        A row that gives way holds w = g'' + kd g' + kp g = 0 inside its bounds; where w > 0 its
        multiplier is at the lower one, where w < 0 at the upper one. So does an open stop exert
        nothing, and friction that slips all it can.

        Args:
            x: State of all joints.
            a: Acceleration of all joints, shape (nv,).
            standing: Which features of contacts may press; the others exert nothing.
        """
        lam = np.full(len(self._gives_way), np.nan)
        lam[self._of_contacts[np.repeat(~standing, 3)]] = 0.0
        if not self._gives_way.any():
            return lam
        if self.constraints.varies:
            self.constraints.limit(self._k, x)
        J, b = self.constraints.conditions(self._k, x)
        w, terms = J.dot(a) + b, np.abs(J).dot(np.abs(a)) + np.abs(b)
        off = self._gives_way & (np.abs(w) > _HOLDS * (1.0 + terms))
        bound = np.where(w > 0.0, self.constraints.lower, self.constraints.upper)
        return np.where(off & np.isfinite(bound), bound, lam)

    def residual(self, x: State) -> Array:
        """Residual g of all rows, shape (m,); zero where the motion need not keep them."""
        return np.where(self.is_held, self.constraints.residual(self._k, x), 0.0)

    def rate(self, x: State) -> Array:
        """What time alone changes in g of all rows, shape (m,)."""
        return self.constraints.rate(self._k, x)

    def terms(self, x: State, a: Array, wrenches: Sequence[Array]) -> Terms:
        """Forces of a motion; overwrites the last state in `data`."""
        loads = np.zeros_like(a) if self._rest is None else self._rest(self._k, x)
        for force in self._forces:
            loads += force.force(self._k, x, NONE)
            if force.has_inertia:
                loads -= force.inertia(self._k, x).dot(a)
        self._loads.set(self._k, wrenches)
        model, data = self._model, self._data
        loaded = pin.rnea(model, data, x.q, x.v, a, self._loads.forces)
        bias = pin.nonLinearEffects(model, data, x.q, x.v)
        inertial = pin.rnea(model, data, x.q, x.v, a) - bias
        return Terms(inertial, bias, loads + inertial + bias - loaded)


def _of_kind(constraints: ConstraintRows, kind: Kind) -> NDArray[np.bool_]:
    """Which rows have a law of that kind, shape (m,)."""
    blocks = [np.full(len(block.rows), block.law.kind is kind) for block in constraints.blocks]
    return np.concatenate([np.zeros(0, dtype=np.bool_), *blocks])


def _check_bounds(blocks: Sequence[RowBlock]) -> None:
    for block in blocks:
        if block.slips:
            raise ModelError(
                f"row {block.rows[0].name}: inverse dynamics takes no rows that slip; accepted "
                "laws: bilateral, box, unilateral, drive"
            )
