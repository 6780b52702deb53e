"""What a controller is to follow: a held state, single targets or whole courses, without jumps."""

import numpy as np

from mbd_ros.core.control.contract import ControlledJoints, Reference
from mbd_ros.core.control.course import PEAK_SPEED, Course
from mbd_ros.core.state import Array
from mbd_ros.errors import MbdError

_ROUNDING = 1.0e-9  # rad or m, and share of a speed limit
_SHORTEST = 1.0e-4  # s


class TargetError(MbdError):
    """A reference that is refused: names the joint, its value and what is accepted."""


class Guide:
    """Turns targets and courses into one reference that is smooth over time.

    A course that does not begin where the reference is gets an offset that decays as a quintic,

        ref(t) = course(t) + offset(t),   offset -> 0 within T,

    T so long that the offset moves no joint faster than `ramp_speed` of its velocity limit, and
    at least `ramp`. A single target is reached after the time since the last one, so that a
    stream of targets is interpolated, and later where that would be too fast. Without a
    successor it comes to rest within `timeout`.

    Args:
        joints: The controlled joints, whose limits targets must keep.
        ramp: Shortest time in which an offset decays [s], >= 0.
        ramp_speed: Share of the velocity limits for ramps, above 0, at most 1.
        timeout: Age at which a target counts as stale [s], > 0.

    Attributes:
        ramp: See above; may change at any time.
        ramp_speed: See above; may change at any time.
        timeout: See above; may change at any time.
        kind: What is followed: `held`, `target` or `trajectory`.
    """

    def __init__(
        self,
        joints: ControlledJoints,
        ramp: float = 0.5,
        ramp_speed: float = 0.5,
        timeout: float = 0.5,
    ) -> None:
        self.ramp, self.ramp_speed, self.timeout = ramp, ramp_speed, timeout
        self.names = joints.names
        self._lower = np.array([joint.lower for joint in joints.joints])
        self._upper = np.array([joint.upper for joint in joints.joints])
        self._fastest = np.array([joint.max_velocity for joint in joints.joints])
        self.hold(0.0, np.zeros(len(joints)), np.zeros(len(joints)))

    def hold(self, t: float, q: Array, v: Array) -> None:
        """Come to rest at a measured position, from a measured velocity.

        Args:
            t: Now [s].
            q: [rad or m], shape (n,).
            v: [rad/s or m/s], shape (n,).
        """
        self.kind, self._last_target = "held", -np.inf
        self._course = Course(np.array([t]), q[None, :].copy())
        self._offset: Course | None = None
        if v.any():
            self._fade(t, Reference(q, v, np.zeros(len(q))))

    def resume(self, t: float, q: Array, v: Array) -> None:
        """Go on with what is followed, from a measured state: after the loop was open."""
        if self.kind == "held":
            self.hold(t, q, v)
        else:
            self._fade(t, Reference(q, v, np.zeros(len(q))))

    def aim(self, t: float, target: Reference) -> None:
        """Take a single target, the next of a stream perhaps.

        Args:
            t: Now [s].
            target: Where the joints should be when the next target comes.

        Raises:
            TargetError: Not finite, or beyond a limit.
        """
        self._check(np.array([t]), target.q[None, :], target.v[None, :])
        now = self.at(t)
        since = t - self._last_target
        since = since if 0.0 < since < self.timeout else self.ramp
        jump = target.q - now.q - 0.5 * since * (now.v + target.v)
        duration = max(since, self._ramp_time(jump, 0.0), _SHORTEST)
        stop = self.timeout
        end = np.clip(target.q + 0.5 * stop * target.v, self._lower, self._upper)
        still = np.zeros(len(end))
        self._course = Course(
            t + np.array([0.0, duration, duration + stop]),
            np.array([now.q, target.q, end]),
            np.array([now.v, target.v, still]),
            np.array([now.a, target.a, still]),
        )
        self._offset, self._last_target, self.kind = None, t, "target"

    def follow(
        self, t: float, times: Array, q: Array, v: Array | None = None, a: Array | None = None
    ) -> None:
        """Take a whole trajectory; what was followed ends.

        Args:
            t: Now [s].
            times: Of the points [s], shape (k,). The reference of now is the first point where
                all of them lie ahead.
            q: [rad or m], shape (k, n).
            v: [rad/s or m/s], shape (k, n), or None.
            a: [rad/s^2 or m/s^2], shape (k, n), or None.

        Raises:
            TargetError: Times do not increase or are over, something is not finite, or the
                course leaves a limit, between the points too.
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
        now, given_from = self.at(t), float(times[0])
        if times[0] > t:
            times, q = np.append(t, times), np.vstack([now.q, q])
            v = None if v is None else np.vstack([now.v, v])
            a = None if a is None else np.vstack([now.a, a])
        course = Course(times, q, v, a)
        samples = course.samples()
        asked = samples[0] >= given_from
        self._check(*(part[asked] for part in samples))
        self._course, self._last_target, self.kind = course, -np.inf, "trajectory"
        self._fade(t, now)

    def at(self, t: float) -> Reference:
        """The reference at a time [s]."""
        ref, offset = self._course.at(t), self._offset
        if offset is None or t >= offset.end:
            return ref
        away = offset.at(t)
        return Reference(ref.q + away.q, ref.v + away.v, ref.a + away.a)

    def state(self, t: float) -> str:
        """What is followed at a time [s], for people."""
        if self.kind == "target" and t - self._last_target > self.timeout:
            return f"target of {t - self._last_target:.3g} s ago: held"
        if self.kind == "trajectory" and t >= self._course.end:
            return "end of the trajectory: held"
        return self.kind

    def _fade(self, t: float, now: Reference) -> None:
        """Begin at `now`, and let the offset to the course decay."""
        ref = self._course.at(t)
        away = Reference(now.q - ref.q, now.v - ref.v, now.a - ref.a)
        if not (away.q.any() or away.v.any() or away.a.any()):
            self._offset = None
            return
        still = np.zeros(len(away.q))
        times = np.array([t, t + max(self._ramp_time(away.q, self.ramp), _SHORTEST)])
        self._offset = Course(
            times,
            np.array([away.q, still]),
            np.array([away.v, still]),
            np.array([away.a, still]),
        )

    def _ramp_time(self, distance: Array, least: float) -> float:
        """Time [s] for a distance at the speed of ramps."""
        speed = self.ramp_speed * self._fastest
        return max(least, float((PEAK_SPEED * np.abs(distance) / speed).max(initial=0.0)))

    def _check(self, times: Array, q: Array, v: Array) -> None:
        """Refuse what leaves the limits; times (k,), q and v (k, n)."""
        if not (np.isfinite(q).all() and np.isfinite(v).all()):
            raise TargetError("reference refused: not finite")
        off = (q < self._lower - _ROUNDING) | (q > self._upper + _ROUNDING)
        if off.any():
            i, j = np.argwhere(off)[0]
            raise TargetError(
                f"reference refused: {self.names[j]} at {q[i, j]:.4g} at t = {times[i]:.4g} s; "
                f"accepted: {self._lower[j]:g} to {self._upper[j]:g}"
            )
        fast = np.abs(v) > self._fastest * (1.0 + _ROUNDING)
        if fast.any():
            i, j = np.argwhere(fast)[0]
            raise TargetError(
                f"reference refused: {self.names[j]} at {v[i, j]:.4g}/s at t = {times[i]:.4g} s; "
                f"accepted: up to {self._fastest[j]:g}/s"
            )
