"""Motion of a mechanism with loops -> what its actuators and its constraints exert.

    M a + h - sum J_w' w - sum f = B u + J' lam + R r

with w the external wrenches, f the force terms, B the columns of the efforts u, J the rows of
couplings, constraints and contacts of unknown force, and R those of free bases. The residual r of
the bases is as small as it can be; then come the least costly u, then the smallest lam.
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
    Efforts,
    Mask,
    Reach,
    Unknowns,
    listed,
    movers,
    unreachable,
)
from mbd_ros.methods.inverse_dynamics.force_split import ForceSplit, Split, Wish, within_bounds
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import Torques
from mbd_ros.methods.inverse_dynamics.loop_motion import LoopBalance, LoopMotion, with_inertia
from mbd_ros.methods.inverse_dynamics.standing import Mask as StandingMask
from mbd_ros.methods.inverse_dynamics.standing import Nearness, Standing

_OFF = 1.0e-6  # of the terms that should cancel
_ASIDE = 0.1  # of a neighbour that tells whether a mechanism is at a toggle [rad or m]
_LEFT = 1.0e-6  # of the forces at work: what may stay without an actuator
_ZERO = 1.0e-9  # the same where nothing moves and nothing acts
_NOBODY = np.zeros(0, np.bool_)


class ClosedLoopInverseDynamics:
    """Inverse dynamics with rows, redundant or not, and any set of efforts.

    Efforts are exact where they are determined. Where they can work against one another, those of
    the least cost are taken: by default of the smallest Euclidean norm in SI numbers. Drives
    (prescribed motion) count as efforts in it. Given the efforts, multipliers of redundant rows
    have the smallest norm.

    Without bounds, stops and dry friction are part of the efforts, since a motion does not show
    their forces, and a limited drive may exceed its limit. With bounds their rows are unknowns
    that keep their law, and efforts stay within their bounds.

    Forces of contacts are unknown where they are named, and stay in their cones: features of flat
    feet only push, so that the centre of pressure stays between them.

    One instance owns its Pinocchio data: not for two threads. No result depends on earlier ones.

    Args:
        couplings: Its dependent joints; they become rows.
        constraints: Constraints of the scene.
        efforts: The unknown inputs.
        wrenches: External loads, in the order in which `solve` takes their values.
        forces: Force terms of the scene.
        with_bounds: Whether efforts and multipliers keep their bounds.
        contacts: Names of contacts of unknown force; the forces of others are loads.
        carriers: Joints that stand for a free base, see `standing.carriers`.
        near: What counts as on the ground.

    Attributes:
        couplings: Its dependent joints.
        standing: Says which features of the contacts press; None without such contacts.
        efforts: Those of `Torques.tau`.
        constraints: Rows of the multipliers: couplings, then constraints in the order of the
            scene; without bounds bilateral ones and drives alone.
        motion: Makes measured motion consistent.

    Raises:
        ModelError: With bounds, a law of multipliers that has none in numbers.
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
        carriers: Sequence[str] = (),
        near: Nearness | None = None,
    ) -> None:
        self.robot, self.couplings, self.efforts = robot, couplings, efforts
        self.carriers, self.forces = tuple(carriers), tuple(forces)
        self.motion = LoopMotion(with_inertia(robot), couplings, constraints)
        given, kept = (robot, couplings, constraints, efforts, wrenches, forces), with_bounds
        self._balance = LoopBalance(*given, with_bounds=kept, contacts=contacts)
        self.constraints, self._drives = self._balance.constraints, self._balance.is_drive
        self._unknowns = Unknowns(efforts, self.constraints, self._drives, with_bounds=kept)
        touching = self._balance.contacts
        self.standing = Standing(robot, touching, near) if touching else None
        self._limited = with_bounds or bool(touching)
        carried = [*robot.base_v, *(robot.joint(name).v for name in carriers)]
        self._every = np.ones(len(self._unknowns.labels), np.bool_)
        self._R = np.eye(int(robot.model.nv))[:, carried]
        self._usual = usual_norms(robot, self._metric_and_columns)

    def consistent(self, x: State, a: Array) -> tuple[State, Array]:
        """Measured motion moved onto the constraints; see `LoopMotion.consistent`."""
        return self.motion.consistent(x, a)

    def columns(self, x: State) -> Array:
        """B at a state, shape (nv, na)."""
        self._balance.place(x)
        return self._balance.columns(x)

    def carried(self, found: Torques) -> Array:
        """Generalized force that nothing exerts: the residual, on all joints, shape (nv,)."""
        force: Array = self._R.dot(np.concatenate((found.residual, found.carried)))
        return force

    def demand(self, x: State, a: Array, wrenches: Sequence[Array] = ()) -> Array:
        """M a + h - loads: what efforts and multipliers exert together, shape (nv,)."""
        self._balance.place(x)
        terms = self._balance.terms(x, a, wrenches)
        return terms.inertial + terms.bias - terms.loads

    def solve(
        self,
        x: State,
        a: Array,
        wrenches: Sequence[Array] = (),
        standing: Mask | None = None,
        wish: Wish | None = None,
    ) -> Torques:
        """Efforts and multipliers of one sample.

        Args:
            x: State of all joints, on the constraints.
            a: Acceleration of all joints that they allow [rad/s^2 or m/s^2], shape (nv,).
            wrenches: One (6,) array [N, N·m] for every load; none means unloaded.
            standing: Which features of contacts press; None for what their geometry says.
            wish: Of the multipliers of contacts, where these are not determined.

        Raises:
            SolveError: The motion is not consistent, or the efforts cannot produce it; names the
                row, the joints of the direction that nothing reaches, or the bounds in the way.
        """
        if not all(np.isfinite(values).all() for values in (x.q, x.v, a, *wrenches)):
            raise SolveError("motion or wrenches are not finite")
        if standing is None:
            standing = self.standing.at(x) if self.standing else _NOBODY
        problem = self._problem(x, a, wrenches, standing)
        split, b, accepted = problem.split, problem.b, _LEFT * problem.scale + _ZERO
        found, r = split.solve(b), np.zeros(self._R.shape[1])
        if len(r) and not found.share <= accepted:
            r = split.out_of_reach(b, self._R)
            found = split.solve(b - self._R.dot(r))
        if found.share <= accepted and self._limited:
            found, r = self._within(problem, found, r, wish)
        if not found.share <= accepted:
            labels = self._unknowns.labels[: self._unknowns.efforts]
            left = movers(self.robot, found.left[:, None], self.motion.metric(x.q))
            at_toggle = is_at_toggle(self.motion, x, split, partial(self._beside, problem.asked))
            raise SolveError(unreachable(labels, left, found.share / problem.scale, at_toggle))
        return self._torques(problem, found, r)

    def reach(self, x: State) -> Reach:
        """The reach of the efforts at a state on the constraints, bounds left aside."""
        self._balance.place(x)
        asked = self._every.copy()
        asked[self._unknowns.of_contacts] = False
        split = self._split(x, self._balance.rows(x)[0], asked)
        undriven = movers(self.robot, split.undriven(), self.motion.metric(x.q))
        labels = self._undetermined(split, asked, split.null_basis())
        return Reach(split.freedom, split.driven, undriven, split.null_space, labels)

    def _problem(self, x: State, a: Array, wrenches: Sequence[Array], standing: Mask) -> Problem:
        balance, unknowns = self._balance, self._unknowns
        balance.place(x)
        of_rows, na = balance.shown(x, a, standing), len(self.efforts.names)
        shown = np.concatenate((np.full(na, np.nan), of_rows))
        J, drift = balance.rows(x)
        check_closed(balance, x)
        asked = np.isnan(shown)[unknowns.place]
        split = self._split(x, J, asked)
        inside = np.flatnonzero(~self._drives)[asked[unknowns.efforts :]]
        check_rates(balance, split, inside, (J, drift), x, a)
        known = unknowns.filled(np.nan_to_num(shown), asked, np.zeros(int(asked.sum())))
        offset = np.zeros_like(a)
        if known.any():
            offset = J.T.dot(known[na:]) + balance.columns(x).dot(known[:na])
        terms = balance.terms(x, a, wrenches)
        b = terms.inertial + terms.bias - terms.loads - offset
        scale = sum(split.norm(term) for term in (*terms, offset) if term.any())
        return Problem(split, b, scale, asked, known)

    def _within(
        self, problem: Problem, found: Split, r: Array, wish: Wish | None
    ) -> tuple[Split, Array]:
        """Efforts and multipliers within their bounds, and the residual of free bases."""
        asked, unknowns = problem.asked, self._unknowns
        limits = unknowns.limits(asked)
        if wish is not None:
            wish = unknowns.wished(asked, wish)
        kept = within_bounds(problem.split, problem.b, found, (self._R, r), limits, wish)
        if kept.is_within:
            return kept.split, kept.residual
        y = np.concatenate((kept.split.efforts, kept.split.multipliers))
        names = listed(unknowns.named(asked, limits.passed(y, _LEFT)))
        raise SolveError(f"the bounds of {names} do not let the efforts produce this motion")

    def _torques(self, problem: Problem, found: Split, r: Array) -> Torques:
        split, asked, na = problem.split, problem.asked, len(self.efforts.names)
        y = np.concatenate((found.efforts, found.multipliers))
        tau, multipliers = np.split(self._unknowns.filled(problem.known, asked, y), [na])
        null = split.null_basis()
        about = split.null_space, self._undetermined(split, asked, null), split.condition
        basis = self._unknowns.basis(asked, null)
        bases = len(self.robot.base_v)
        return Torques(tau, multipliers, split.rank, r[:bases], *about, basis, r[bases:])

    def _split(self, x: State, J: Array, asked: Mask) -> ForceSplit:
        E, rows = self._columns(x, J)
        n = self._unknowns.efforts
        return ForceSplit(self.motion.metric(x.q), E, rows[asked[n:]], self._usual[asked])

    def _columns(self, x: State, J: Array) -> tuple[Array, Array]:
        """Forces of one unit of cost of every effort, one a column, and the other rows."""
        E = np.concatenate((self._balance.columns(x), J[self._drives].T), axis=1)
        return E / self._unknowns.weight[: self._unknowns.efforts], J[~self._drives]

    def _metric_and_columns(self, q: Array) -> tuple[Array, Array]:
        """M and the columns of all unknowns at rest, (nv, nv) and (nv, n)."""
        x = State(0.0, q, np.zeros(int(self.robot.model.nv)))
        self._balance.place(x)
        E, rows = self._columns(x, self._balance.rows(x)[0])
        return self.motion.metric(q), np.concatenate((E, rows.T), axis=1)

    def _undetermined(self, split: ForceSplit, asked: Mask, null: Array) -> tuple[str, ...]:
        return self._unknowns.named(asked, split.undetermined(null)) if split.null_space else ()

    def _beside(self, asked: Mask, x: State) -> ForceSplit:
        self._balance.place(x)
        return self._split(x, self._balance.rows(x)[0], asked)


