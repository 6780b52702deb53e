"""Joint-state samples -> torques: the causal estimate, live and offline alike."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.kinematics.poses import TWIST, configuration_of, step_between, with_sign_of
from mbd_ros.core.model.couplings import Couplings, IndependentCoordinates
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Unit, Within
from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import SolveError
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import SampleSolver, Torques
from mbd_ros.methods.signals.differentiation import CausalDifferentiator, SampleStatus

_NEVER = -(2**62)
_UNUSED = (SampleStatus.OLD, SampleStatus.JUMP, SampleStatus.NOT_FINITE, SampleStatus.INCOMPLETE)


class JointObserver:
    """Judges a stream of samples and derives missing velocities and accelerations.

    A free body is filtered in the coordinates of its twist: the sum of the steps from pose to
    pose, each in axes of the body. A constant twist passes any filter as it is.

    Args:
        couplings: Its dependent joints, which may be missing.
        tuning: How samples are judged and filtered.

    Attributes:
        names: Joints of a sample: the independent ones, then the dependent ones.
        differentiator: Where velocity and acceleration come from.
        outcome: Verdict on the newest sample.
    """

    def __init__(self, robot: Robot, couplings: Couplings, tuning: Tuning) -> None:
        self._robot, self._coordinates = robot, IndependentCoordinates(robot, couplings)
        self.names = couplings.independent + couplings.dependent
        self._n = len(couplings.independent)
        self._size = self._n + TWIST * len(robot.bases)
        self._independent = [robot.joint(name) for name in couplings.independent]
        self._present, self._is_complete = np.zeros(len(self.names), dtype=np.bool_), False
        self.tune(tuning)

    def tune(self, tuning: Tuning) -> None:
        """Replace the tuning; the filters start again."""
        limits = np.array([joint.max_velocity for joint in self._independent])
        with np.errstate(over="ignore"):  # a limit near the largest number is none
            limits *= tuning.velocity_margin
        continuous = [joint.kind == "continuous" for joint in self._independent]
        bodies = self._size - self._n
        self.differentiator = CausalDifferentiator(
            cutoff=tuning.cutoff,
            velocity_limit=np.append(limits, np.full(bodies, np.inf)),
            wraps=np.array(continuous + [False] * bodies, dtype=np.bool_),
            patience=tuning.patience,
            rewind=tuning.rewind,
        )
        self._max_age = round(tuning.max_age / NANOSECOND)
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.differentiator.reset()
        self.outcome = SampleStatus.USED
        self._position, self._velocity = np.zeros(self._size), np.full(self._size, np.nan)
        self._seen = np.full(self._size, _NEVER, dtype=np.int64)
        self._poses: Array | None = None  # of the newest sample that is used
        self._complete: int | None = None  # stamp of a complete sample since the last partial one

    @property
    def memory(self) -> tuple[Any, ...]:
        """State on which the next samples depend; may be set, to its value before a sample."""
        kept = self._position, self._velocity, self._complete, self._seen, self._poses
        return kept, self.differentiator.memory

    @memory.setter
    def memory(self, memory: tuple[Any, ...]) -> None:
        kept, self.differentiator.memory = memory
        self._position, self._velocity, self._complete, self._seen, self._poses = kept

    def observe(
        self,
        stamp: int,
        position: Array,
        velocity: Array,
        present: NDArray[np.bool_],
        bodies: tuple[Array, Array] | None = None,
    ) -> Observation | SampleStatus:
        """Take a sample of the motion.

        Args:
            stamp: Time [ns].
            position: In the order of `names` [rad or m], NaN where absent.
            velocity: In the order of `names` [rad/s or m/s], NaN where absent.
            present: Which of `names` the message carries, shape (len(names),); the same array as
                long as that does not change.
            bodies: Poses of the free bodies in the world, shape (k, 7), and their twists, NaN
                where not measured, shape (k, 6); None without free bodies.

        Returns:
            The sample with its derivatives, or why it cannot be used.
        """
        n, poses = self._n, None
        z, v = position[:n], velocity[:n]
        if bodies is not None:
            poses, steps = self._placed(bodies[0])
            z, v = np.concatenate((z, steps)), np.concatenate((v, bodies[1].ravel()))
        if present is not self._present:
            self._present, self._is_complete = present, bool(present[:n].all())
        if self._is_complete:
            self.outcome = outcome = self.differentiator.update(stamp, z, v)
            if outcome in _UNUSED:
                return outcome
            self._position, self._velocity, self._complete = z, v, stamp
        else:
            of_bodies = np.ones(self._size - n, dtype=np.bool_)
            known = np.concatenate((present[:n], of_bodies))
            self.outcome = outcome = self._take_part(stamp, z, v, known)
            if outcome in _UNUSED:
                return outcome
        d, dependent = self.differentiator, position[n:]
        if poses is None:
            return Observation(stamp, d.position, d.velocity, d.acceleration, dependent)
        self._poses, c = poses, self._coordinates
        y = c.positions(np.concatenate((d.position[:n], poses.ravel())))
        return Observation(stamp, y, c.rates(d.velocity), c.rates(d.acceleration), dependent)

    def observe_all(
        self, stamps: NDArray[np.int64], position: Array, velocity: Array
    ) -> Observations | None:
        """Take many samples at once, as `observe` one by one, to rounding.

        Args:
            stamps: Times [ns], shape (m,), m > 0.
            position: Columns in the order of `names` [rad or m], NaN where absent.
            velocity: The same [rad/s or m/s].

        Returns:
            The samples; None, and nothing is taken, where they have to be taken one by one: at a
            beginning, with free bodies, and where one is not complete or may not be used.
        """
        n = self._n
        if self._robot.bases or not np.isfinite(position[:, :n]).all():
            return None
        found = self.differentiator.update_all(stamps, position[:, :n], velocity[:, :n])
        if found is None:
            return None
        self.outcome, self._complete = SampleStatus.USED, int(stamps[-1])
        self._position, self._velocity = position[-1, :n], velocity[-1, :n]
        return Observations(stamps, *found, position[:, n:])

    def _placed(self, poses: Array) -> tuple[Array, Array]:
        """Coordinates of the free bodies, (k, 7), and the sums of the steps that lead there."""
        q, before = configuration_of(self._robot, poses), self._poses
        if before is None or not np.isfinite(q).all():
            return q, 0.0 * q[:, 1:].ravel()  # NaN stays
        pairs = list(zip(before, q, strict=True))
        steps = np.concatenate([step_between(*pair) for pair in pairs])
        signed = np.array([with_sign_of(*pair) for pair in pairs])
        return signed, self.differentiator.position[self._n :] + steps

    def _take_part(
        self, stamp: int, z: Array, v: Array, present: NDArray[np.bool_]
    ) -> SampleStatus:
        """Take a sample that lacks joints; missing ones keep their last position for `max_age`."""
        if not np.isfinite(z[present]).all():
            return SampleStatus.NOT_FINITE
        self._seen = self._seen.copy()
        if self._complete is not None:
            self._seen[:], self._complete = self._complete, None
        z, v = np.where(present, z, self._position), np.where(present, v, self._velocity)
        since, outcome = stamp - self._seen, SampleStatus.INCOMPLETE
        if int(np.abs(since[~present]).max()) <= self._max_age:
            outcome = self.differentiator.update(stamp, z, v, since)
            if outcome in _UNUSED:
                return outcome
        self._position, self._velocity = z, v
        self._seen[present] = stamp
        return outcome


class TorqueEstimator(JointObserver):
    """Causal inverse dynamics on a stream of joint samples.

    Args:
        inverse: Solver, owned by the estimator from now on.
        tuning: How samples are judged and filtered.
    """

    def __init__(self, robot: Robot, inverse: SampleSolver, tuning: Tuning) -> None:
        self._inverse = inverse
        super().__init__(robot, inverse.couplings, tuning)
        self._dependent_q = [robot.joint(name).q for name in inverse.couplings.dependent]
        self._ones = np.ones(len(inverse.couplings.v_index))

    def solve(self, x: Observation, wrenches: Sequence[Array] = ()) -> Torques | None:
        """Torques of an observation; None if they are not finite.

        An observation without torques leaves nothing behind: the next sample is judged and solved
        as if it had not been there. Where later samples were observed before it was solved, it
        stays in the filters, or they begin anew if its torques are not finite.

        Args:
            x: What `observe` returned.
            wrenches: One (6,) array for every load of the scene.

        Raises:
            SolveError: There are none.
        """
        try:
            torques = self._inverse.solve(x.position, x.velocity, x.acceleration, wrenches)
            if math.isfinite(torques.tau.dot(self._ones)):
                return torques
        except SolveError:
            self._give_up(x)
            raise
        is_newest = x is self._newest
        self._give_up(x)
        if not is_newest:
            self.reset()
        return None

    def reset(self) -> None:
        """Forget the past."""
        super().reset()
        self._newest: Observation | None = None

    def observe(
        self,
        stamp: int,
        position: Array,
        velocity: Array,
        present: NDArray[np.bool_],
        bodies: tuple[Array, Array] | None = None,
    ) -> Observation | SampleStatus:
        """As `JointObserver.observe`."""
        before = self.memory
        found = super().observe(stamp, position, velocity, present, bodies)
        if isinstance(found, Observation):
            self._newest, self._before = found, before
        return found

    def observe_all(
        self, stamps: NDArray[np.int64], position: Array, velocity: Array
    ) -> Observations | None:
        """As `JointObserver.observe_all`."""
        found = super().observe_all(stamps, position, velocity)
        if found is not None:
            self._newest = None
        return found

    def _give_up(self, x: Observation) -> None:
        """Put back the state before an observation."""
        if x is self._newest:
            self.memory, self._newest = self._before, None

    def violation(self, x: Observation) -> Array:
        """Measured minus coupled position of the dependent joints, of the newest `solve`.

        Returns:
            [rad or m], 0 where a joint was not measured, shape (n_d,).
        """
        off = x.dependent - self._inverse.configuration[self._dependent_q]
        return np.where(np.isfinite(off), off, 0.0)


class Tuning(NamedTuple):
    """How samples are judged and filtered.

    Attributes:
        cutoff: Half-power frequency of the causal filters of derivatives.
        velocity_margin: Position steps beyond margin x velocity limit x dt are encoder glitches.
        patience: Number of glitches in a row that are believed.
        max_age: How long a joint that messages lack keeps its last position.
        rewind: A stamp older than the last by more than this is a new beginning.
    """

    cutoff: Annotated[float, Within(1.0e-3, 1.0e6), Unit("Hz")] = 5.0
    velocity_margin: Annotated[float, Within(0.1, 1.0e6), Unit("-")] = 2.0
    patience: Annotated[int, Within(1, 10_000)] = 5
    max_age: Annotated[float, Within(0.0, 60.0), Unit("s")] = 0.1
    rewind: Annotated[float, Within(0.0, 3600.0), Unit("s")] = 1.0


class Observation(NamedTuple):
    """One accepted sample with its derivatives.

    Attributes:
        stamp: Time [ns].
        position: Independent coordinates y [rad or m], shape (ny,).
        velocity: y' [rad/s or m/s], shape (nv_y,).
        acceleration: y'' [rad/s^2 or m/s^2], shape (nv_y,).
        dependent: Measured positions of the dependent joints, NaN where absent, shape (n_d,).
    """

    stamp: int
    position: Array
    velocity: Array
    acceleration: Array
    dependent: Array


class Observations(NamedTuple):
    """Accepted samples with their derivatives, one a row.

    Attributes:
        stamps: Times [ns], shape (n,).
        position: Independent coordinates y [rad or m], shape (n, ny).
        velocity: y' [rad/s or m/s], shape (n, nv_y).
        acceleration: y'' [rad/s^2 or m/s^2], shape (n, nv_y).
        dependent: Measured positions of the dependent joints, NaN where absent, shape (n, n_d).
    """

    stamps: NDArray[np.int64]
    position: Array
    velocity: Array
    acceleration: Array
    dependent: Array

    def each(self) -> Iterator[Observation]:
        """The samples one by one."""
        rows = zip(self.stamps.tolist(), *self[1:], strict=True)
        return (Observation(*row) for row in rows)


def together(parts: Sequence[Observations]) -> Observations:
    """Samples after each other."""
    if len(parts) == 1:
        return parts[0]
    return Observations(*(np.concatenate(each) for each in zip(*parts, strict=True)))
