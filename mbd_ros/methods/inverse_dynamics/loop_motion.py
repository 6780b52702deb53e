"""Motion of a mechanism with loops that its constraints allow, and its equation of motion."""

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
from mbd_ros.methods.inverse_dynamics.force_split import rank_of
from mbd_ros.methods.projection.assembly import assemble

_STRIDE = 0.1  # largest step of a measured joint between two closures [rad or m]
_ITERATIONS = 30
_LITTLE = 1.0e-3  # of the largest moment of inertia
Mask = NDArray[np.bool_]
_HOLDS = 1.0e-6  # of the terms that cancel in w where a row holds, and of 1 m/s^2 or rad/s^2


class LoopMotion:
    """Nearest consistent motion in the mass metric, and joints that nobody measures.

    Drives demand nothing here: the motion shows what they did.

    Args:
        couplings: Its dependent joints, as rows.
        constraints: Bilateral constraints of the scene; drives among them are left out.
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
        self._held = self._system.held  # rows of velocities among them
        sizes = self._held.sizes
        self._usual = np.zeros(0) if sizes is None else np.sqrt(sizes.mobility)

    def metric(self, q: Array) -> Array:
        """Mass matrix with which distances are measured, shape (nv, nv)."""
        return self._system.mass(q).dense

    def jacobian(self, t: float, q: Array) -> Array:
        """Rows of couplings and constraints at a configuration, shape (m, nv)."""
        return self._held.jacobian(t, q)

    def consistent(self, x: State, a: Array) -> tuple[State, Array]:
        """The nearest state on the constraints and the nearest acceleration that they allow.

        Args:
            x: State of all joints, near the constraints.
            a: Acceleration of all joints, shape (nv,).

        Raises:
            SolveError: The mechanism cannot be assembled near this position.
        """
        if not self._held.rows:
            return x, a
        q = assemble(self._system, x._replace(v=np.zeros_like(x.v))).q
        J, L, size = self._rows(x.t, q)
        v = x.v - _shortest(J, L, size, J.dot(x.v) + self._held.rate(x.t, q))
        x = State(x.t, q, v)
        return x, a - _shortest(J, L, size, J.dot(a) + self._drift(x))

    def complete(self, before: Array, x: State, a: Array, measured: Mask) -> Completed:
        """A state whose other joints close the loops, on the branch of an earlier one.

        The measured joints move from their earlier to their present positions in steps that are
        short enough for the others to follow.

        Args:
            before: Configuration on the constraints, shape (nq,).
            x: State of all joints; entries that are not measured are ignored.
            a: Acceleration of all joints; likewise, shape (nv,).
            measured: Velocity coordinates that are measured, shape (nv,).

        Returns:
            The motion with the other joints filled in: NaN where they follow from measured rates
            that are NaN.
        """
        free = np.flatnonzero(~measured)
        kept = measured[self._v]
        start, end = before[self._q[kept]], x.q[self._q[kept]]
        q, way = before.copy(), np.zeros(self._system.nv)
        seen = measured & self._is_base
        way[seen] = self._system.chart.difference(before, x.q)[seen]
        longest = max(np.abs(end - start).max(initial=0.0), np.abs(way).max(initial=0.0))
        strides = max(1, math.ceil(float(longest) / _STRIDE))
        for i in range(1, strides + 1):
            if seen.any():
                q = self._system.chart.integrate(q, way / strides)
            q[self._q[kept]] = start + (end - start) * (i / strides)
            q = self._closed(x.t, q, free)
        J = self._held.jacobian(x.t, q)
        condition = float(np.linalg.cond(J[:, free])) if J[:, free].size else 1.0
        v, a = np.where(measured, x.v, 0.0), np.where(measured, a, 0.0)
        v[free] = -_least(J[:, free], J.dot(v) + self._held.rate(x.t, q))
        x = State(x.t, q, v)
        a[free] = -_least(J[:, free], J.dot(a) + self._drift(x))
        return Completed(x, a, condition)

    def undetermined(self, x: State, measured: Mask) -> tuple[str, ...]:
        """Joints that are not measured and that no row ties to those that are.

        Args:
            x: State on the constraints.
            measured: Velocity coordinates that are measured, shape (nv,).
        """
        free = np.flatnonzero(~measured)
        _, s, Vt = np.linalg.svd(self._system.jacobian(x.t, x.q)[:, free])
        loose = Vt[rank_of(s) :]
        share = np.linalg.norm(loose, axis=0)
        names = (self._names[int(v)] for v in free[share > SINGULAR])
        return tuple(dict.fromkeys(names))

    def moved(self, q: Array, step: Array) -> Array:
        """A configuration after a step in the tangent, shape (nq,)."""
        return self._system.chart.integrate(q, step)

    def start(self, x: State) -> Array:
        """Configuration on the constraints nearest to that of a state.

        Raises:
            SolveError: There is none near it.
        """
        return assemble(self._system, x._replace(v=np.zeros_like(x.v))).q

    def _closed(self, t: float, q: Array, free: NDArray[np.intp]) -> Array:
        """Newton's method over some coordinates; as near as they come if they cannot close it."""
        dq = np.zeros(self._system.nv)
        for _ in range(_ITERATIONS):
            J = self._system.jacobian(t, q)
            dq[free] = -_least(J[:, free], self._system.residual(t, q))
            largest = float(np.abs(dq).max(initial=0.0))
            q = self._system.chart.integrate(q, dq * min(1.0, _STRIDE / max(largest, _STRIDE)))
            if largest <= LANDED:
                break
        return q

    def _drift(self, x: State) -> Array:
        constraints, k = self._held.constraints, self._system.k
        k.refresh(x.q, x.v, constraints.reads)
        return constraints.accelerations(k, x)[1]

    def _rows(self, t: float, q: Array) -> tuple[Array, Array, Array]:
        """J, the Cholesky factor of M, and the size of the rows in the metric M^-1."""
        J, M = self._held.jacobian(t, q), self._system.mass(q).dense
        if not (np.isfinite(J).all() and np.isfinite(M).all()):
            raise SolveError("constraint rows or masses are not finite")
        L: Any = np.linalg.cholesky(M)
        size = np.maximum(self._usual, np.linalg.norm(np.linalg.solve(L, J.T), axis=0))
        return J, L, np.where(size > 0.0, size, 1.0)


