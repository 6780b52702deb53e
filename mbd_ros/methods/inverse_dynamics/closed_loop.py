"""Inverse dynamics of a mechanism with loops: efforts of actuators and forces of constraints.

    M a + h - sum J_w' w - sum f = B u + J' lam + R r

Here w are external wrenches, f force terms, B the generalized forces of unit efforts u, J the rows
of couplings, constraints and contacts of unknown force, and R the coordinates of free bases. Where
the motion does not determine them, the base residual r is minimized first, then the cost of the
efforts u, then the norm of the multipliers lam.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.contracts import Load, without_multiplier
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.loads.external_loads import ExternalWrench
from mbd_ros.core.model.couplings import Couplings, Slopes
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.rows.constraint import Constraint, Kind
from mbd_ros.core.rows.delassus import usual_norms
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import ASSEMBLED
from mbd_ros.errors import SolveError
from mbd_ros.methods.inverse_dynamics.efforts import (
    ActuationReach,
    Efforts,
    Mask,
    Unknowns,
    dominant_joints,
    join_names,
    unreachable_message,
)
from mbd_ros.methods.inverse_dynamics.force_split import (
    ForceSplit,
    ForceTarget,
    Split,
    split_within_bounds,
)
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import Torques
from mbd_ros.methods.inverse_dynamics.loop_motion import (
    LoopBalance,
    LoopMotion,
    with_regular_inertia,
)
from mbd_ros.methods.inverse_dynamics.stance import Mask as StanceMask
from mbd_ros.methods.inverse_dynamics.stance import StanceDetector, StanceThresholds

_RATE_TOLERANCE = 1.0e-6  # relative to the terms that should cancel
_NEIGHBOUR = 0.1  # distance of the states that tell whether a mechanism is at a toggle [rad or m]
_RESIDUAL = 1.0e-6  # accepted residual force, relative to the forces of the motion
_RESIDUAL_AT_REST = 1.0e-9  # accepted residual force where nothing moves and nothing acts
_NO_CONTACTS = np.zeros(0, np.bool_)


class ClosedLoopInverseDynamics:
    """Inverse dynamics with constraint rows, redundant or not, and any set of efforts.

    Efforts that the motion determines are exact. Where efforts can work against one another, those
    of the least cost are chosen: by default those of the smallest Euclidean norm in SI numbers.
    Drives (prescribed motion) count as efforts. For given efforts, the multipliers of redundant
    rows have the smallest norm.

    Without bounds, the forces of stops and dry friction are part of the efforts, since a motion
    does not reveal them, and a limited drive may exceed its limit. With bounds, the rows of stops
    and friction are unknowns that obey their law, and efforts stay within their bounds.

    Contacts that are named have unknown forces inside their friction cones. The features of a flat
    foot only push, so that the centre of pressure stays between them.

    One instance owns its Pinocchio data: not for two threads. No result depends on earlier ones.

    Args:
        couplings: Dependent joints, which become rows.
        constraints: Constraints of the scene.
        efforts: The unknown inputs.
        wrenches: External loads, in the order in which `solve` takes their values.
        forces: Force terms of the scene.
        with_bounds: Whether efforts and multipliers stay within their bounds.
        contacts: Names of contacts of unknown force; forces of other contacts are loads.
        root_joints: Joints that replace a free base, see `find_root_joints`.
        thresholds: Gap and speed below which a feature counts as on the ground.

    Attributes:
        couplings: Dependent joints.
        stance: Detects which features of the contacts press; None without such contacts.
        efforts: The inputs whose values `Torques.tau` holds.
        constraints: Rows of the multipliers: couplings, then constraints in the order of the
            scene; without bounds only bilateral ones and drives.
        motion: Projects measured motion onto the constraints.

    Raises:
        ModelError: With bounds, a multiplier law whose bounds are not numbers.
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
        root_joints: Sequence[str] = (),
        thresholds: StanceThresholds | None = None,
    ) -> None:
        self.robot = robot
        self.couplings = couplings
        self.efforts = efforts
        self.root_joints = tuple(root_joints)
        self.forces = tuple(forces)
        self.motion = LoopMotion(with_regular_inertia(robot), couplings, constraints)
        self._balance = LoopBalance(
            robot,
            couplings,
            constraints,
            efforts,
            wrenches,
            forces,
            with_bounds=with_bounds,
            contacts=contacts,
        )
        self.constraints = self._balance.constraints
        self._drives = self._balance.is_drive
        self._unknowns = Unknowns(efforts, self.constraints, self._drives, with_bounds=with_bounds)
        unknown_contacts = self._balance.contacts
        self.stance = (
            StanceDetector(robot, unknown_contacts, thresholds) if unknown_contacts else None
        )
        self._limited = with_bounds or bool(unknown_contacts)
        unactuated = [*robot.base_v, *(robot.joint(name).v for name in root_joints)]
        self._every = np.ones(len(self._unknowns.labels), np.bool_)
        self._R = np.eye(int(robot.model.nv))[:, unactuated]
        self._usual = usual_norms(robot, self._metric_and_columns)

    def project_motion(self, x: State, a: Array) -> tuple[State, Array]:
        """Return the nearest motion on the constraints, see `LoopMotion.project_motion`."""
        return self.motion.project_motion(x, a)

    def columns(self, x: State) -> Array:
        """Return the matrix B at a state, shape (nv, na)."""
        self._balance.refresh(x)
        return self._balance.columns(x)

    def unsupported_force(self, torques: Torques) -> Array:
        """Return the residual force of bases and root joints on all joints, shape (nv,)."""
        force: Array = self._R.dot(np.concatenate((torques.residual, torques.root_residual)))
        return force

    def required_force(self, x: State, a: Array, wrenches: Sequence[Array] = ()) -> Array:
        """Return M a + h - loads, the force of efforts and multipliers, shape (nv,)."""
        self._balance.refresh(x)
        terms = self._balance.terms(x, a, wrenches)
        return terms.inertial + terms.bias - terms.loads

    def solve(
        self,
        x: State,
        a: Array,
        wrenches: Sequence[Array] = (),
        stance: Mask | None = None,
        target: ForceTarget | None = None,
    ) -> Torques:
        """Solve for the efforts and multipliers of one sample.

        Args:
            x: State of all joints, on the constraints.
            a: Acceleration that the constraints allow [rad/s^2 or m/s^2], shape (nv,).
            wrenches: One (6,) array [N, N·m] for every load; none means unloaded.
            stance: Which features of contacts press; None to detect it from their geometry.
            target: Goal for forces of contacts that the motion does not determine.

        Raises:
            SolveError: The motion is not consistent, or the efforts cannot produce it. The message
                names the row, the joints without an actuator, or the active bounds.
        """
        if not all(np.isfinite(values).all() for values in (x.q, x.v, a, *wrenches)):
            raise SolveError("motion or wrenches are not finite")
        if stance is None:
            stance = self.stance.detect(x) if self.stance else _NO_CONTACTS
        problem = self._problem(x, a, wrenches, stance)
        factors, b = problem.factors, problem.b
        tolerance = _RESIDUAL * problem.scale + _RESIDUAL_AT_REST
        split, r = factors.solve(b), np.zeros(self._R.shape[1])
        if len(r) and not split.residual_norm <= tolerance:
            r = factors.base_residual(b, self._R)
            split = factors.solve(b - self._R.dot(r))
        if split.residual_norm <= tolerance and self._limited:
            split, r = self._within_bounds(problem, split, r, target)
        if not split.residual_norm <= tolerance:
            M = self.motion.metric(x.q)
            joints = dominant_joints(self.robot, split.residual[:, None], M)
            labels = self._unknowns.labels[: self._unknowns.efforts]
            factor = partial(self._factors_at, problem.mask)
            at_toggle = is_at_toggle(self.motion, x, factors, factor)
            share = split.residual_norm / problem.scale
            raise SolveError(unreachable_message(labels, joints, share, at_toggle))
        return self._torques(problem, split, r)

    def reach(self, x: State) -> ActuationReach:
        """Return which motions the efforts can produce at a state, regardless of bounds."""
        self._balance.refresh(x)
        mask = self._every.copy()
        mask[self._unknowns.of_contacts] = False
        factors = self._factors(x, self._balance.rows(x)[0], mask)
        undriven = dominant_joints(self.robot, factors.undriven(), self.motion.metric(x.q))
        labels = self._undetermined(factors, mask, factors.null_basis())
        return ActuationReach(
            factors.freedom, factors.driven, undriven, factors.null_space, labels
        )

    def _problem(self, x: State, a: Array, wrenches: Sequence[Array], stance: Mask) -> Problem:
        balance, unknowns = self._balance, self._unknowns
        balance.refresh(x)
        na = len(self.efforts.names)
        multipliers = balance.known_multipliers(x, a, stance)
        values = np.concatenate((np.full(na, np.nan), multipliers))
        J, drift = balance.rows(x)
        check_closed(balance, x)
        mask = np.isnan(values)[unknowns.place]
        factors = self._factors(x, J, mask)
        rows = np.flatnonzero(~self._drives)[mask[unknowns.efforts :]]
        check_rates(balance, factors, rows, (J, drift), x, a)
        known = unknowns.fill(np.nan_to_num(values), mask, np.zeros(int(mask.sum())))
        offset = np.zeros_like(a)
        if known.any():
            offset = J.T.dot(known[na:]) + balance.columns(x).dot(known[:na])
        terms = balance.terms(x, a, wrenches)
        b = terms.inertial + terms.bias - terms.loads - offset
        scale = sum(factors.norm(term) for term in (*terms, offset) if term.any())
        return Problem(factors, b, scale, mask, known)

    def _within_bounds(
        self, problem: Problem, unbounded: Split, r: Array, target: ForceTarget | None
    ) -> tuple[Split, Array]:
        """Return efforts and multipliers within their bounds, and the residual of free bases."""
        unknowns, mask, bases = self._unknowns, problem.mask, (self._R, r)
        limits = unknowns.limits(mask)
        if target is not None:
            target = unknowns.expand_target(mask, target)
        bounded = split_within_bounds(problem.factors, problem.b, unbounded, bases, limits, target)
        split = bounded.split
        if bounded.is_within:
            return split, bounded.residual
        y = np.concatenate((split.efforts, split.multipliers))
        names = join_names(unknowns.select_labels(mask, limits.passed(y, _RESIDUAL)))
        raise SolveError(
            f"the actuators cannot produce this motion within the bounds of {names}; widen these "
            "bounds or solve without bounds"
        )

    def _torques(self, problem: Problem, split: Split, r: Array) -> Torques:
        factors, mask, na = problem.factors, problem.mask, len(self.efforts.names)
        y = np.concatenate((split.efforts, split.multipliers))
        tau, multipliers = np.split(self._unknowns.fill(problem.known, mask, y), [na])
        null = factors.null_basis()
        bases = len(self.robot.base_v)
        return Torques(
            tau,
            multipliers,
            factors.rank,
            residual=r[:bases],
            null_space=factors.null_space,
            undetermined=self._undetermined(factors, mask, null),
            condition=factors.condition,
            null_basis=self._unknowns.basis(mask, null),
            root_residual=r[bases:],
        )

    def _factors(self, x: State, J: Array, mask: Mask) -> ForceSplit:
        E, rows = self._columns(x, J)
        n = self._unknowns.efforts
        return ForceSplit(self.motion.metric(x.q), E, rows[mask[n:]], self._usual[mask])

    def _columns(self, x: State, J: Array) -> tuple[Array, Array]:
        """Return the force of each effort per unit of cost, one a column, and the other rows."""
        E = np.concatenate((self._balance.columns(x), J[self._drives].T), axis=1)
        return E / self._unknowns.weight[: self._unknowns.efforts], J[~self._drives]

    def _metric_and_columns(self, q: Array) -> tuple[Array, Array]:
        """Return M and the columns of all unknowns at rest, (nv, nv) and (nv, n)."""
        x = State(0.0, q, np.zeros(int(self.robot.model.nv)))
        self._balance.refresh(x)
        E, rows = self._columns(x, self._balance.rows(x)[0])
        return self.motion.metric(q), np.concatenate((E, rows.T), axis=1)

    def _undetermined(self, factors: ForceSplit, mask: Mask, null: Array) -> tuple[str, ...]:
        if not factors.null_space:
            return ()
        return self._unknowns.select_labels(mask, factors.undetermined(null))

    def _factors_at(self, mask: Mask, x: State) -> ForceSplit:
        self._balance.refresh(x)
        return self._factors(x, self._balance.rows(x)[0], mask)


