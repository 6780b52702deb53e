"""Projection of a motion onto the constraints of a mechanism, and its equation of motion."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from math import inf
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.contracts import Load
from mbd_ros.core.dynamics.mass import check_mass_anywhere
from mbd_ros.core.dynamics.tiers import build_system
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.loads.external_loads import ExternalWrench
from mbd_ros.core.loads.loads import BodyLoads, Loads
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.rows.constraint import Constraint, Kind
from mbd_ros.core.rows.constraint_rows import ConstraintRows, CouplingRows, RowBlock, RowLayout
from mbd_ros.core.state import NONE, Array, State
from mbd_ros.core.thresholds import LANDED, SINGULAR
from mbd_ros.errors import ModelError, SolveError
from mbd_ros.methods.inverse_dynamics.efforts import Efforts
from mbd_ros.methods.inverse_dynamics.force_split import numerical_rank
from mbd_ros.methods.projection.assembly import assemble

_STRIDE = 0.1  # largest step of a measured joint between two closures [rad or m]
_ITERATIONS = 30
_ADDED_INERTIA = 1.0e-3  # relative to the largest moment of inertia
Mask = NDArray[np.bool_]
_ROW_TOLERANCE = 1.0e-6  # of w where a row is active, relative to 1 + the terms that cancel in it


class LoopMotion:
    """Projection of a motion onto bilateral constraints, and solution for unmeasured joints.

    Distances are measured with the mass matrix. Drives are ignored: a measured motion already
    contains what they did.

    Args:
        couplings: Dependent joints, which become rows.
        constraints: Constraints of the scene, of which only the bilateral ones are used.
    """

    def __init__(
        self, robot: Robot, couplings: Couplings, constraints: Sequence[Constraint]
    ) -> None:
        rows = [part for part in constraints if part.law.kind is Kind.BILATERAL]
        self._system = build_system(robot, couplings, rows, Loads(robot.model.nv), tier="kkt")
        self._names = {joint.v: joint.name for joint in robot.joints} | robot.base_titles
        self._is_base = np.isin(np.arange(robot.model.nv), robot.base_v)
        self._q = np.array([joint.q for joint in robot.joints], dtype=np.intp)
        self._v = np.array([joint.v for joint in robot.joints], dtype=np.intp)
        self._bilateral = self._system.bilateral  # rows of positions and of velocities
        sizes = self._bilateral.sizes
        self._usual = np.zeros(0) if sizes is None else np.sqrt(sizes.mobility)

    def metric(self, q: Array) -> Array:
        """Return the mass matrix that measures distances, shape (nv, nv)."""
        return self._system.mass(q).dense

    def jacobian(self, t: float, q: Array) -> Array:
        """Return the Jacobian of couplings and constraints at a configuration, shape (m, nv)."""
        return self._bilateral.jacobian(t, q)

    def project_motion(self, x: State, a: Array) -> tuple[State, Array]:
        """Return the nearest state on the constraints and the nearest admissible acceleration.

        Args:
            x: State of all joints, near the constraints.
            a: Acceleration of all joints, shape (nv,).

        Raises:
            SolveError: The mechanism cannot be assembled near this position.
        """
        if not self._bilateral.rows:
            return x, a
        q = assemble(self._system, x._replace(v=np.zeros_like(x.v))).q
        J, L, size = self._rows(x.t, q)
        v = x.v - _smallest_change(J, L, size, J.dot(x.v) + self._bilateral.rate(x.t, q))
        x = State(x.t, q, v)
        return x, a - _smallest_change(J, L, size, J.dot(a) + self._drift(x))

    def close_loops(self, before: Array, x: State, a: Array, measured: Mask) -> ClosedMotion:
        """Solve for the joints that are not measured, on the branch of an earlier configuration.

        The measured joints move from their earlier to their present positions in steps that are
        short enough for the others to follow.

        Args:
            before: Earlier configuration on the constraints, shape (nq,).
            x: State of all joints; entries that are not measured are ignored.
            a: Acceleration of all joints, shape (nv,); entries that are not measured are ignored.
            measured: Velocity coordinates that are measured, shape (nv,).

        Returns:
            The motion of all joints; a rate is NaN where it follows from measured rates that are
            NaN.
        """
        free = np.flatnonzero(~measured)
        is_measured = measured[self._v]
        start, end = before[self._q[is_measured]], x.q[self._q[is_measured]]
        q, base_step = before.copy(), np.zeros(self._system.nv)
        base = measured & self._is_base
        base_step[base] = self._system.chart.difference(before, x.q)[base]
        longest = max(np.abs(end - start).max(initial=0.0), np.abs(base_step).max(initial=0.0))
        strides = max(1, math.ceil(float(longest) / _STRIDE))
        for i in range(1, strides + 1):
            if base.any():
                q = self._system.chart.integrate(q, base_step / strides)
            q[self._q[is_measured]] = start + (end - start) * (i / strides)
            q = self._close(x.t, q, free)
        J = self._bilateral.jacobian(x.t, q)
        condition = float(np.linalg.cond(J[:, free])) if J[:, free].size else 1.0
        v, a = np.where(measured, x.v, 0.0), np.where(measured, a, 0.0)
        v[free] = -_least_squares(J[:, free], J.dot(v) + self._bilateral.rate(x.t, q))
        x = State(x.t, q, v)
        a[free] = -_least_squares(J[:, free], J.dot(a) + self._drift(x))
        return ClosedMotion(x, a, condition)

    def undetermined(self, x: State, measured: Mask) -> tuple[str, ...]:
        """Return the joints that are neither measured nor determined by those that are.

        Args:
            x: State on the constraints.
            measured: Velocity coordinates that are measured, shape (nv,).
        """
        free = np.flatnonzero(~measured)
        _, s, Vt = np.linalg.svd(self._system.jacobian(x.t, x.q)[:, free])
        loose = Vt[numerical_rank(s) :]
        share = np.linalg.norm(loose, axis=0)
        names = (self._names[int(v)] for v in free[share > SINGULAR])
        return tuple(dict.fromkeys(names))

    def integrate(self, q: Array, step: Array) -> Array:
        """Return the configuration after a tangent step, shape (nq,)."""
        return self._system.chart.integrate(q, step)

    def assemble(self, x: State) -> Array:
        """Return the configuration on the constraints that is nearest to that of a state.

        Raises:
            SolveError: The mechanism cannot be assembled near this configuration.
        """
        return assemble(self._system, x._replace(v=np.zeros_like(x.v))).q

    def _close(self, t: float, q: Array, free: NDArray[np.intp]) -> Array:
        """Close the loops by Newton's method over some coordinates, as far as they can."""
        dq = np.zeros(self._system.nv)
        for _ in range(_ITERATIONS):
            J = self._system.jacobian(t, q)
            dq[free] = -_least_squares(J[:, free], self._system.residual(t, q))
            largest = float(np.abs(dq).max(initial=0.0))
            q = self._system.chart.integrate(q, dq * min(1.0, _STRIDE / max(largest, _STRIDE)))
            if largest <= LANDED:
                break
        return q

    def _drift(self, x: State) -> Array:
        constraints, k = self._bilateral.constraints, self._system.k
        k.refresh(x.q, x.v, constraints.reads)
        return constraints.accelerations(k, x)[1]

    def _rows(self, t: float, q: Array) -> tuple[Array, Array, Array]:
        """Return J, the Cholesky factor of M, and the norm of each row in the metric M^-1."""
        J, M = self._bilateral.jacobian(t, q), self._system.mass(q).dense
        if not (np.isfinite(J).all() and np.isfinite(M).all()):
            raise SolveError("constraint rows or masses are not finite")
        L: Any = np.linalg.cholesky(M)
        size = np.maximum(self._usual, np.linalg.norm(np.linalg.solve(L, J.T), axis=0))
        return J, L, np.where(size > 0.0, size, 1.0)


