"""Motion of a mechanism -> what its actuators and its constraints exert.

    M a + h - sum J_w' w - sum f = B u + J' lam + R r

with w the external wrenches, f the force terms, B the columns of the efforts u, J the rows of
couplings and constraints, and R those of free bases. The residual r of the bases is as small as
it can be; then come the least costly u, then the smallest lam.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.dynamics.external_wrench import ExternalWrench
from mbd_ros.core.inverse.bounded_split import within_bounds
from mbd_ros.core.inverse.consistency import check_closed, check_rates
from mbd_ros.core.inverse.efforts import Efforts
from mbd_ros.core.inverse.force_split import ForceSplit, Split
from mbd_ros.core.inverse.loop_balance import LoopBalance
from mbd_ros.core.inverse.loop_motion import LoopMotion, with_inertia
from mbd_ros.core.inverse.reach import Reach, listed, movers
from mbd_ros.core.inverse.torques import Torques
from mbd_ros.core.inverse.unknowns import Mask, Unknowns
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.parts import Load
from mbd_ros.core.rows.constraint import Constraint
from mbd_ros.core.rows.usual_sizes import usual_norms
from mbd_ros.core.state import Array, State
from mbd_ros.errors import SolveError

_LEFT = 1.0e-6  # of the forces at work: what may stay without an actuator
_ZERO = 1.0e-9  # the same where nothing moves and nothing acts
_ASIDE = 0.1  # of a neighbour that tells whether a mechanism is at a toggle [rad or m]


class _Problem(NamedTuple):
    """The equation at one state.

    Attributes:
        split: Its factors.
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


