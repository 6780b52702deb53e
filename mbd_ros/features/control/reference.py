"""The reference of a controller: a fixed position, single targets or trajectories, within limits.

A reference names joints in any order. `ReferenceMap` selects the controlled joints among them, and
maps coupled joints to the joints that they follow.
"""

from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.model.coupling_functions import Linear
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.ranges import Unit, Within
from mbd_ros.core.state import Array
from mbd_ros.features.control.trajectory import (
    PEAK_SPEED,
    ReferenceLimits,
    ReferenceTrajectory,
    TargetError,
    slopes,
)
from mbd_ros.methods.control.contract import ControlledJoints, Reference

_SHORTEST = 1.0e-4  # s, duration of a ramp
_FARTHEST = 3600.0  # s that a trajectory may lie ahead; another clock would be off by years
_MOST_NAMES = 8  # in an error


class ReferenceGenerator:
    """Generator of one smooth reference from targets and trajectories.

    A trajectory that does not start at the present reference gets an offset that decays as a
    quintic,

        ref(t) = trajectory(t) + offset(t),   offset -> 0 within T,

    where T is at least `ramp`, and so long that the offset moves no joint faster than `ramp_speed`
    times its velocity limit. A single target is reached after the time since the last one, so
    that a stream of targets is interpolated, or later if that would be too fast. Without a next
    target the reference comes to rest within `timeout`.

    Position and velocity never jump. Accelerations continue within a stream only, since an
    acceleration that a ramp took over would swing it by 0.017 a T². A reference that would pass a
    position limit rests there.

    Args:
        joints: The controlled joints, whose limits targets must keep.
        ramp: Shortest time in which the offset of a new reference decays.
        ramp_speed: Share of the velocity limits that such ramps use.
        timeout: Age of a single target after which the reference rests.

    Attributes:
        ramp: May be changed at any time.
        ramp_speed: May be changed at any time.
        timeout: May be changed at any time.
        kind: `held`, `target` or `trajectory`.
    """

    def __init__(
        self,
        joints: ControlledJoints,
        ramp: Annotated[float, Within(0.0, 60.0), Unit("s")] = 0.5,
        ramp_speed: Annotated[float, Within(1.0e-3, 1.0), Unit("-")] = 0.5,
        timeout: Annotated[float, Within(1.0e-3, 60.0), Unit("s")] = 0.5,
    ) -> None:
        self.ramp, self.ramp_speed, self.timeout = ramp, ramp_speed, timeout
        self._limits = ReferenceLimits(joints)
        self._offset: ReferenceTrajectory | None = None
        self.hold(0.0, np.zeros(len(joints)), np.zeros(len(joints)))

    @property
    def trajectory(self) -> ReferenceTrajectory:
        """The trajectory that is followed; every new trajectory is a new object."""
        return self._trajectory

    @property
    def end(self) -> float:
        """Time at which the reference comes to rest [s]."""
        return max(self._trajectory.end, -np.inf if self._offset is None else self._offset.end)

    def hold(self, t: float, q: Array, v: Array) -> None:
        """Come to rest at a measured position, from a measured velocity.

        Args:
            t: Present time [s].
            q: Measured positions [rad or m], shape (n,).
            v: Measured velocities [rad/s or m/s], shape (n,).
        """
        self.kind = "held"
        self._last_target = -np.inf
        self._interval = 0.0
        self._trajectory = ReferenceTrajectory(np.array([t]), q[None, :].copy())
        self._limits.begin(q)
        self._fade(t, q, v)

    def resume(self, t: float, q: Array, v: Array) -> None:
        """Continue with the trajectory from a measured state, after the loop was open."""
        if self.kind == "held":
            self.hold(t, q, v)
        else:
            self._limits.begin(q)
            self._fade(t, q, v)

    def take_over(self, t: float, other: "ReferenceGenerator") -> None:
        """Continue the trajectory of another generator of the same joints from a time [s] on."""
        self._limits.begin(other.at(t).q)
        self.kind = other.kind
        self._trajectory = other._trajectory
        self._offset = other._offset
        self._last_target = other._last_target
        self._interval = other._interval

    def aim(self, t: float, target: Reference) -> None:
        """Follow a single target, which may be the next one of a stream.

        Args:
            t: Present time [s].
            target: State that the joints should have when the next target comes.

        Raises:
            TargetError: The target is not finite, beyond a limit, or too far away.
        """
        self._limits.check(np.array([t]), target.q[None, :], target.v[None, :])
        now = self.at(t)
        since = (
            t - self._last_target or self._interval
        )  # a second target at once replaces the first
        is_stream = 0.0 < since < self.timeout
        since = since if is_stream else self.ramp
        jump = target.q - now.q - 0.5 * since * (now.v + target.v)
        duration = max(since, self._ramp_time(jump, 0.0), _SHORTEST)
        stop = self.timeout
        end = self._limits.nearest(target.q + 0.5 * stop * target.v)
        _check_near(duration)
        still = np.zeros(len(end))
        self._trajectory = ReferenceTrajectory(
            t + np.array([0.0, duration, duration + stop]),
            np.array([now.q, target.q, end]),
            np.array([now.v, target.v, still]),
            np.array([now.a if is_stream and duration == since else still, target.a, still]),
        )
        self._offset = None
        self._last_target = t
        self.kind = "target"
        self._interval = since

    def follow(
        self, t: float, times: Array, q: Array, v: Array | None = None, a: Array | None = None
    ) -> None:
        """Plan a trajectory and follow it instead of the previous one.

        Raises:
            TargetError: `plan` refuses the trajectory.
        """
        self.take(t, self.plan(t, times, q, v, a))

    def take(self, t: float, trajectory: ReferenceTrajectory) -> None:
        """Follow a trajectory of `plan` from a time [s] on, instead of the previous one."""
        now = self.at(t)
        self._trajectory = trajectory
        self._last_target = -np.inf
        self.kind = "trajectory"
        self._fade(t, now.q, now.v)

    def plan(
        self, t: float, times: Array, q: Array, v: Array | None = None, a: Array | None = None
    ) -> ReferenceTrajectory:
        """Return a trajectory through points within the limits, without following it yet.

        Args:
            t: Present time [s].
            times: Times of the points [s], shape (k,). If all lie ahead, the reference goes to the
                first point in the remaining time, or ramps to it if that is too short.
            q: Positions [rad or m], shape (k, n).
            v: Velocities [rad/s or m/s], shape (k, n), or None.
            a: Accelerations [rad/s^2 or m/s^2], shape (k, n), or None.

        Returns:
            The trajectory, for `take`.

        Raises:
            TargetError: The times do not increase or are over, a value is not finite, or the
                trajectory passes a limit, perhaps between the points.
        """
        values = [part for part in (times, q, v, a) if part is not None]
        if not all(np.isfinite(part).all() for part in values):
            raise TargetError("trajectory refused: a value is not finite")
        if not (len(times) and (np.diff(times) > 0.0).all()):
            raise TargetError("trajectory refused: the times of its points must increase")
        if times[-1] < t:
            raise TargetError(
                f"trajectory refused: it ended {t - times[-1]:.3f} s ago; check its stamp"
            )
        if times[0] - t > _FARTHEST:
            raise TargetError(
                f"trajectory refused: it begins in {times[0] - t:.6g} s, accepted are "
                f"{_FARTHEST:g} s; check that its stamp is of the same clock (use_sim_time)"
            )
        now = self.at(t)
        joined = self._join(t, now, times, q, v, a) if times[0] > t else None
        trajectory = joined or ReferenceTrajectory(times, q, v, a)
        if joined is None:
            self._limits.check(*trajectory.samples())
            _check_near(self._ramp_time(now.q - trajectory.at(t).q, self.ramp))
        return trajectory

    def at(self, t: float) -> Reference:
        """Return the reference at a time [s]."""
        ref, offset = self._trajectory.at(t), self._offset
        if offset is not None and t < offset.end:
            shift = offset.at(t)
            ref = Reference(ref.q + shift.q, ref.v + shift.v, ref.a + shift.a)
        return self._limits.clip(ref)

    def state(self, t: float) -> str:
        """Describe the reference at a time [s], for people."""
        if self.kind == "target" and t - self._last_target > self.timeout:
            return f"target of {t - self._last_target:.3g} s ago: held"
        if self.kind == "trajectory" and t >= self._trajectory.end:
            return "end of the trajectory: held"
        return self.kind

    def _join(
        self, t: float, now: Reference, times: Array, q: Array, v: Array | None, a: Array | None
    ) -> ReferenceTrajectory | None:
        """Return the trajectory from the present reference on; None if it would pass a limit."""
        times, q = np.append(t, times), np.vstack([now.q, q])
        if v is None:
            v, a = slopes(times, q), None
            v[0] = now.v
        else:
            v = np.vstack([now.v, v])
            a = None if a is None else np.vstack([np.zeros(len(now.q)), a])
        trajectory = ReferenceTrajectory(times, q, v, a)
        try:
            self._limits.check(*trajectory.samples())
        except TargetError:
            return None
        return trajectory

    def _fade(self, t: float, q: Array, v: Array) -> None:
        """Start from a position and a velocity, and let the offset to the trajectory decay."""
        ref = self._trajectory.at(t)
        shift, rate, zero = q - ref.q, v - ref.v, np.zeros(len(q))
        if not (shift.any() or rate.any()):
            self._offset = None
            return
        times = np.array([t, t + max(self._ramp_time(shift, self.ramp), _SHORTEST)])
        self._offset = ReferenceTrajectory(
            times, np.array([shift, zero]), np.array([rate, zero]), np.array([zero, zero])
        )

    def _ramp_time(self, distance: Array, least: float) -> float:
        """Return the time [s] for a distance at the speed of ramps."""
        speed = self.ramp_speed * self._limits.fastest
        return max(least, float((PEAK_SPEED * np.abs(distance) / speed).max(initial=0.0)))


