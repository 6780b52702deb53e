"""Motion of a mechanism with loops -> efforts of its actuators and all multipliers.

    M a + h - sum J_w' w - sum f = S' tau + J' lam

with w the external wrenches, f the force terms, S the actuated joints and J the bilateral rows,
couplings among them.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.core.dynamics.external_wrench import ExternalWrench
from mbd_ros.core.inverse.force_split import ForceSplit, Split
from mbd_ros.core.inverse.loop_balance import LoopBalance
from mbd_ros.core.inverse.loop_motion import LoopMotion, with_inertia
from mbd_ros.core.inverse.reach import Reach
from mbd_ros.core.inverse.torques import Torques
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.parts import Constraint, Load
from mbd_ros.core.rows.usual_sizes import usual_norms
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import ASSEMBLED, TINY
from mbd_ros.errors import ModelError, SolveError

_OFF = 1.0e-6  # of the terms that should cancel: velocity and acceleration off the rows
_LEFT = 1.0e-6  # of the forces at work: what may stay without an actuator
_ZERO = 1.0e-9  # the same where nothing moves and nothing acts
_NAMED = 0.3  # share of a joint in a direction, of the largest, to be named
_BESIDE = 1.0e-2  # rad or m: the neighbourhood of a state, to tell a toggle from a freedom
_SHOWN = 4  # joints in a message
_DIGITS = 9  # of shares that differ; beyond them is rounding


class ClosedLoopInverseDynamics:
    """Inverse dynamics with bilateral rows, redundant or not, and any set of actuators.

    Efforts are exact where they are determined. Where actuators can work against one another
    they have the smallest Euclidean norm in SI numbers; drives (prescribed motion) count as
    actuators in it. Given the efforts, multipliers of redundant rows have the smallest norm.
    A motion does not show the forces of bounded rows, stops and dry friction: they are part of the
    efforts. A limited drive counts as an actuator that may exceed its limit.

    One instance owns its Pinocchio data: not for two threads.

    Args:
        robot: The robot.
        couplings: Its dependent joints; they become rows.
        constraints: Constraints of the scene.
        actuated: Joints that carry an actuator.
        wrenches: External loads, in the order in which `solve` takes their values.
        forces: Force terms of the scene.

    Attributes:
        robot: The robot.
        couplings: Its dependent joints.
        actuated: Joints of `Torques.tau`.
        constraints: Rows of the multipliers: couplings, then bilateral constraints and limited
            drives in the order of the scene.
        motion: Makes measured motion consistent.

    Raises:
        ModelError: Unknown or repeated actuated joint.
    """

    def __init__(
        self,
        robot: Robot,
        couplings: Couplings,
        constraints: Sequence[Constraint],
        actuated: Sequence[str],
        wrenches: Sequence[ExternalWrench] = (),
        forces: Sequence[Load] = (),
    ) -> None:
        if len(set(actuated)) < len(actuated):
            raise ModelError(f"actuated joints {', '.join(actuated)} must be different joints")
        self.robot, self.couplings, self.actuated = robot, couplings, tuple(actuated)
        self.motion = LoopMotion(with_inertia(robot), couplings, constraints)
        self._balance = LoopBalance(robot, couplings, constraints, wrenches, forces)
        self.constraints = self._balance.constraints
        self._drives = self._balance.is_drive
        self._na, rows = len(self.actuated), self.constraints.rows
        drives = int(self._drives.sum())
        self._E = np.zeros((int(robot.model.nv), self._na + drives))
        self._E[[robot.joint(name).v for name in actuated], range(self._na)] = 1.0
        names = np.array([f"{row.name}.multiplier" for row in rows], dtype=np.object_)
        efforts = [f"{name}.effort" for name in actuated]
        self._labels = (*efforts, *names[self._drives], *names[~self._drives])
        self._names = {joint.v: joint.name for joint in robot.joints}
        self._usual = usual_norms(robot, self._columns)

    def consistent(self, x: State, a: Array) -> tuple[State, Array]:
        """Measured motion moved onto the constraints; see `LoopMotion.consistent`."""
        return self.motion.consistent(x, a)

    def solve(self, x: State, a: Array, wrenches: Sequence[Array] = ()) -> Torques:
        """Efforts and multipliers of one sample.

        Args:
            x: State of all joints, on the constraints.
            a: Acceleration of all joints that they allow [rad/s^2 or m/s^2], shape (nv,).
            wrenches: One (6,) array [N, N·m] for every load; none means unloaded.

        Raises:
            SolveError: The motion is not consistent, or the actuators cannot produce it; names
                the row, or the joints of the direction that nothing reaches.
        """
        if not all(np.isfinite(values).all() for values in (x.q, x.v, a, *wrenches)):
            raise SolveError("motion or wrenches are not finite")
        self._balance.place(x)
        J, drift = self._balance.rows(x)
        self._check_closed(x)
        terms = self._balance.terms(x, a, wrenches)
        split = self._split(x, J)
        self._check_rates(split, J, drift, x, a)
        found = split.solve(terms.inertial + terms.bias - terms.loads)
        scale = sum(split.norm(term) for term in terms)
        if not found.share <= _LEFT * scale + _ZERO:
            reason = self._unreachable(found, scale, x)
            toggle = "; the mechanism is at a toggle" if self._is_toggle(x, split) else ""
            raise SolveError(reason + toggle)
        tau, drives = np.split(found.efforts, [self._na])
        multipliers = np.empty(len(self._drives))
        multipliers[self._drives], multipliers[~self._drives] = drives, found.multipliers
        null_space, labels = split.null_space, self._undetermined(split)
        return Torques(tau, multipliers, null_space, labels, split.condition)

    def reach(self, x: State) -> Reach:
        """The reach of the actuators at a state on the constraints."""
        self._balance.place(x)
        split = self._split(x, self._balance.rows(x)[0])
        undriven = self._movers(split.undriven(), x)
        labels = self._undetermined(split)
        return Reach(split.freedom, split.driven, undriven, split.null_space, labels)

    def _split(self, x: State, J: Array) -> ForceSplit:
        self._E[:, self._na :] = J[self._drives].T
        return ForceSplit(self.motion.metric(x.q), self._E, J[~self._drives], self._usual)

    def _columns(self, q: Array) -> tuple[Array, Array]:
        """M and the columns of efforts, drives and other rows at a configuration."""
        x = State(0.0, q, np.zeros(len(self._E)))
        self._balance.place(x)
        J = self._balance.rows(x)[0]
        efforts = self._E[:, : self._na]
        columns = (efforts, J[self._drives].T, J[~self._drives].T)
        return self.motion.metric(q), np.concatenate(columns, axis=1)

    def _is_toggle(self, x: State, split: ForceSplit) -> bool:
        """Whether the rows allow fewer motions a little further on."""
        away = np.full(len(self._E), _BESIDE)
        try:
            q = self.motion.start(x._replace(q=pin.integrate(self.robot.model, x.q, away)))
            beside = x._replace(q=q)
            self._balance.place(beside)
            return self._split(beside, self._balance.rows(beside)[0]).freedom < split.freedom
        except SolveError:
            return False

    def _check_closed(self, x: State) -> None:
        g = np.abs(self._balance.residual(x))
        if g.size and not g.max() <= ASSEMBLED:
            row = self.constraints.rows[int(np.argmax(g))].name
            raise SolveError(
                f"the motion is not consistent: row {row} is {g.max():.3g} m or rad open; make "
                "it consistent first"
            )

    def _check_rates(self, split: ForceSplit, J: Array, drift: Array, x: State, a: Array) -> None:
        """Raise where velocity or acceleration leaves the rows, toggles apart."""
        rows = ~self._drives
        if not rows.any():
            return
        rate = self._balance.rate(x)
        for what, of, fixed in (("velocity", x.v, rate), ("acceleration", a, drift)):
            off = J[rows].dot(of) + fixed[rows]
            terms = np.abs(J[rows]).dot(np.abs(of)) + np.abs(fixed[rows])
            if not split.violation(off, terms) <= _OFF:
                worst = int(np.argmax(np.abs(off)))
                row = np.array(self.constraints.rows, dtype=np.object_)[rows][worst]
                raise SolveError(
                    f"the motion is not consistent: its {what} leaves row {row[0]} at "
                    f"{abs(off[worst]):.3g}; make it consistent first"
                )

    def _undetermined(self, split: ForceSplit) -> tuple[str, ...]:
        if not split.null_space:
            return ()
        pairs = zip(self._labels, np.concatenate(split.undetermined()), strict=True)
        return tuple(label for label, takes_part in pairs if takes_part)

    def _unreachable(self, found: Split, scale: float, x: State) -> str:
        movers = self._movers(found.left[:, None], x)
        by = ", ".join(label.rpartition(".")[0] for label in self._labels[: self._E.shape[1]])
        return (
            f"the actuators ({by or 'none'}) cannot produce this motion: "
            f"{found.share / scale:.2g} of the forces at work are without an actuator, along "
            f"{', '.join(movers)}; these need an actuator, or the motion better derivatives"
        )

    def _movers(self, directions: Array, x: State) -> tuple[str, ...]:
        """Joints that carry most of some motions, one a column, by kinetic energy.

        Equal ones stand in the order of the robot, independent of rounding.
        """
        inertia = np.sqrt(self.motion.metric(x.q).diagonal())
        share: Any = inertia * np.linalg.norm(directions, axis=1)
        share = np.round(share / max(share.max(), TINY), _DIGITS)
        order = np.argsort(-share, kind="stable")
        chosen = [int(i) for i in order if share[i] > _NAMED * share.max() > 0.0]
        names = dict.fromkeys(self._names.get(i, "the floating base") for i in chosen)
        return tuple(names)[:_SHOWN]