class ClosedLoopInverseDynamics:
    """Inverse dynamics with rows, redundant or not, and any set of efforts.

    Efforts are exact where they are determined. Where they can work against one another, those of
    the least cost are taken: by default of the smallest Euclidean norm in SI numbers. Drives
    (prescribed motion) count as efforts in it. Given the efforts, multipliers of redundant rows
    have the smallest norm.

    Without bounds, stops and dry friction are part of the efforts, since a motion does not show
    their forces, and a limited drive may exceed its limit. With bounds their rows are unknowns
    that keep their law, and efforts stay within their bounds.

    One instance owns its Pinocchio data: not for two threads. No result depends on earlier ones.

    Args:
        robot: The robot.
        couplings: Its dependent joints; they become rows.
        constraints: Constraints of the scene.
        efforts: The unknown inputs.
        wrenches: External loads, in the order in which `solve` takes their values.
        forces: Force terms of the scene.
        with_bounds: Whether efforts and multipliers keep their bounds.

    Attributes:
        robot: The robot.
        couplings: Its dependent joints.
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
    ) -> None:
        self.robot, self.couplings, self.efforts = robot, couplings, efforts
        self.motion = LoopMotion(with_inertia(robot), couplings, constraints)
        self._balance = LoopBalance(
            robot, couplings, constraints, efforts, wrenches, forces, with_bounds=with_bounds
        )
        self.constraints, self._drives = self._balance.constraints, self._balance.is_drive
        self._unknowns = Unknowns(efforts, self.constraints, self._drives)
        self._with_bounds, n = with_bounds, len(self._unknowns.labels)
        self._every, self._R = np.ones(n, np.bool_), np.eye(int(robot.model.nv))[:, robot.base_v]
        self._usual = usual_norms(robot, self._metric_and_columns)

    def consistent(self, x: State, a: Array) -> tuple[State, Array]:
        """Measured motion moved onto the constraints; see `LoopMotion.consistent`."""
        return self.motion.consistent(x, a)

    def columns(self, x: State) -> Array:
        """B at a state, shape (nv, na)."""
        self._balance.place(x)
        return self._balance.columns(x)

    def solve(self, x: State, a: Array, wrenches: Sequence[Array] = ()) -> Torques:
        """Efforts and multipliers of one sample.

        Args:
            x: State of all joints, on the constraints.
            a: Acceleration of all joints that they allow [rad/s^2 or m/s^2], shape (nv,).
            wrenches: One (6,) array [N, N·m] for every load; none means unloaded.

        Raises:
            SolveError: The motion is not consistent, or the efforts cannot produce it; names the
                row, the joints of the direction that nothing reaches, or the bounds in the way.
        """
        if not all(np.isfinite(values).all() for values in (x.q, x.v, a, *wrenches)):
            raise SolveError("motion or wrenches are not finite")
        problem = self._problem(x, a, wrenches)
        split, b, accepted = problem.split, problem.b, _LEFT * problem.scale + _ZERO
        found, r = split.solve(b), np.zeros(self._R.shape[1])
        if len(r) and not found.share <= accepted:
            r = split.out_of_reach(b, self._R)
            found = split.solve(b - self._R.dot(r))
        if found.share <= accepted and self._with_bounds:
            found, r = self._within(problem, found, r)
        if not found.share <= accepted:
            raise SolveError(self._unreachable(found, problem, x))
        return self._torques(problem, found, r)

    def reach(self, x: State) -> Reach:
        """The reach of the efforts at a state on the constraints, bounds left aside."""
        self._balance.place(x)
        split = self._split(x, self._balance.rows(x)[0], self._every)
        undriven = movers(self.robot, split.undriven(), self.motion.metric(x.q))
        labels = self._undetermined(split, self._every, split.null_basis())
        return Reach(split.freedom, split.driven, undriven, split.null_space, labels)

    def _problem(self, x: State, a: Array, wrenches: Sequence[Array]) -> _Problem:
        balance, unknowns = self._balance, self._unknowns
        balance.place(x)
        shown = np.concatenate((np.full(len(self.efforts.names), np.nan), balance.shown(x, a)))
        J, drift = balance.rows(x)
        check_closed(balance, x)
        asked = np.isnan(shown)[unknowns.place]
        split = self._split(x, J, asked)
        inside = np.flatnonzero(~self._drives)[asked[unknowns.efforts :]]
        check_rates(balance, split, inside, (J, drift), x, a)
        known = unknowns.filled(np.nan_to_num(shown), asked, np.zeros(int(asked.sum())))
        offset, na = np.zeros_like(a), len(self.efforts.names)
        if known.any():
            offset = J.T.dot(known[na:]) + balance.columns(x).dot(known[:na])
        terms = balance.terms(x, a, wrenches)
        b = terms.inertial + terms.bias - terms.loads - offset
        scale = sum(split.norm(term) for term in (*terms, offset) if term.any())
        return _Problem(split, b, scale, asked, known)

    def _within(self, problem: _Problem, found: Split, r: Array) -> tuple[Split, Array]:
        """Efforts and multipliers within their bounds, and the residual of free bases."""
        asked, unknowns = problem.asked, self._unknowns
        ends = unknowns.ends(asked)
        kept = within_bounds(problem.split, problem.b, found, (self._R, r), ends)
        if kept.is_within:
            return kept.split, kept.residual
        y = np.concatenate((kept.split.efforts, kept.split.multipliers))
        passed = np.maximum(ends[0] - y, y - ends[1]) > _LEFT * np.abs(y).max()
        names = listed(unknowns.named(asked, passed))
        raise SolveError(f"the bounds of {names} do not let the efforts produce this motion")

    def _torques(self, problem: _Problem, found: Split, r: Array) -> Torques:
        split, asked, na = problem.split, problem.asked, len(self.efforts.names)
        y = np.concatenate((found.efforts, found.multipliers))
        tau, multipliers = np.split(self._unknowns.filled(problem.known, asked, y), [na])
        null = split.null_basis()
        about = split.null_space, self._undetermined(split, asked, null), split.condition
        basis = self._unknowns.basis(asked, null)
        return Torques(tau, multipliers, split.rank, r, *about, basis)

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

    def _unreachable(self, found: Split, problem: _Problem, x: State) -> str:
        names = movers(self.robot, found.left[:, None], self.motion.metric(x.q))
        labels = self._unknowns.labels[: self._unknowns.efforts]
        by = ", ".join(label.rpartition(".")[0] for label in labels)
        toggle = "; the mechanism is at a toggle" if self._is_at_toggle(x, problem) else ""
        return (
            f"the actuators ({by or 'none'}) cannot produce this motion: "
            f"{found.share / problem.scale:.2g} of the forces at work are without an actuator, "
            f"along {', '.join(names)}; these need an actuator, or the motion better derivatives"
            f"{toggle}"
        )

    def _is_at_toggle(self, x: State, problem: _Problem) -> bool:
        """Whether neighbours on the constraints have fewer motions."""
        for motion in problem.split.motions().T:
            away = _ASIDE / np.abs(motion).max() * motion
            q = pin.integrate(self.robot.model, x.q, away)
            try:
                beside = State(x.t, self.motion.start(x._replace(q=q)), 0.0 * x.v)
            except SolveError:
                continue
            self._balance.place(beside)
            split = self._split(beside, self._balance.rows(beside)[0], problem.asked)
            if split.freedom < problem.split.freedom:
                return True
        return False