class Problem(NamedTuple):
    """Equation E e + J' lam = b at one state.

    Attributes:
        factors: Factorization of the left-hand side.
        b: Generalized force to split, shape (nv,).
        scale: Sum of the norms of the terms in b, in the metric M^-1.
        mask: Which unknowns the equation contains; the motion determines the others, shape (n,).
        known: Values of the others: inputs, then multipliers, with the targets of the cost in
            place of the unknowns, shape (na + m,).
    """

    factors: ForceSplit
    b: Array
    scale: float
    mask: Mask
    known: Array


class ObservedLoops:
    """Projects measured motion onto the constraints and solves it, sample by sample.

    It offers the interface of `SampleSolver` for mechanisms with loops.

    Args:
        inverse: The solver; this object owns it from now on.

    Attributes:
        couplings: The dependent joints.
        configuration: Projected configuration of the last sample, shape (nq,).
        needed: Joints that must be measured: none, as long as the loops determine them.
        rows: Names of the multipliers: the dependent joints, then the rows of the constraints.
        correction: Largest displacement of a joint by the projection [rad or m].
        prescribed_stance: Which features of contacts press; None to detect it from their geometry.
        motion: Projected state and acceleration of the last sample; None before the first one.
        gap: Residual of every bilateral row at the last sample as measured, shape (m,); 0 for
            couplings, see `TorqueEstimator.violation`, and for all other rows.
    """

    def __init__(self, inverse: ClosedLoopInverseDynamics) -> None:
        self.inverse = inverse
        self.couplings = inverse.couplings
        self.configuration = inverse.robot.neutral()
        self.correction = 0.0
        self._model = inverse.robot.model
        self.prescribed_stance: StanceMask | None = None
        self.motion: tuple[State, Array] | None = None
        self._slopes: Slopes = [0.0] * len(inverse.couplings.pairs)
        constraints = inverse.constraints
        self.rows = tuple(without_multiplier(row.name) for row in constraints.rows)
        self.gap = np.zeros(len(self.rows))
        self._k = Kinematics(inverse.robot)
        self._is_bilateral = np.zeros(len(self.rows), dtype=np.bool_)
        for part, mine in zip(constraints.parts, constraints.slices, strict=True):
            self._is_bilateral[mine] = part.law.kind is Kind.BILATERAL
        self.needed: tuple[str, ...] = ()

    def measured(
        self, t: float, position: Array, velocity: Array, acceleration: Array
    ) -> tuple[State, Array]:
        """Return state and acceleration of all joints from measured independent joints.

        Couplings hold, other constraints need not.

        Args:
            t: Time [s].
            position: y [rad or m], shape (ny,).
            velocity: y' [rad/s or m/s], shape (nv_y,).
            acceleration: y'' [rad/s^2 or m/s^2], shape (nv_y,).
        """
        couplings, nv = self.couplings, int(self._model.nv)
        q, v, a = np.empty(int(self._model.nq)), np.zeros(nv), np.zeros(nv)
        q[couplings.q_index] = position
        v[couplings.v_index], a[couplings.v_index] = velocity, acceleration
        couplings.expand(q, v, a, self._slopes)
        return State(t, q, v), a

    def solve(
        self, position: Array, velocity: Array, acceleration: Array, wrenches: Sequence[Array] = ()
    ) -> Torques:
        """Solve for the torques of the independent coordinates, 0 where no actuator acts.

        Args:
            position: y [rad or m], shape (ny,), near the constraints.
            velocity: y' [rad/s or m/s], shape (nv_y,).
            acceleration: y'' [rad/s^2 or m/s^2], shape (nv_y,).
            wrenches: One (6,) array [N, N·m] for every load of the scene; none means unloaded.

        Returns:
            New arrays; the multipliers are those of `rows`.

        Raises:
            SolveError: The mechanism cannot be assembled near this position, or the actuators
                cannot produce the motion.
        """
        measured, measured_a = self.measured(0.0, position, velocity, acceleration)
        self.gap = self._residual(measured)
        x, a = self.inverse.project_motion(measured, measured_a)
        self.configuration = x.q
        self.motion = x, a
        self.correction = float(
            np.abs(pin.difference(self._model, measured.q, x.q)).max(initial=0.0)
        )
        torques = self.inverse.solve(x, a, wrenches, self.prescribed_stance)
        B, n = self.inverse.columns(x), len(torques.tau)
        tau = B.dot(torques.tau)
        tau += self.inverse.unsupported_force(torques)
        reduced, _ = self.couplings.reduce(tau, self._slopes)
        null_forces, _ = self.couplings.reduce(B.dot(torques.null_basis[:n]), self._slopes)
        basis = np.concatenate((null_forces, torques.null_basis[n:]))
        return torques._replace(tau=reduced, null_basis=basis)

    def doubts(self) -> list[str]:
        """Return warnings about the validity of force terms at the last sample of `solve`."""
        if self.motion is None:
            return []
        x = self.motion[0]
        return [doubt for term in self.inverse.forces if (doubt := term.doubt(x))]

    def _residual(self, x: State) -> Array:
        self._k.refresh(x.q, x.v, Reads.POSITION)
        gap = self.inverse.constraints.residual(self._k, x)
        return np.where(self._is_bilateral, gap, 0.0)