def _check_near(duration: float) -> None:
    """Refuse a ramp of a duration [s] that only a mistaken target needs."""
    if not duration <= _FARTHEST:
        raise TargetError(
            f"reference refused: a ramp to it takes {duration:.3g} s at the speed of ramps, "
            f"accepted are {_FARTHEST:g} s"
        )


class Selection(NamedTuple):
    """Map from the values of a reference to those of the controlled joints.

        q = (values[columns] - offset) / factor,   v = rates[columns] / factor

    The column of a joint that the reference does not contain is 0 and has no meaning.

    Attributes:
        is_given: Whether the reference contains a controlled joint, shape (n,).
        columns: Columns of the reference, shape (n,).
        factor: Factors of linear couplings, shape (n,).
        offset: Offsets of linear couplings [rad or m], shape (n,).
        note: Joints that were mapped or left out, for people; empty without any.
    """

    is_given: NDArray[np.bool_]
    columns: NDArray[np.intp]
    factor: Array
    offset: Array
    note: str

    def positions(self, values: Array) -> Array:
        """Return positions of the controlled joints, shape (.., n), for those of the reference."""
        return (values[..., self.columns] - self.offset) / self.factor

    def rates(self, values: Array) -> Array:
        """Return velocities or accelerations of the controlled joints, shape (.., n)."""
        return values[..., self.columns] / self.factor


