"""Samples of some joints -> states of all joints, consistent and within limits."""

import math

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.state import NANOSECOND, Array, State
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
_NOISY = 1_000_000  # ns: within less, noise looks like speed
_STRIDE = 0.1  # [rad or m] that joints move at most while others have to follow on their branch
_MOST_STRIDES = 100


class StateReconstructor:
    """Projects a stream of joint samples, each of which may lack joints.

    A missing joint starts from its coupling, or else from the last state, at the beginning from
    `initial`, so that its branch is kept. A joint that nothing determines is held for `max_age`.

    Args:
        projector: Samples to states; owned by the reconstructor from now on.
        couplings: Those of the scene. A dependent joint whose position is not finite is missing,
            and its jumps are no glitches but violations.
        initial: State of all joints from which missing ones start.
        tuning: How samples are judged; the cutoff is that of velocities that are not measured.

    Attributes:
        names: Joints of a sample, in the order of the velocities.
        missing: Names that the newest sample lacks.
        held: Those among them that nothing determines.
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
        self._joints, self._projector = joints, projector
        self._couplings = couplings
        self._all, self._ones = np.ones(len(joints), dtype=np.bool_), np.ones(len(joints))
        self._independent = np.zeros(len(joints), dtype=np.bool_)
        self._independent[couplings.v_index] = True
        self._start = self._assembled(initial)
        self.tune(tuning)

    def tune(self, tuning: Tuning) -> None:
        """Replace the tuning; the past is forgotten."""
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
        """Forget the past."""
        self._differentiator.reset()
        self.missing: tuple[str, ...] = ()
        self.held: tuple[str, ...] = ()
        self._last, self._is_placed = self._start, self._can_start
        self._measured = self._start.q
        self._seen = np.full(len(self.names), _NEVER, dtype=np.int64)  # measured or determined
        self._measured_at = self._seen.copy()

    def observe(
        self, stamp: int, position: Array, velocity: Array, present: NDArray[np.bool_]
    ) -> ProjectedState | SampleStatus:
        """Take a sample.

        Args:
            stamp: Time [ns].
            position: In the order of `names` [rad or m], NaN where absent.
            velocity: In the order of `names` [rad/s or m/s], NaN where absent.
            present: Which of `names` the message carries, shape (len(names),).

        Returns:
            The nearest consistent state, or why the sample cannot be used.

        Raises:
            SolveError: There is none; the sample leaves nothing behind.
        """
        q, v, known, measured = position, velocity, self._all, self._all
        total = position.dot(self._ones) + velocity.dot(self._ones)
        if not (math.isfinite(total) and present.all()):
            known = present & (self._independent | np.isfinite(position))
            q, is_speed = self._filled(position, known), np.isfinite(velocity)
            measured = known & (self._independent | is_speed)  # or derived, where independent
            v = np.where(measured, np.where(is_speed, velocity, np.nan), self._last.v)
        before, begin = self._differentiator.memory, self._measured
        try:
            found = self._take(stamp, q, v, known, measured)
        except SolveError:
            self._differentiator.memory, self._measured = before, begin
            raise
        if isinstance(found, ProjectedState):
            self._measured_at[known] = stamp
            self._seen[known | ~found.undetermined] = stamp
            self._last, self._is_placed = found.x, True
        return found

    def _take(
        self, stamp: int, q: Array, v: Array, known: NDArray[np.bool_], measured: NDArray[np.bool_]
    ) -> ProjectedState | SampleStatus:
        """Judge a sample whose holes are filled, then project it."""
        self.missing = self.held = ()
        prepared, d = None, self._differentiator
        if not (known is self._all or known.all()):
            if not np.isfinite(q).all():
                return SampleStatus.NOT_FINITE
            prepared = self._prepared(stamp, q, known, measured)
            if prepared is None:
                self._seen[known] = stamp
                return SampleStatus.INCOMPLETE
        since = np.where(known, np.maximum(stamp - self._measured_at, _NOISY), _EVER)
        outcome = d.update(stamp, q, v, since)
        if outcome in _UNUSED:
            return outcome
        x = State(stamp * NANOSECOND, d.position, d.velocity)
        return self._project(Measurement(x, known, measured), prepared, q)

    def _prepared(
        self, stamp: int, q: Array, known: NDArray[np.bool_], measured: NDArray[np.bool_]
    ) -> Prepared | None:
        """Note what is missing; None where it is neither determined nor was known not long ago."""
        self.missing = self._named(~known)
        m = Measurement(State(stamp * NANOSECOND, q, self._last.v), known, measured)
        prepared = self._projector.prepare(m)
        free = prepared.undetermined if self._is_placed else ~known
        self.held = self._named(free)
        fresh = np.abs(stamp - self._seen[free]) <= self._max_age
        return prepared if fresh.all() else None

    def _project(self, m: Measurement, prepared: Prepared | None, filled: Array) -> ProjectedState:
        """In small strides, where joints have to follow on their branch."""
        if prepared is None:
            self._measured = m.x.q
            return self._projector.project(m)
        begin = self._measured
        change = np.where(m.known, m.x.q - begin, 0.0)
        strides, reached = _strides(change), self._last.q
        for i in range(1, strides):
            q = self._filled(begin + (i / strides) * change, m.known, reached)
            reached = self._projector.project(m._replace(x=m.x._replace(q=q))).x.q
        self._measured = q = self._filled(m.x.q, m.known, reached)
        m = m._replace(x=m.x._replace(q=q))
        return self._projector.project(m, prepared if (q == filled).all() else None)

    def _assembled(self, initial: State) -> State:
        """The consistent state from which missing joints start, if the mechanism closes there."""
        try:
            x = assemble(self._projector.system, initial)
        except SolveError:
            self._can_start = False
            return initial
        self._can_start = True
        return x

    def _filled(self, q: Array, known: NDArray[np.bool_], last: Array | None = None) -> Array:
        """A configuration whose unknown joints follow their coupling, or stay at the last one."""
        q = np.where(known, q, self._last.q if last is None else last)
        for pair in () if known.all() else self._couplings.pairs:
            if not known[pair.child_v]:
                q[pair.child_q] = pair.function(q.item(pair.parent_q))[0]
        return q

    def _named(self, chosen: NDArray[np.bool_]) -> tuple[str, ...]:
        return tuple(name for name, is_one in zip(self.names, chosen, strict=True) if is_one)


def _strides(change: Array) -> int:
    return int(min(1.0 + np.abs(change).max() / _STRIDE, _MOST_STRIDES))