def check_closed(balance: LoopBalance, x: State) -> None:
    """Check that a configuration satisfies the bilateral rows.

    Args:
        balance: The rows, refreshed at the state.
        x: State of all joints.

    Raises:
        SolveError: A row is violated; the message names it.
    """
    g = np.abs(balance.residual(x))
    if g.size and not g.max() <= ASSEMBLED:
        row = balance.constraints.rows[int(np.argmax(g))].name
        raise SolveError(
            f"the motion is not consistent: row {row} is {g.max():.3g} m or rad open; project the "
            "motion onto the constraints first"
        )


def check_rates(
    balance: LoopBalance,
    factors: ForceSplit,
    indices: NDArray[np.intp],
    rows: tuple[Array, Array],
    x: State,
    a: Array,
) -> None:
    """Check that velocity and acceleration satisfy the bilateral rows, except at toggles.

    Args:
        balance: The rows, refreshed at the state.
        factors: Factorization that contains some of the rows.
        indices: Indices of these rows.
        rows: J and drift of all rows, (m, nv) and (m,).
        x: State of all joints.
        a: Acceleration of all joints [rad/s^2 or m/s^2], shape (nv,).

    Raises:
        SolveError: A row is violated; the message names it.
    """
    bilateral, (J, drift) = balance.is_bilateral, rows
    if not bilateral.any():
        return
    for quantity, rates, bias in (("velocity", x.v, balance.rate(x)), ("acceleration", a, drift)):
        residual = np.where(bilateral, J.dot(rates) + bias, 0.0)
        terms = np.where(bilateral, np.abs(J).dot(np.abs(rates)) + np.abs(bias), 0.0)
        if not factors.violation(residual[indices], terms[indices]) <= _RATE_TOLERANCE:
            worst = int(np.argmax(np.abs(residual)))
            raise SolveError(
                f"the motion is not consistent: its {quantity} leaves row "
                f"{balance.constraints.rows[worst].name} at {abs(residual[worst]):.3g}; project "
                "the motion onto the constraints first"
            )


def is_at_toggle(
    loops: LoopMotion, x: State, factors: ForceSplit, factor: Callable[[State], ForceSplit]
) -> bool:
    """Return whether neighbouring states on the constraints have fewer degrees of freedom.

    Args:
        loops: The mechanism.
        x: State on the constraints.
        factors: Factorization at that state.
        factor: Function that factors another state on the constraints.
    """
    for motion in factors.motions().T:
        q = loops.integrate(x.q, _NEIGHBOUR / np.abs(motion).max() * motion)
        try:
            neighbour = State(x.t, loops.assemble(x._replace(q=q)), 0.0 * x.v)
        except SolveError:
            continue
        if factor(neighbour).freedom < factors.freedom:
            return True
    return False