def _shortest(J: Array, L: Array, size: Array, r: Array) -> Array:
    """The shortest motion in the metric M = L L' that changes the rows by r, shape (nv,)."""
    weighted = np.linalg.solve(L, J.T) / size
    shortest: Array = np.linalg.solve(L.T, _least(weighted.T, r / size))
    return shortest


def _least(A: Array, b: Array) -> Array:
    """The shortest of the x with A x nearest to b, without directions that vanish at a toggle."""
    if not np.isfinite(b).all():
        return np.full(A.shape[1], np.nan)
    least: Any = np.linalg.lstsq(A, b, rcond=SINGULAR)[0]
    return least


class Completed(NamedTuple):
    """A motion whose loops have given the joints that nobody measured.

    Attributes:
        x: State of all joints.
        a: Their acceleration, shape (nv,).
        condition: Condition number of the rows; where it is large the loop folds, and the
            measured joints no longer tell its two branches apart.
    """

    x: State
    a: Array
    condition: float


class LoopBalance:
    """Rows, mass matrix and forces of a mechanism.

    One instance owns one Pinocchio `Data`. `place` comes first; all other methods refer to that
    state, and `rows` comes before them.

    Args:
        couplings: Its dependent joints; they become rows.
        constraints: Constraints of the scene.
        efforts: The unknown inputs.
        with_bounds: Whether rows that give way are among the unknowns; drives always are.
        contacts: Names of contacts whose forces are unknown; those of others are loads.

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


def _check_bounds(blocks: Sequence[RowBlock]) -> None:
    for block in blocks:
        if block.slips:
            raise ModelError(
                f"row {block.rows[0].name}: inverse dynamics takes no rows that slip; accepted "
                "laws: bilateral, box, unilateral, drive"
            )


def _of_kind(constraints: ConstraintRows, kind: Kind) -> NDArray[np.bool_]:
    """Which rows have a law of that kind, shape (m,)."""
    blocks = [np.full(len(block.rows), block.law.kind is kind) for block in constraints.blocks]
    return np.concatenate([np.zeros(0, dtype=np.bool_), *blocks])


class Terms(NamedTuple):
    """Generalized forces of a motion, shape (nv,) each.

    Attributes:
        bias: h, gravity included.
        loads: Forces of wrenches and force terms.
    """

    inertial: Array
    bias: Array
    loads: Array


def with_inertia(robot: Robot) -> Robot:
    """The robot of the metric, which stays regular with links without mass.

    Distances and ranks need a metric, not the masses: where some joints move nothing that has
    mass, every joint gets a little inertia. Forces never come from this robot.
    """
    system = build_system(robot, Couplings(robot), (), Loads(robot.model.nv))
    try:
        check_mass_anywhere(system)
    except SolveError:
        diagonal = system.mass(robot.neutral()).diagonal()
        model = robot.model.copy()
        model.armature = model.armature + _LITTLE * (float(diagonal.max(initial=0.0)) or 1.0)
        return replace(robot, model=model)
    return robot