class Problem(NamedTuple):
    """The equation at one state.

    Attributes:
        b: Force on all joints that is to be split, shape (nv,).
        scale: Size of the terms in it, in the metric of the split.
        asked: Which unknowns the split has; the motion shows the others, shape (n,).
        known: What those are: efforts, then multipliers, targets of the cost in place of those
            that are asked for, shape (na + m,).
    """

    split: ForceSplit
    b: Array
    scale: float
    asked: Mask
    known: Array


class ObservedLoops:
    """Makes a measured motion consistent, then solves it, sample by sample as `InverseDynamics`.

    Args:
        inverse: The solver, owned from now on.

    Attributes:
        couplings: The dependent joints.
        configuration: Consistent configuration of the last sample, shape (nq,).
        needed: Joints that must be measured: none, as long as the loops tie them to others.
        rows: Names of the multipliers: the dependent joints, then the rows of the constraints.
        moved: How far a joint of the last sample was moved onto the constraints [rad or m].
        told: Which features of contacts stand, where somebody says so; None for geometry.
        motion: State and acceleration of the last sample as it was solved; None before.
        gap: Residual of every row at the last sample as measured, shape (m,); 0 for couplings,
            whose violation stands elsewhere, and where the motion need not keep a row.
    """

    def __init__(self, inverse: ClosedLoopInverseDynamics) -> None:
        self.inverse, self.couplings = inverse, inverse.couplings
        self.configuration, self.moved = inverse.robot.neutral(), 0.0
        self._model = inverse.robot.model
        self.told: StandingMask | None = None
        self.motion: tuple[State, Array] | None = None
        self._slopes: Slopes = [0.0] * len(inverse.couplings.pairs)
        constraints = inverse.constraints
        self.rows = tuple(without_multiplier(row.name) for row in constraints.rows)
        self.gap = np.zeros(len(self.rows))
        self._k = Kinematics(inverse.robot)
        self._is_kept = np.zeros(len(self.rows), dtype=np.bool_)
        for part, mine in zip(constraints.parts, constraints.slices, strict=True):
            self._is_kept[mine] = part.law.kind is Kind.BILATERAL
        self.needed: tuple[str, ...] = ()

    def measured(
        self, t: float, position: Array, velocity: Array, acceleration: Array
    ) -> tuple[State, Array]:
        """State and acceleration of all joints as measured, couplings alone kept.

        Args:
            t: Time [s].
            position: Independent joints [rad or m], shape (ny,).
            velocity: [rad/s or m/s], shape (nv_y,).
            acceleration: [rad/s^2 or m/s^2], shape (nv_y,).
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
        """Torques of the independent coordinates of one sample, 0 where nothing acts.

        Args:
            position: y [rad or m], shape (ny,), near the constraints.
            velocity: y' [rad/s or m/s], shape (nv_y,).
            acceleration: y'' [rad/s^2 or m/s^2], shape (nv_y,).
            wrenches: One (6,) array [N, N·m] for every load of the scene; none means unloaded.

        Returns:
            Fresh arrays; multipliers of `rows`.

        Raises:
            SolveError: The mechanism cannot be assembled near this position, or the actuators
                cannot produce the motion.
        """
        measured, given = self.measured(0.0, position, velocity, acceleration)
        self.gap = self._residual(measured)
        x, a = self.inverse.consistent(measured, given)
        self.configuration, self.motion = x.q, (x, a)
        self.moved = float(np.abs(pin.difference(self._model, measured.q, x.q)).max(initial=0.0))
        found = self.inverse.solve(x, a, wrenches, self.told)
        B, n = self.inverse.columns(x), len(found.tau)
        tau = B.dot(found.tau)
        tau += self.inverse.carried(found)
        reduced, _ = self.couplings.reduce(tau, self._slopes)
        nothing, _ = self.couplings.reduce(B.dot(found.null_basis[:n]), self._slopes)
        basis = np.concatenate((nothing, found.null_basis[n:]))
        return found._replace(tau=reduced, null_basis=basis)

    def doubts(self) -> list[str]:
        """What is to be said about force terms at the last sample of `solve`."""
        if self.motion is None:
            return []
        x = self.motion[0]
        return [said for term in self.inverse.forces if (said := term.doubt(x))]

    def _residual(self, x: State) -> Array:
        self._k.refresh(x.q, x.v, Reads.POSITION)
        gap = self.inverse.constraints.residual(self._k, x)
        return np.where(self._is_kept, gap, 0.0)


def check_closed(balance: LoopBalance, x: State) -> None:
    """Check the position.

    Args:
        balance: The rows, placed at the state.
        x: State of all joints.

    Raises:
        SolveError: Names the row that is open.
    """
    g = np.abs(balance.residual(x))
    if g.size and not g.max() <= ASSEMBLED:
        row = balance.constraints.rows[int(np.argmax(g))].name
        raise SolveError(
            f"the motion is not consistent: row {row} is {g.max():.3g} m or rad open; make "
            "it consistent first"
        )


def check_rates(
    balance: LoopBalance,
    split: ForceSplit,
    inside: NDArray[np.intp],
    rows: tuple[Array, Array],
    x: State,
    a: Array,
) -> None:
    """Check velocity and acceleration, toggles apart.

    Args:
        balance: The rows, placed at the state.
        split: Factors of some rows.
        inside: Which rows these are.
        rows: J and drift of all rows, (m, nv) and (m,).
        x: State of all joints.
        a: Their acceleration [rad/s^2 or m/s^2], shape (nv,).

    Raises:
        SolveError: Names the row that either leaves.
    """
    held, (J, drift) = balance.is_held, rows
    if not held.any():
        return
    for what, of, fixed in (("velocity", x.v, balance.rate(x)), ("acceleration", a, drift)):
        off = np.where(held, J.dot(of) + fixed, 0.0)
        terms = np.where(held, np.abs(J).dot(np.abs(of)) + np.abs(fixed), 0.0)
        if not split.violation(off[inside], terms[inside]) <= _OFF:
            worst = int(np.argmax(np.abs(off)))
            raise SolveError(
                f"the motion is not consistent: its {what} leaves row "
                f"{balance.constraints.rows[worst].name} at {abs(off[worst]):.3g}; make it "
                "consistent first"
            )


def is_at_toggle(
    loops: LoopMotion, x: State, split: ForceSplit, beside: Callable[[State], ForceSplit]
) -> bool:
    """Whether neighbours on the constraints have fewer motions.

    Args:
        x: State on the constraints.
        beside: Gives the factors at another state on the constraints.
    """
    for motion in split.motions().T:
        q = loops.moved(x.q, _ASIDE / np.abs(motion).max() * motion)
        try:
            there = State(x.t, loops.start(x._replace(q=q)), 0.0 * x.v)
        except SolveError:
            continue
        if beside(there).freedom < split.freedom:
            return True
    return False
