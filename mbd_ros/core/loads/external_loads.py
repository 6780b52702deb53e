"""External loads on bodies, which are measured or prescribed over time."""

from collections import deque
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.contracts import Channel, Load, Wrench
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotNegative, Unit, Vector
from mbd_ros.core.state import Array, State, WrenchSamples

_CHANNELS = tuple(
    Channel(f"{letter}{axis}", unit)
    for letter, unit in (("F", "N"), ("M", "N·m"))
    for axis in "xyz"
)


class ExternalWrench(Load):
    """External wrench on one link; its six components are inputs.

    Args:
        frame: Link that the wrench acts on.
        expressed_in: Frame in whose axes the wrench is given, about its origin if there is no
            `point`; `frame` by default.
        point: Point in `expressed_in` that the torque is about, shape (3,).
        threshold: Norm of the force below which the wrench counts as zero. Use it for a force
            plate whose centre of pressure is undefined at small loads.

    Attributes:
        carrier: Origin and axes of the joint that carries the link.
        about: Point that the torque is about, with the axes of `expressed_in`.
    """

    reads = Reads.JACOBIAN
    inputs = _CHANNELS

    def __init__(
        self,
        robot: Robot,
        *,
        frame: str,
        expressed_in: str | None = None,
        point: Annotated[Vector, Unit("m")] = (0.0, 0.0, 0.0),
        threshold: Annotated[NotNegative, Unit("N")] = 0.0,
    ) -> None:
        self.frame = frame
        self.expressed_in = expressed_in or frame
        self.point = tuple(point)
        self.threshold = threshold
        self.carrier = robot.carrier(frame)
        self.about = robot.point(self.expressed_in, point)
        self._nv = int(robot.model.nv)

    def is_loaded(self, wrench: Array) -> bool:
        """Whether the force exceeds the threshold; without a threshold every load counts."""
        return self.threshold == 0.0 or float(np.linalg.norm(wrench[:3])) > self.threshold

    def in_body(self, k: Kinematics, wrench: Array) -> Array:
        """Return the wrench about the origin and in the axes of `carrier`, shape (6,).

        Args:
            k: Kinematics at the state.
            wrench: Force [N], then torque [N·m] in `expressed_in`, shape (6,).
        """
        return k.transform_wrench(wrench, self.about, self.carrier)

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the generalized force, shape (nv,)."""
        return self.force_of(k, u[self.u])

    def columns(self, k: Kinematics, x: State) -> Array | None:
        """Return the forces of unit inputs, (nv, 6); None with a threshold, as the force jumps."""
        if self.threshold > 0.0:
            return None
        return np.column_stack([self.force_of(k, unit) for unit in np.eye(6)])

    def wrenches(self, k: Kinematics, x: State, u: Array) -> tuple[Wrench, ...]:
        """Return the wrench on the link."""
        return self.wrenches_of(k, u[self.u])

    def force_of(self, k: Kinematics, wrench: Array) -> Array:
        """Return the generalized force of a wrench [N, N·m], shape (nv,)."""
        if not self.carrier.moves:
            return k.zeros(self._nv)
        return k.either(
            self._acts(k, wrench),
            lambda: k.dot(self.in_body(k, wrench), k.local_jacobian(self.carrier)),
            lambda: k.zeros(self._nv),
        )

    def _acts(self, k: Kinematics, wrench: Array) -> bool:
        if self.threshold > 0.0:
            return k.hypot(wrench[:3]) > self.threshold
        return k.any(wrench)

    def wrenches_of(self, k: Kinematics, wrench: Array) -> tuple[Wrench, ...]:
        """Return a wrench [N, N·m] on the link, about the origin of the joint that carries it."""
        acts = self.threshold == 0.0 or k.hypot(wrench[:3]) > self.threshold
        share = k.where(acts, 1.0, 0.0)
        if not k.any(np.array([share])):
            return ()
        carrier, load = self.carrier, self.in_body(k, wrench) * share
        axes, place = k.rotation(carrier), k.position(carrier)
        return (Wrench(self.frame, place, axes.dot(load[:3]), axes.dot(load[3:])),)


class WrenchBuffer:
    """Buffer of the newest samples of a wrench, which interpolates at stamps of joint states.

    Args:
        max_age: Time for which the newest sample is held [ns].
        rewind: A stamp that is older than the last one by more than this restarts the buffer [ns].
        length: Largest number of samples.
    """

    def __init__(self, max_age: int, rewind: int, length: int = 256) -> None:
        self._max_age = max_age
        self._rewind = rewind
        self._samples: deque[tuple[int, Array]] = deque(maxlen=length)

    def add(self, stamp: int, wrench: Array) -> bool:
        """Add a sample; return False if its stamp [ns] is not newer than the last one."""
        if self._samples and stamp <= self._samples[-1][0]:
            if self._samples[-1][0] - stamp <= self._rewind:
                return False
            self.clear()
        self._samples.append((stamp, wrench))
        return True

    def clear(self) -> None:
        """Remove all samples."""
        self._samples.clear()

    def covers(self, stamp: int) -> bool:
        """Whether later samples cannot change the result of `at`."""
        return bool(self._samples) and self._samples[-1][0] >= stamp

    def at(self, stamp: int) -> Array | None:
        """Return the wrench at a time, linear between samples, held for `max_age` after the last.

        Args:
            stamp: Time [ns].

        Returns:
            Force [N], then torque [N·m], shape (6,), or None if no sample is near enough.
        """
        later: tuple[int, Array] | None = None
        for sample in reversed(self._samples):
            if sample[0] <= stamp:
                return self._between(sample, later, stamp)
            later = sample
        return None

    def _between(
        self, before: tuple[int, Array], after: tuple[int, Array] | None, stamp: int
    ) -> Array | None:
        age = stamp - before[0]
        if age == 0:
            return before[1]
        if after is None:
            return before[1] if age <= self._max_age else None
        share = age / (after[0] - before[0])
        return before[1] + share * (after[1] - before[1])


def at_stamps(samples: WrenchSamples, stamps: NDArray[np.int64], max_age: int) -> Array:
    """Interpolate a recorded wrench at the stamps of a motion, as `WrenchBuffer.at` does.

    Args:
        samples: Recorded wrench.
        stamps: Times [ns], shape (n,).
        max_age: Time for which the newest sample is held [ns].

    Returns:
        Wrenches, shape (n, 6); NaN where no sample is near enough.
    """
    begin = samples.stamps[0]  # differences are exact as floats, stamps since 1970 are not
    times, known = stamps - begin, samples.stamps - begin
    columns = [np.interp(times, known, column) for column in samples.wrench.T]
    wrench = np.column_stack(columns)
    wrench[(stamps < samples.stamps[0]) | (stamps > samples.stamps[-1] + max_age)] = np.nan
    return wrench
