"""Causal estimate of joint torques from a stream of joint samples, live and offline alike.

An observer judges each sample and differentiates it causally; inverse dynamics then solves for
the torques.
"""

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
        couplings: Dependent joints; a sample may omit them.
        tuning: How samples are judged and filtered.

    Attributes:
        names: Joints of a sample: the independent ones, then the dependent ones.
        differentiator: Causal filter that supplies velocity and acceleration.
        outcome: Verdict on the newest sample.
    """

    def __init__(self, robot: Robot, couplings: Couplings, tuning: Tuning) -> None:
        self._robot = robot
        self._coordinates = IndependentCoordinates(robot, couplings)
        self.names = couplings.independent + couplings.dependent
        self._n = len(couplings.independent)
        self._size = self._n + TWIST * len(robot.bases)
        self._independent = [robot.joint(name) for name in couplings.independent]
        self._present = np.zeros(len(self.names), dtype=np.bool_)
        self._is_complete = False
        self.tune(tuning)

    def tune(self, tuning: Tuning) -> None:
        """Replace the tuning and restart the filters."""
        limits = np.array([joint.max_velocity for joint in self._independent])
        with np.errstate(over="ignore"):  # an overflow to inf means no limit
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
        """Discard all earlier samples, so that the filters start again."""
        self.differentiator.reset()
        self.outcome = SampleStatus.USED
        self._position = np.zeros(self._size)
        self._velocity = np.full(self._size, np.nan)
        self._last_stamps = np.full(self._size, _NEVER, dtype=np.int64)  # of each coordinate [ns]
        self._poses: Array | None = None  # of the newest sample that was used
        self._complete: int | None = None  # stamp of a complete sample since the last partial one

    def checkpoint(self) -> tuple[Any, ...]:
        """Return everything on which the result of the next sample depends."""
        return (
            self._position,
            self._velocity,
            self._complete,
            self._last_stamps,
            self._poses,
            self.differentiator.checkpoint(),
        )

    def restore(self, checkpoint: tuple[Any, ...]) -> None:
        """Return to the state in which `checkpoint` was taken."""
        (
            self._position,
            self._velocity,
            self._complete,
            self._last_stamps,
            self._poses,
            filters,
        ) = checkpoint
        self.differentiator.restore(filters)

    def observe(
        self,
        stamp: int,
        position: Array,
        velocity: Array,
        present: NDArray[np.bool_],
        bodies: tuple[Array, Array] | None = None,
    ) -> Observation | SampleStatus:
        """Judge a sample of the motion and differentiate it.

        Args:
            stamp: Time [ns].
            position: In the order of `names` [rad or m], NaN where absent.
            velocity: In the order of `names` [rad/s or m/s], NaN where absent.
            present: Which of `names` the message carries, shape (len(names),); the same array as
                long as its entries do not change.
            bodies: Poses of the free bodies in the world, shape (k, 7), and their twists, NaN
                where not measured, shape (k, 6); None without free bodies.

        Returns:
            The sample with its derivatives, or the reason why it cannot be used.
        """
        n, poses = self._n, None
        z, v = position[:n], velocity[:n]
        if bodies is not None:
            poses, steps = self._base_coordinates(bodies[0])
            z, v = np.concatenate((z, steps)), np.concatenate((v, bodies[1].ravel()))
        if present is not self._present:
            self._present, self._is_complete = present, bool(present[:n].all())
        if self._is_complete:
            self.outcome = outcome = self.differentiator.update(stamp, z, v)
            if outcome in _UNUSED:
                return outcome
            self._position, self._velocity, self._complete = z, v, stamp
        else:
            bodies_present = np.ones(self._size - n, dtype=np.bool_)
            known = np.concatenate((present[:n], bodies_present))
            self.outcome = outcome = self._observe_partial(stamp, z, v, known)
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
        """Judge and differentiate many samples at once.

        The result agrees with that of calling `observe` for each sample to rounding.

        Args:
            stamps: Times [ns], shape (m,), m > 0.
            position: Columns in the order of `names` [rad or m], NaN where absent.
            velocity: Columns in the order of `names` [rad/s or m/s], NaN where absent.

        Returns:
            The samples; None, without any effect, where they must go through `observe` one by one:
            at the beginning of a stream, with free bodies, and where a sample is incomplete or
            unusable.
        """
        n = self._n
        if self._robot.bases or not np.isfinite(position[:, :n]).all():
            return None
        derivatives = self.differentiator.update_all(stamps, position[:, :n], velocity[:, :n])
        if derivatives is None:
            return None
        self.outcome, self._complete = SampleStatus.USED, int(stamps[-1])
        self._position, self._velocity = position[-1, :n], velocity[-1, :n]
        return Observations(stamps, *derivatives, position[:, n:])

    def _base_coordinates(self, poses: Array) -> tuple[Array, Array]:
        """Return configurations of the free bodies, (k, 7), and their accumulated steps."""
        q, before = configuration_of(self._robot, poses), self._poses
        if before is None or not np.isfinite(q).all():
            return q, 0.0 * q[:, 1:].ravel()  # NaN stays
        pairs = list(zip(before, q, strict=True))
        steps = np.concatenate([step_between(*pair) for pair in pairs])
        signed = np.array([with_sign_of(*pair) for pair in pairs])
        return signed, self.differentiator.position[self._n :] + steps

    def _observe_partial(
        self, stamp: int, z: Array, v: Array, present: NDArray[np.bool_]
    ) -> SampleStatus:
        """Observe a sample without some joints; these keep their position for `max_age`."""
        if not np.isfinite(z[present]).all():
            return SampleStatus.NOT_FINITE
        self._last_stamps = self._last_stamps.copy()
        if self._complete is not None:
            self._last_stamps[:] = self._complete
            self._complete = None
        z, v = np.where(present, z, self._position), np.where(present, v, self._velocity)
        age, outcome = stamp - self._last_stamps, SampleStatus.INCOMPLETE
        if int(np.abs(age[~present]).max()) <= self._max_age:
            outcome = self.differentiator.update(stamp, z, v, age)
            if outcome in _UNUSED:
                return outcome
        self._position, self._velocity = z, v
        self._last_stamps[present] = stamp
        return outcome


class TorqueEstimator(JointObserver):
    """Causal inverse dynamics on a stream of joint samples.

    Args:
        inverse: Solver; the estimator owns it from now on.
        tuning: How samples are judged and filtered.
    """

    def __init__(self, robot: Robot, inverse: SampleSolver, tuning: Tuning) -> None:
        self._inverse = inverse
        super().__init__(robot, inverse.couplings, tuning)
        self._dependent_q = [robot.joint(name).q for name in inverse.couplings.dependent]
        self._ones = np.ones(len(inverse.couplings.v_index))

    def solve(self, x: Observation, wrenches: Sequence[Array] = ()) -> Torques | None:
        """Return the torques of an observation, or None if they are not finite.

        An observation without torques has no effect on later ones: the filters return to their
        state before it. Where later samples were observed in the meantime, the filters keep it,
        and restart if its torques are not finite.

        Args:
            x: Result of `observe`.
            wrenches: One (6,) array [N, N·m] for every load of the scene.

        Raises:
            SolveError: No torques explain the observation.
        """
        try:
            torques = self._inverse.solve(x.position, x.velocity, x.acceleration, wrenches)
            if math.isfinite(torques.tau.dot(self._ones)):
                return torques
        except SolveError:
            self._discard(x)
            raise
        is_newest = x is self._newest
        self._discard(x)
        if not is_newest:
            self.reset()
        return None

    def reset(self) -> None:
        """Discard all earlier samples, so that the filters start again."""
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
        """Judge a sample of the motion and differentiate it, see `JointObserver.observe`."""
        before = self.checkpoint()
        result = super().observe(stamp, position, velocity, present, bodies)
        if isinstance(result, Observation):
            self._newest = result
            self._before = before
        return result

    def observe_all(
        self, stamps: NDArray[np.int64], position: Array, velocity: Array
    ) -> Observations | None:
        """Judge and differentiate many samples, see `JointObserver.observe_all`."""
        observations = super().observe_all(stamps, position, velocity)
        if observations is not None:
            self._newest = None
        return observations

    def _discard(self, x: Observation) -> None:
        """Restore the filters to their state before the newest observation."""
        if x is self._newest:
            self.restore(self._before)
            self._newest = None

    def violation(self, x: Observation) -> Array:
        """Return how far the measured dependent joints are from their coupling.

        Args:
            x: Observation of the newest call of `solve`.

        Returns:
            Measured minus coupled position [rad or m], 0 where a joint was not measured, shape
            (n_d,).
        """
        deviation = x.dependent - self._inverse.configuration[self._dependent_q]
        return np.where(np.isfinite(deviation), deviation, 0.0)


class Tuning(NamedTuple):
    """Parameters of the judgement and the filters of samples.

    Attributes:
        cutoff: Half-power frequency of the causal filters of derivatives.
        velocity_margin: A position step beyond margin x velocity limit x dt counts as an encoder
            glitch.
        patience: After this many glitches in a row the new position is accepted.
        max_age: How long a joint that is missing in messages keeps its last position.
        rewind: A stamp that is older than the last one by more than this restarts the filters.
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

    def rows(self) -> Iterator[Observation]:
        """Yield the samples one by one."""
        values = zip(self.stamps.tolist(), *self[1:], strict=True)
        return (Observation(*row) for row in values)


def concatenate_observations(parts: Sequence[Observations]) -> Observations:
    """Return the samples of all parts, in order."""
    if len(parts) == 1:
        return parts[0]
    return Observations(*(np.concatenate(field) for field in zip(*parts, strict=True)))
