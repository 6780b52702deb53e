"""Reconstruction of the states of all joints from samples of some, and its determinacy.

Velocities of a mechanism with rows satisfy J v = 0. With measured coordinates m and others u,
J_u v_u = -J_m v_m. Where J_u loses rank, at a dead centre, the measured coordinates do not
determine the others, and multipliers, by J_u' lam = (M a + h - tau)_u, are not determined either.

Source: C. Gosselin, J. Angeles, IEEE Trans. Robotics Automation 6(3) (1990), on these
singularities.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.state import NANOSECOND, Array, State
from mbd_ros.core.thresholds import TINY
from mbd_ros.errors import SolveError
from mbd_ros.methods.inverse_dynamics.torque_estimator import Tuning
from mbd_ros.methods.projection.assembly import assemble
from mbd_ros.methods.projection.state_projection import (
    Measurement,
    Prepared,
    ProjectedState,
    StateProjector,
)
from mbd_ros.methods.signals.differentiation import CausalDifferentiator, SampleStatus

_NEVER, _EVER = -(2**62), 2**62  # ns
_UNUSED = (SampleStatus.OLD, SampleStatus.JUMP, SampleStatus.NOT_FINITE)
_NOISY = 1_000_000  # ns: shortest interval for a speed, since noise dominates shorter ones
_STRIDE = 0.1  # [rad or m] per step, so that others can follow on their branch
_MOST_STRIDES = 100
_SAMPLES = 8  # of the path ahead
_HALVINGS = 10
_PAIR = 2  # rows of a planar loop
_BLIND = 1.0e12  # upper limit of reported amplifications


class StateReconstructor:
    """Projects a stream of joint samples, each of which may lack joints.

    A missing joint starts from its coupling, or from the last state, or from `initial` at the
    beginning, so that its branch is kept. A joint that nothing determines is held for `max_age`.

    Args:
        projector: Projector of samples to states, which is not shared.
        couplings: Couplings of the scene. A dependent joint whose position is not finite is
            missing; its jumps are violations of the coupling, not glitches.
        initial: State of all joints from which missing ones start.
        tuning: Limits for samples; the cutoff is for velocities that are not measured.

    Attributes:
        names: Joints of a sample, in the order of the velocities.
        missing: Names that the newest sample lacks.
        held_joints: Names of those that nothing determines.
    """

    def __init__(
        self,
        projector: StateProjector,
        couplings: Couplings,
        initial: State,
        tuning: Tuning,
    ) -> None:
        joints = sorted(projector.system.robot.joints, key=lambda joint: joint.v)
        self.names = tuple(joint.name for joint in joints)
        self._joints = joints
        self._projector = projector
        self._couplings = couplings
        self._all = np.ones(len(joints), dtype=np.bool_)
        self._ones = np.ones(len(joints))
        self._independent = np.zeros(len(joints), dtype=np.bool_)
        self._independent[couplings.v_index] = True
        self._start = self._assemble_start(initial)
        self.set_tuning(tuning)

    def set_tuning(self, tuning: Tuning) -> None:
        """Replace the tuning and discard the past."""
        limits = [joint.max_velocity * tuning.velocity_margin for joint in self._joints]
        wraps = [joint.kind == "continuous" for joint in self._joints]
        self._differentiator = CausalDifferentiator(
            cutoff=tuning.cutoff,
            velocity_limit=np.where(self._independent, limits, np.inf),
            wraps=np.array(wraps, dtype=np.bool_),
            patience=tuning.patience,
            rewind=tuning.rewind,
        )
        self._max_age = round(tuning.max_age / NANOSECOND)
        self.reset()

    def reset(self) -> None:
        """Discard the past."""
        self._differentiator.reset()
        self.missing: tuple[str, ...] = ()
        self.held_joints: tuple[str, ...] = ()
        self._last = self._start
        self._is_placed = self._can_start
        self._measured = self._start.q
        self._determined_at = np.full(
            len(self.names), _NEVER, dtype=np.int64
        )  # measured or determined
        self._measured_at = self._determined_at.copy()

    def observe(
        self, stamp: int, position: Array, velocity: Array, present: NDArray[np.bool_]
    ) -> ProjectedState | SampleStatus:
        """Add a sample.

        Args:
            stamp: Time [ns].
            position: Positions in the order of `names` [rad or m], NaN where absent.
            velocity: Velocities in the order of `names` [rad/s or m/s], NaN where absent.
            present: Which of `names` the message contains, shape (len(names),).

        Returns:
            The nearest consistent state, or the reason why the sample cannot be used.

        Raises:
            SolveError: There is no consistent state; the sample is discarded.
        """
        q, v, known, measured = position, velocity, self._all, self._all
        total = position.dot(self._ones) + velocity.dot(self._ones)
        if not (math.isfinite(total) and present.all()):
            known = present & (self._independent | np.isfinite(position))
            q, is_speed = self._fill_missing(position, known), np.isfinite(velocity)
            measured = known & (self._independent | is_speed)  # or derived, where independent
            v = np.where(measured, np.where(is_speed, velocity, np.nan), self._last.v)
        before, begin = self._differentiator.checkpoint(), self._measured
        try:
            outcome = self._judge(stamp, q, v, known, measured)
        except SolveError:
            self._differentiator.restore(before)
            self._measured = begin
            raise
        if isinstance(outcome, ProjectedState):
            self._measured_at[known] = stamp
            self._determined_at[known | ~outcome.undetermined] = stamp
            self._last = outcome.x
            self._is_placed = True
        return outcome

    def _judge(
        self, stamp: int, q: Array, v: Array, known: NDArray[np.bool_], measured: NDArray[np.bool_]
    ) -> ProjectedState | SampleStatus:
        """Check a sample without gaps, then project it."""
        self.missing = self.held_joints = ()
        prepared, d = None, self._differentiator
        if not (known is self._all or known.all()):
            if not np.isfinite(q).all():
                return SampleStatus.NOT_FINITE
            prepared = self._prepare(stamp, q, known, measured)
            if prepared is None:
                self._determined_at[known] = stamp
                return SampleStatus.INCOMPLETE
        since = np.where(known, np.maximum(stamp - self._measured_at, _NOISY), _EVER)
        outcome = d.update(stamp, q, v, since)
        if outcome in _UNUSED:
            return outcome
        x = State(stamp * NANOSECOND, d.position, d.velocity)
        return self._project(Measurement(x, known, measured), prepared, q)

    def _prepare(
        self, stamp: int, q: Array, known: NDArray[np.bool_], measured: NDArray[np.bool_]
    ) -> Prepared | None:
        """Prepare for missing joints; return None if one is neither determined nor recent."""
        self.missing = self._names_of(~known)
        m = Measurement(State(stamp * NANOSECOND, q, self._last.v), known, measured)
        prepared = self._projector.prepare(m)
        free = prepared.undetermined if self._is_placed else ~known
        self.held_joints = self._names_of(free)
        fresh = np.abs(stamp - self._determined_at[free]) <= self._max_age
        return prepared if fresh.all() else None

    def _project(self, m: Measurement, prepared: Prepared | None, filled: Array) -> ProjectedState:
        """Project in small strides, so that joints follow on their branch."""
        if prepared is None:
            self._measured = m.x.q
            return self._projector.project(m)
        begin = self._measured
        change = np.where(m.known, m.x.q - begin, 0.0)
        strides, q_last = _strides(change), self._last.q
        for i in range(1, strides):
            q = self._fill_missing(begin + (i / strides) * change, m.known, q_last)
            q_last = self._projector.project(m._replace(x=m.x._replace(q=q))).x.q
        self._measured = q = self._fill_missing(m.x.q, m.known, q_last)
        m = m._replace(x=m.x._replace(q=q))
        return self._projector.project(m, prepared if (q == filled).all() else None)

    def _assemble_start(self, initial: State) -> State:
        """Return the consistent state from which missing joints start, if there is one."""
        try:
            x = assemble(self._projector.system, initial)
        except SolveError:
            self._can_start = False
            return initial
        self._can_start = True
        return x

    def _fill_missing(
        self, q: Array, known: NDArray[np.bool_], last: Array | None = None
    ) -> Array:
        """Return a configuration whose unknown joints follow couplings, or keep their value."""
        q = np.where(known, q, self._last.q if last is None else last)
        for pair in () if known.all() else self._couplings.pairs:
            if not known[pair.child_v]:
                q[pair.child_q] = pair.function(q.item(pair.parent_q))[0]
        return q

    def _names_of(self, mask: NDArray[np.bool_]) -> tuple[str, ...]:
        return tuple(name for name, is_chosen in zip(self.names, mask, strict=True) if is_chosen)


def _strides(change: Array) -> int:
    return int(min(1.0 + np.abs(change).max() / _STRIDE, _MOST_STRIDES))


class Determinations:
    """Tests whether measurements determine the rows of a system, now and on its path.

    Args:
        measured: Joints that are measured.
        ahead: Time ahead that is tested [s].
        limit: Amplification that counts as singular.

    Attributes:
        is_needed: Whether there is anything to test: rows, and coordinates that are not measured.
    """

    def __init__(
        self, system: System, measured: Sequence[str], ahead: float = 0.05, limit: float = 100.0
    ) -> None:
        self._system = system
        self._ahead = ahead
        self._limit = limit
        nv = system.nv
        neutral = system.expand(State(0.0, system.reduce(_neutral(system)).q, np.zeros(nv)))
        is_known = np.zeros(nv, dtype=np.bool_)
        for name in measured:
            v = system.robot.joint(name).v
            is_known = is_known | _moves(system, neutral, v)
        self._known = np.flatnonzero(is_known)
        self._others = np.flatnonzero(~is_known)
        self.is_needed = bool(system.bilateral.rows) and len(self._others) > 0
        self._times = np.linspace(0.0, ahead, _SAMPLES + 1)[1:].tolist()

    def at(self, y: State, a: Array) -> Determination:
        """Return the determination at a state and on its path.

        Args:
            y: State as integrated.
            a: Its accelerations, shape (nv,).
        """
        if not self.is_needed:
            return Determination(0.0, 1.0, np.inf)
        J = self._rows(y)
        here, condition = self._amplified(J)
        if here > self._limit:
            return Determination(min(here, _BLIND), condition, 0.0)
        size = self._size(J)
        floor = abs(size) * here / self._limit  # amplifications grow as this falls
        before = 0.0
        for t in self._times:
            if self._is_beyond(y, a, t, size, floor):
                return Determination(
                    here, condition, self._crossing(y, a, (before, t), size, floor)
                )
            before = t
        return Determination(here, condition, np.inf)

    def _crossing(
        self, y: State, a: Array, between: tuple[float, float], size: float, floor: float
    ) -> float:
        """Return the first time between two at which rows are singular [s]."""
        low, high = between
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            if self._is_beyond(y, a, middle, size, floor):
                high = middle
            else:
                low = middle
        return high

    def _is_beyond(self, y: State, a: Array, t: float, size: float, floor: float) -> bool:
        there = self._size(self._rows(self._moved(y, a, t)))
        return there * np.sign(size) < floor

    def _moved(self, y: State, a: Array, t: float) -> State:
        q = self._system.chart.integrate(y.q, t * y.v + 0.5 * t * t * a)
        return y._replace(t=y.t + t, q=q)

    def _rows(self, y: State) -> Array:
        """Return the Jacobian of all bilateral rows."""
        return self._system.bilateral.jacobian(y.t, y.q)

    def _amplified(self, J: Array) -> tuple[float, float]:
        sizes = np.linalg.norm(J, axis=1, keepdims=True)
        J = J / np.maximum(sizes, TINY)
        others = J[:, self._others]
        values = np.linalg.svd(others, compute_uv=False)
        least = float(values[: len(self._others)][-1]) if len(values) else 0.0
        condition = float(np.linalg.norm(J, 2)) / max(least, TINY)
        reply = np.linalg.lstsq(others, J[:, self._known], rcond=None)[0]
        length = float(np.abs(reply).max(initial=0.0)) if least > 0.0 else _BLIND
        return length, min(condition, _BLIND)

    def _size(self, J: Array) -> float:
        """Return a measure that is 0 where rows are singular, with a sign where possible."""
        others = J[:, self._others]
        m, n = others.shape
        if m == n == _PAIR:
            (a, b), (c, d) = others.tolist()
            return float(a * d - b * c)
        if m == n:
            return float(np.linalg.det(others))
        return float(np.linalg.svd(others, compute_uv=False)[: min(m, n)][-1])


def _neutral(system: System) -> State:
    robot = system.robot
    return State(0.0, robot.neutral(), np.zeros(robot.model.nv))


def _moves(system: System, x: State, v: int) -> NDArray[np.bool_]:
    """Return which integrated coordinates move a joint, booleans of shape (nv,)."""
    moves = np.zeros(system.nv, dtype=np.bool_)
    y = system.reduce(x)
    for i, unit in enumerate(np.eye(system.nv)):
        moves[i] = system.expand(y._replace(v=unit)).v[v] != 0.0
    return moves


class Determination(NamedTuple):
    """How well measured coordinates determine the others.

    Attributes:
        amplification: Largest change of an unmeasured coordinate for a change of length one of the
            measured ones.
        of_multipliers: Condition number of the rows by unmeasured coordinates, the factor by which
            errors of forces grow.
        time: Time until a singular configuration on the path [s]; inf if there is none ahead.
    """

    amplification: float
    of_multipliers: float
    time: float
