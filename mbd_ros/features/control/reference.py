"""The reference of a controller: a held state, single targets or trajectories, within limits.

A reference names joints in any order; `ReferenceMap` finds the controlled ones among them, and
maps joints that follow others to those.
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

_SHORTEST = 1.0e-4  # [s] of a ramp
_FARTHEST = 3600.0  # [s] that a trajectory may lie ahead: another clock is off by years
_MOST_NAMES = 8  # in an error


class ReferenceGenerator:
    """Turns targets and trajectories into one reference that is smooth over time.

    A trajectory that does not begin at the reference gets an offset, a quintic that decays,

        ref(t) = trajectory(t) + offset(t),   offset -> 0 within T,

    T so long that the offset moves no joint faster than `ramp_speed` of its velocity limit, and
    at least `ramp`. A single target is reached after the time since the last one, so that a
    stream of targets is interpolated, and later where that would be too fast. Without a
    successor it comes to rest within `timeout`.

    Position and velocity never jump; accelerations continue within a stream only, since an
    acceleration carried through a ramp would swing it by 0.017 a T². A reference that would leave
    the position limits on the way stands at them.

    Args:
        joints: The controlled joints, whose limits targets must keep.
        ramp: Shortest time to a reference that jumps, in which its offset decays.
        ramp_speed: Share of the velocity limits for such ramps.
        timeout: Age of a single target from which it is held.

    Attributes:
        ramp: May change at any time.
        ramp_speed: May change at any time.
        timeout: May change at any time.
        kind: What is followed: `held`, `target` or `trajectory`.
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
        """The trajectory that is followed; another object for another trajectory."""
        return self._trajectory

    @property
    def end(self) -> float:
        """When the reference comes to rest [s]."""
        return max(self._trajectory.end, -np.inf if self._offset is None else self._offset.end)

    def hold(self, t: float, q: Array, v: Array) -> None:
        """Come to rest at a measured position, from a measured velocity.

        Args:
            t: Now [s].
            q: [rad or m], shape (n,).
            v: [rad/s or m/s], shape (n,).
        """
        self.kind, self._last_target, self._interval = "held", -np.inf, 0.0
        self._trajectory = ReferenceTrajectory(np.array([t]), q[None, :].copy())
        self._limits.begin(q)
        self._fade(t, q, v)

    def resume(self, t: float, q: Array, v: Array) -> None:
        """Continue with the followed trajectory from a measured state, after the loop was open."""
        if self.kind == "held":
            self.hold(t, q, v)
        else:
            self._limits.begin(q)
            self._fade(t, q, v)

    def take_over(self, t: float, other: "ReferenceGenerator") -> None:
        """Continue at a time [s] the trajectory of another generator of the same joints."""
        self._limits.begin(other.at(t).q)
        self.kind, self._trajectory, self._offset = other.kind, other._trajectory, other._offset
        self._last_target, self._interval = other._last_target, other._interval

    def aim(self, t: float, target: Reference) -> None:
        """Take a single target, the next of a stream perhaps.

        Args:
            t: Now [s].
            target: Where the joints should be when the next target comes.

        Raises:
            TargetError: Not finite, beyond a limit, or too far away to be reached.
        """
        self._limits.check(np.array([t]), target.q[None, :], target.v[None, :])
        now = self.at(t)
        since = t - self._last_target or self._interval  # a second one at once replaces the first
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
        self._offset, self._last_target, self.kind = None, t, "target"
        self._interval = since

    def follow(
        self, t: float, times: Array, q: Array, v: Array | None = None, a: Array | None = None
    ) -> None:
        """Take a whole trajectory, by `plan` and `take`; the one before ends.

        Raises:
            TargetError: The trajectory is refused by `plan`.
        """
        self.take(t, self.plan(t, times, q, v, a))

    def take(self, t: float, trajectory: ReferenceTrajectory) -> None:
        """Follow, at a time [s], a trajectory that `plan` made; the one before ends."""
        now = self.at(t)
        self._trajectory, self._last_target, self.kind = trajectory, -np.inf, "trajectory"
        self._fade(t, now.q, now.v)

    def plan(
        self, t: float, times: Array, q: Array, v: Array | None = None, a: Array | None = None
    ) -> ReferenceTrajectory:
        """The trajectory through given points, within the limits; nothing is followed yet.

        Args:
            t: Now [s].
            times: Of the points [s], shape (k,). Where all of them lie ahead the reference goes
                to the first one in the time that is left, or ramps to it where that is too short.
            q: [rad or m], shape (k, n).
            v: [rad/s or m/s], shape (k, n), or None.
            a: [rad/s^2 or m/s^2], shape (k, n), or None.

        Returns:
            What `take` follows.

        Raises:
            TargetError: Times do not increase or are over, something is not finite, or the
                trajectory leaves a limit, between the points too.
        """
        given = [part for part in (times, q, v, a) if part is not None]
        if not all(np.isfinite(part).all() for part in given):
            raise TargetError("trajectory refused: not finite")
        if not (len(times) and (np.diff(times) > 0.0).all()):
            raise TargetError("trajectory refused: the times of its points must increase")
        if times[-1] < t:
            raise TargetError(
                f"trajectory refused: it ended {t - times[-1]:.3f} s ago; does its stamp fit?"
            )
        if times[0] - t > _FARTHEST:
            raise TargetError(
                f"trajectory refused: it begins in {times[0] - t:.6g} s, accepted are "
                f"{_FARTHEST:g} s; is its stamp of the same clock (use_sim_time)?"
            )
        now = self.at(t)
        joined = self._led_in(t, now, times, q, v, a) if times[0] > t else None
        trajectory = joined or ReferenceTrajectory(times, q, v, a)
        if joined is None:
            self._limits.check(*trajectory.samples())
            _check_near(self._ramp_time(now.q - trajectory.at(t).q, self.ramp))
        return trajectory

    def at(self, t: float) -> Reference:
        """The reference at a time [s]."""
        ref, offset = self._trajectory.at(t), self._offset
        if offset is not None and t < offset.end:
            away = offset.at(t)
            ref = Reference(ref.q + away.q, ref.v + away.v, ref.a + away.a)
        return self._limits.kept(ref)

    def state(self, t: float) -> str:
        """The followed reference at a time [s], for people."""
        if self.kind == "target" and t - self._last_target > self.timeout:
            return f"target of {t - self._last_target:.3g} s ago: held"
        if self.kind == "trajectory" and t >= self._trajectory.end:
            return "end of the trajectory: held"
        return self.kind

    def _led_in(
        self, t: float, now: Reference, times: Array, q: Array, v: Array | None, a: Array | None
    ) -> ReferenceTrajectory | None:
        """The trajectory from the present reference; None where it would leave a limit."""
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
        """Begin at a position with a velocity, and let the offset to the trajectory decay."""
        ref = self._trajectory.at(t)
        away, rate, still = q - ref.q, v - ref.v, np.zeros(len(q))
        if not (away.any() or rate.any()):
            self._offset = None
            return
        times = np.array([t, t + max(self._ramp_time(away, self.ramp), _SHORTEST)])
        self._offset = ReferenceTrajectory(
            times, np.array([away, still]), np.array([rate, still]), np.array([still, still])
        )

    def _ramp_time(self, distance: Array, least: float) -> float:
        """Time [s] for a distance at the speed of ramps."""
        speed = self.ramp_speed * self._limits.fastest
        return max(least, float((PEAK_SPEED * np.abs(distance) / speed).max(initial=0.0)))