def _smallest_change(J: Array, L: Array, size: Array, r: Array) -> Array:
    """Return the smallest v in the metric M = L L' with J v = r, shape (nv,)."""
    weighted = np.linalg.solve(L, J.T) / size
    change: Array = np.linalg.solve(L.T, _least_squares(weighted.T, r / size))
    return change


def _least_squares(A: Array, b: Array) -> Array:
    """Return the smallest x that minimizes |A x - b|, without directions lost at a toggle."""
    if not np.isfinite(b).all():
        return np.full(A.shape[1], np.nan)
    solution: Any = np.linalg.lstsq(A, b, rcond=SINGULAR)[0]
    return solution


class ClosedMotion(NamedTuple):
    """Motion of all joints, with those that were not measured solved from the loops.

    Attributes:
        x: State of all joints.
        a: Acceleration of all joints, shape (nv,).
        condition: Condition number of the loop equations. Where it is large, the loop is near a
            toggle, and the measured joints no longer distinguish its two branches.
    """

    x: State
    a: Array
    condition: float


class LoopBalance:
    """Terms of the equation of motion of a mechanism: constraint rows, inputs and forces.

    One instance owns one Pinocchio `Data`. Call `refresh` first, then `rows`; all methods refer to
    the state of the last `refresh`.

    Args:
        couplings: Dependent joints, which become rows.
        constraints: Constraints of the scene.
        efforts: The unknown inputs.
        with_bounds: Whether unilateral and bounded rows are among the unknowns; drives always are.
        contacts: Names of contacts whose forces are unknown; forces of other contacts are loads.

    Attributes:
        constraints: The rows: couplings, then constraints in the order of the scene.
        is_drive: Which rows are drives, shape (m,).
        is_bilateral: Which rows the motion must satisfy, shape (m,).
        contacts: The contacts of unknown force, in the order of their rows.

    Raises:
        ModelError: A multiplier law whose bounds are not numbers.
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
        self.is_bilateral = _of_kind(self.constraints, Kind.BILATERAL)
        of_contacts = _of_kind(self.constraints, Kind.CONE)
        self._is_bounded = ~(self.is_drive | self.is_bilateral | of_contacts)
        self._of_contacts = np.flatnonzero(of_contacts)
        self.contacts = tuple(b.part for b in known if b.law.kind is Kind.CONE)
        for _, slots, _, _ in self.constraints.cones:  # tangents have no bounds of their own
            self.constraints.lower[slots], self.constraints.upper[slots] = (0.0, -inf, -inf), inf
        self._model, self._data = robot.model, pin.Data(robot.model)
        self._forces, self._loads = tuple(forces), BodyLoads(robot, wrenches)
        self._k = Kinematics(robot, self._data)
        read = (efforts.reads, *(force.reads for force in forces))
        self._reads = max(self.constraints.reads, *read, Reads.POSITION)  # wrenches read positions
        self._columns, self._offset = efforts.columns, efforts.offset

    def refresh(self, x: State) -> None:
        """Compute placements, velocities and joint Jacobians at a state."""
        self._k.refresh(x.q, x.v, self._reads)

    def columns(self, x: State) -> Array:
        """Return the matrix B of the efforts, shape (nv, na)."""
        return self._columns(self._k, x)

    def rows(self, x: State) -> tuple[Array, Array]:
        """Return J and drift of all rows, (m, nv) and (m,), overwritten by the next call."""
        return self.constraints.accelerations(self._k, x)

    def known_multipliers(self, x: State, a: Array, stance: NDArray[np.bool_]) -> Array:
        """Return the multipliers that follow from the motion, NaN for the others, shape (m,).

        A unilateral or bounded row satisfies w = g'' + kd g' + kp g = 0 while its multiplier is
        inside its bounds. Where w > 0 the multiplier is at its lower bound, where w < 0 at its
        upper one. Thus an open stop exerts no force, and sliding friction its largest one.

        Args:
            x: State of all joints.
            a: Acceleration of all joints, shape (nv,).
            stance: Which features of contacts may press; the others exert no force.
        """
        lam = np.full(len(self._is_bounded), np.nan)
        lam[self._of_contacts[np.repeat(~stance, 3)]] = 0.0
        if not self._is_bounded.any():
            return lam
        if self.constraints.varies:
            self.constraints.limit(self._k, x)
        J, b = self.constraints.conditions(self._k, x)
        w, terms = J.dot(a) + b, np.abs(J).dot(np.abs(a)) + np.abs(b)
        at_bound = self._is_bounded & (np.abs(w) > _ROW_TOLERANCE * (1.0 + terms))
        bound = np.where(w > 0.0, self.constraints.lower, self.constraints.upper)
        return np.where(at_bound & np.isfinite(bound), bound, lam)

    def residual(self, x: State) -> Array:
        """Return the residual g of the bilateral rows, 0 for the others, shape (m,)."""
        return np.where(self.is_bilateral, self.constraints.residual(self._k, x), 0.0)

    def rate(self, x: State) -> Array:
        """Return the partial derivative of g with respect to time, shape (m,)."""
        return self.constraints.rate(self._k, x)

    def terms(self, x: State, a: Array, wrenches: Sequence[Array]) -> Terms:
        """Return the generalized forces of a motion."""
        loads = np.zeros_like(a) if self._offset is None else self._offset(self._k, x)
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


def _check_bounds(blocks: Sequence[RowBlock]) -> None:
    for block in blocks:
        if block.slips:
            raise ModelError(
                f"row {block.rows[0].name}: inverse dynamics accepts the laws bilateral, box, "
                "unilateral and drive, but this row slips"
            )


def _of_kind(constraints: ConstraintRows, kind: Kind) -> NDArray[np.bool_]:
    """Return which rows have a multiplier law of a kind, shape (m,)."""
    blocks = [np.full(len(block.rows), block.law.kind is kind) for block in constraints.blocks]
    return np.concatenate([np.zeros(0, dtype=np.bool_), *blocks])


class Terms(NamedTuple):
    """Generalized forces of a motion, shape (nv,) each.

    Attributes:
        inertial: M a.
        bias: h, Coriolis terms and gravity.
        loads: Forces of external wrenches and force terms.
    """

    inertial: Array
    bias: Array
    loads: Array


def with_regular_inertia(robot: Robot) -> Robot:
    """Return a robot whose mass matrix is regular even with massless links.

    Distances and ranks need a metric. Where some joints move no mass, every joint gets a small
    armature. Forces are never computed with this robot.
    """
    system = build_system(robot, Couplings(robot), (), Loads(robot.model.nv))
    try:
        check_mass_anywhere(system)
    except SolveError:
        diagonal = system.mass(robot.neutral()).diagonal()
        model = robot.model.copy()
        model.armature = model.armature + _ADDED_INERTIA * (
            float(diagonal.max(initial=0.0)) or 1.0
        )
        return replace(robot, model=model)
    return robot
