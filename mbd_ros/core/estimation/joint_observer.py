"""Joint-state samples -> accepted samples with derivatives, holes filled for a while."""

from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.estimation.differentiation import CausalDifferentiator, SampleStatus
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Unit, Within
from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import ModelError

_NEVER = -(2**62)
_UNUSED = (SampleStatus.OLD, SampleStatus.JUMP, SampleStatus.NOT_FINITE, SampleStatus.INCOMPLETE)


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
        position: Independent joints [rad or m], shape (n,).
        velocity: [rad/s or m/s], shape (n,).
        acceleration: [rad/s^2 or m/s^2], shape (n,).
        dependent: Measured positions of the dependent joints, NaN where absent, shape (n_d,).
    """

    stamp: int
    position: Array
    velocity: Array
    acceleration: Array
    dependent: Array


class JointObserver:
    """Judges a stream of joint samples and derives missing velocities and accelerations.

    Args:
        robot: The robot; fixed base.
        couplings: Its dependent joints, which may be missing.
        tuning: How samples are judged and filtered.

    Attributes:
        names: Joints of a sample: the independent ones, then the dependent ones.
        differentiator: Where velocity and acceleration come from.
        outcome: Verdict on the newest sample.

    Raises:
        ModelError: The base floats: joint states do not carry its pose.
    """

    def __init__(self, robot: Robot, couplings: Couplings, tuning: Tuning) -> None:
        if robot.floating:
            raise ModelError(
                "joint states do not carry the pose of a floating base; use base: fixed"
            )
        self.names = couplings.independent + couplings.dependent
        self._n = len(couplings.independent)
        self._independent = [robot.joint(name) for name in couplings.independent]
        self._present, self._is_complete = np.zeros(len(self.names), dtype=np.bool_), False
        self.tune(tuning)

    def tune(self, tuning: Tuning) -> None:
        """Replace the tuning; the filters start again."""
        limits = np.array([joint.max_velocity for joint in self._independent])
        with np.errstate(over="ignore"):  # a limit near the largest number is none
            limits *= tuning.velocity_margin
        continuous = [joint.kind == "continuous" for joint in self._independent]
        self.differentiator = CausalDifferentiator(
            cutoff=tuning.cutoff,
            velocity_limit=limits,
            wraps=np.array(continuous, dtype=np.bool_),
            patience=tuning.patience,
            rewind=tuning.rewind,
        )
        self._max_age = round(tuning.max_age / NANOSECOND)
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.differentiator.reset()
        self.outcome = SampleStatus.USED
        self._position, self._velocity = np.zeros(self._n), np.full(self._n, np.nan)
        self._seen = np.full(self._n, _NEVER, dtype=np.int64)
        self._complete: int | None = None  # stamp of a complete sample since the last partial one

    @property
    def memory(self) -> tuple[Any, ...]:
        """State on which the next samples depend; may be set, to its value before a sample."""
        kept = self._position, self._velocity, self._complete, self._seen
        return kept, self.differentiator.memory

    @memory.setter
    def memory(self, memory: tuple[Any, ...]) -> None:
        kept, self.differentiator.memory = memory
        self._position, self._velocity, self._complete, self._seen = kept

    def observe(
        self, stamp: int, position: Array, velocity: Array, present: NDArray[np.bool_]
    ) -> Observation | SampleStatus:
        """Take a sample of the motion.

        Args:
            stamp: Time [ns].
            position: In the order of `names` [rad or m], NaN where absent.
            velocity: In the order of `names` [rad/s or m/s], NaN where absent.
            present: Which of `names` the message carries, shape (len(names),); the same array as
                long as that does not change.

        Returns:
            The sample with its derivatives, or why it cannot be used.
        """
        n = self._n
        z, v = position[:n], velocity[:n]
        if present is not self._present:
            self._present, self._is_complete = present, bool(present[:n].all())
        if self._is_complete:
            self.outcome = outcome = self.differentiator.update(stamp, z, v)
            if outcome in _UNUSED:
                return outcome
            self._position, self._velocity, self._complete = z, v, stamp
        else:
            self.outcome = outcome = self._take_part(stamp, z, v, present[:n])
            if outcome in _UNUSED:
                return outcome
        d = self.differentiator
        return Observation(stamp, d.position, d.velocity, d.acceleration, position[n:])

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