class ReferenceMap:
    """Selection of the controlled joints from references in any order.

    A reference may contain, in place of a controlled joint, a joint that follows it by a linear
    coupling. If it contains both, the coupled joint is ignored.

    Args:
        names: The controlled joints.
        couplings: Couplings of the scene.
    """

    def __init__(self, names: Sequence[str], couplings: Couplings) -> None:
        self._names = tuple(names)
        self._linear: dict[str, tuple[str, float, float]] = {}  # independent, factor, offset
        self._roots: dict[str, str] = {}
        for name, pair in zip(couplings.dependent, couplings.pairs, strict=True):
            parent = couplings.parents[name]
            self._roots[name] = self._roots.get(parent, parent)
            root, factor, offset = self._linear.get(parent, (parent, 1.0, 0.0))
            followed = parent not in self._roots or parent in self._linear
            if followed and isinstance(pair.function, Linear) and pair.function.factor != 0.0:
                factor, offset = pair.function.factor * factor, pair.function.factor * offset
                self._linear[name] = (root, factor, offset + pair.function.offset)

    def select(self, labels: Sequence[str], *, partial: bool = False) -> Selection:
        """Return the map for a reference with these names.

        Args:
            labels: Joint of each column.
            partial: Whether controlled joints may be missing.

        Raises:
            TargetError: A name is repeated or unknown, a controlled joint is missing, or a joint
                follows one that is missing.
        """
        self._check(labels)
        columns, factors, offsets, notes, missing = [], [], [], [], []
        for name in self._names:
            source, factor, offset = self._source(name, labels)
            if source is None:
                missing.append(name)
            elif source != name:
                notes.append(f"{name} from {source}")
            columns.append(0 if source is None else list(labels).index(source))
            factors.append(factor)
            offsets.append(offset)
        is_given = np.array([name not in missing for name in self._names])
        self._refuse_missing(missing, labels, partial=partial)
        used = {labels[column] for column in np.array(columns)[is_given]}
        notes += [f"{name} left out: it follows" for name in labels if name not in used]
        notes += [f"{', '.join(missing)} held: not given"] if missing else []
        return Selection(
            is_given,
            np.array(columns, dtype=np.intp),
            np.array(factors),
            np.array(offsets),
            "; ".join(notes),
        )

    def _check(self, labels: Sequence[str]) -> None:
        if len(set(labels)) != len(labels) or not labels:
            raise TargetError("reference refused: names are empty or repeated")
        unknown = [n for n in labels if n not in self._names and n not in self._roots]
        if unknown:
            raise TargetError(
                f"reference refused: {_first(unknown)} not controlled; accepted: "
                f"{', '.join(self._names)}, or joints that follow them"
            )

    def _refuse_missing(
        self, missing: Sequence[str], labels: Sequence[str], *, partial: bool
    ) -> None:
        """Refuse missing joints, and joints that follow them, which would be ignored silently."""
        if missing and not partial:
            raise TargetError(
                f"reference refused: {missing[0]} is missing; accepted: {', '.join(self._names)}"
            )
        for name in labels:
            if self._roots.get(name) in missing:
                raise TargetError(
                    f"reference refused: {name} follows {self._roots[name]} by a function that is "
                    f"not linear; give {self._roots[name]}"
                )

    def _source(self, name: str, labels: Sequence[str]) -> tuple[str | None, float, float]:
        """Return the label of a controlled joint, with factor and offset; None without one."""
        if name in labels:
            return name, 1.0, 0.0
        for source in labels:
            root, factor, offset = self._linear.get(source, ("", 1.0, 0.0))
            if root == name:
                return source, factor, offset
        return None, 1.0, 0.0


def _first(names: Sequence[str]) -> str:
    """Shorten a list of names for people."""
    some = ", ".join(f"{name:.64}" for name in names[:_MOST_NAMES])
    return some if len(names) <= _MOST_NAMES else f"{some} and {len(names) - _MOST_NAMES} more"