def _check_near(duration: float) -> None:
    """Refuse a target so far away that numbers end on the way: a ramp of that duration [s]."""
    if not duration <= _FARTHEST:
        raise TargetError(
            f"reference refused: the way to it takes {duration:.3g} s at the speed of ramps, "
            f"accepted are {_FARTHEST:g} s"
        )


class Selection(NamedTuple):
    """How values of a reference become those of the controlled joints.

        q = (values[columns] - offset) / factor,   v = rates[columns] / factor

    A joint that the reference does not give has column 0, which means nothing.

    Attributes:
        is_given: Which of the controlled joints the reference gives, shape (n,).
        columns: Of the reference, shape (n,).
        factor: Shape (n,).
        offset: [rad or m], shape (n,).
        note: Joints that were mapped or left out, for people; empty without any.
    """

    is_given: NDArray[np.bool_]
    columns: NDArray[np.intp]
    factor: Array
    offset: Array
    note: str

    def positions(self, values: Array) -> Array:
        """Positions of the controlled joints from those of the reference, shape (.., n)."""
        return (values[..., self.columns] - self.offset) / self.factor

    def rates(self, values: Array) -> Array:
        """Velocities or accelerations of the controlled joints, shape (.., n)."""
        return values[..., self.columns] / self.factor


class ReferenceMap:
    """Selects the controlled joints from references of any order.

    A joint that follows a controlled one by a linear function may stand for it; beside it, it is
    left out, since the coupling decides its position.

    Args:
        couplings: Those of the scene.
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

    def select(self, given: Sequence[str], *, partial: bool = False) -> Selection:
        """How to read a reference of these names.

        Args:
            given: Names, one a column.
            partial: Whether controlled joints may be left out.

        Raises:
            TargetError: A name twice or unknown, a controlled joint that none of them gives and
                that must be there, or a joint that follows one that is left out.
        """
        self._check(given)
        columns, factors, offsets, notes, missing = [], [], [], [], []
        for name in self._names:
            source, factor, offset = self._source(name, given)
            if source is None:
                missing.append(name)
            elif source != name:
                notes.append(f"{name} from {source}")
            columns.append(0 if source is None else list(given).index(source))
            factors.append(factor)
            offsets.append(offset)
        is_given = np.array([name not in missing for name in self._names])
        self._refuse_missing(missing, given, partial=partial)
        used = {given[column] for column in np.array(columns)[is_given]}
        notes += [f"{name} left out: it follows" for name in given if name not in used]
        notes += [f"{', '.join(missing)} held: not given"] if missing else []
        return Selection(
            is_given,
            np.array(columns, dtype=np.intp),
            np.array(factors),
            np.array(offsets),
            "; ".join(notes),
        )

    def _check(self, given: Sequence[str]) -> None:
        if len(set(given)) != len(given) or not given:
            raise TargetError("reference refused: names are empty or repeated")
        unknown = [n for n in given if n not in self._names and n not in self._roots]
        if unknown:
            raise TargetError(
                f"reference refused: {_first(unknown)} not controlled; accepted: "
                f"{', '.join(self._names)}, or what follows them"
            )

    def _refuse_missing(
        self, missing: Sequence[str], given: Sequence[str], *, partial: bool
    ) -> None:
        """A joint that follows one that is left out would be ignored in silence."""
        if missing and not partial:
            raise TargetError(
                f"reference refused: {missing[0]} is missing; accepted: {', '.join(self._names)}"
            )
        for name in given:
            if self._roots.get(name) in missing:
                raise TargetError(
                    f"reference refused: {name} follows {self._roots[name]} by a function that is "
                    f"not linear; give {self._roots[name]}"
                )

    def _source(self, name: str, given: Sequence[str]) -> tuple[str | None, float, float]:
        """The name that gives a controlled joint, with factor and offset; None without one."""
        if name in given:
            return name, 1.0, 0.0
        for source in given:
            root, factor, offset = self._linear.get(source, ("", 1.0, 0.0))
            if root == name:
                return source, factor, offset
        return None, 1.0, 0.0


def _first(names: Sequence[str]) -> str:
    """Some names for people, of any number and length."""
    some = ", ".join(f"{name:.64}" for name in names[:_MOST_NAMES])
    return some if len(names) <= _MOST_NAMES else f"{some} and {len(names) - _MOST_NAMES} more"
