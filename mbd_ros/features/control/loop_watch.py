"""Whether a control loop does what its gains promise, and when its command must go safe.

The bounds of error and delay are those of the control law at rest, in several poses, for the
measured period. The delay is the age of the command whose echo a measured state carries. How much
the commands chatter is the power that a high-pass leaves of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np

from mbd_ros.core.ranges import Unit, Within
from mbd_ros.core.state import Array, State
from mbd_ros.errors import SolveError
from mbd_ros.methods.control.contract import (
    LONGEST,
    ControlledJoints,
    Controller,
    Response,
    tolerable_delay,
)
from mbd_ros.methods.projection.assembly import assemble

_CAPACITY = 512  # commands whose age is compared with the measured effort
_HORIZON = 0.2  # [s] that a command may be old
_MISFIT_MEMORY = 0.005  # [s] after which a misfit is forgotten
_KEPT_SHARE = (0.5, 0.95)  # least and largest share of misfits that an update keeps
_DISTINCT_MISFIT = 0.1  # share of the misfits about the best one that this may have
_ASIDE = 3  # so many commands before and after it, and a quarter of its age
_FEWEST_UPDATES = 3  # updates of a misfit that counts
_REST_POSES = 12  # beside the initial one
_HELD = 0.04  # [s] for which a bound must be passed, less half the tolerable delay
_STATES_IN_A_ROW = 2  # that must be beyond a bound
_SETTLING = 0.5  # [s] of full control until the error is judged, where it was not small before
_FIRST_WAIT = 1.0  # [s] without a fault before control returns
_LONGEST_WAIT = 60.0  # [s], after faults in a row
_CALM = 30.0  # [s] without a fault after which the wait is the first one again
_OLDEST = 4.0  # times the tolerable delay: ages of commands that are looked for
_RECENT = 0.03  # [s] that are looked for at least
_LOST_SPEED = 2.0  # times the velocity limit: beyond, the loop counts as lost
_PERIOD_CHANGE = 0.25  # of the period, after which the bounds are computed anew
_PERIOD_WEIGHT = 0.1  # weight of the newest period


class LoopWatch:
    """Compares error, speed and delay of a loop with its bounds.

    A value beyond its bound for 20 to 40 ms is a fault: the command has to go safe. Control may
    return after a wait of 1 s without a fault of speed or delay. Every fault within 30 s of the
    last return doubles the wait, up to a minute. `reset` ends it at once.

    Args:
        controller: The control law; may be replaced.
        rest: From `rest_responses`.
        limits: When the loop counts as lost.

    Attributes:
        fault: Why the command has to go safe; empty while it need not.
        faults: How often it had to.
        period: Of the states, smoothed [s]; 0 while not known.
        tolerable: Delay that the loop tolerates [s]; inf while not known.
        promised: Errors that the control law promises [rad or m], shape (n,); inf while not known.
        meter: Measures the delay.
    """

    def __init__(
        self,
        names: Sequence[str],
        controller: Controller,
        rest: Sequence[Response],
        limits: LossLimits,
    ) -> None:
        self._names, self._rest, self.limits = tuple(names), rest, limits
        self.meter, self.faults = DelayMeter(len(names)), 0
        self.period = 0.0
        self.reset()
        self.use(controller)

    def use(self, controller: Controller) -> None:
        """Watch another control law from now on."""
        self._controller, self._computed = controller, 0.0
        self.tolerable, self.promised = np.inf, np.full(len(self._names), np.inf)

    def reset(self) -> None:
        """Forget a fault and all states."""
        self.fault, self._reasons, self._late_by = "", list[str](), 0.0
        self._wait, self._back = _FIRST_WAIT, -np.inf
        self.begin()

    def begin(self) -> None:
        """States come, for the first time or again."""
        self.meter.reset()
        self._intervals, self._passed, self._since = 0, 0, np.inf
        self._full: float | None = None
        self._is_settled = False

    @property
    def safe_step(self) -> float:
        """Time to add to the step of a safe command, which is as late as any other [s].

        A damper that is late by D is stable as long as it brakes no faster than within 2 D / pi.
        D is what was measured; after a loss without a measurement it is taken for `LONGEST`.
        """
        measured = self.meter.delay
        late_by = self._late_by if measured is None or self.fault else measured
        return 2.0 * max(late_by, measured or 0.0)

    @property
    def delay(self) -> float | None:
        """The measured delay [s], if any."""
        return self.meter.delay

    def warnings(self) -> list[str]:
        """Values beyond their bounds now, one sentence each."""
        none = f"the gains leave no room for a delay at a period of {1e3 * self.period:.3g} ms"
        return [*self._reasons, *([none] if self.tolerable == 0.0 else [])]

    def update(
        self, t: float, dt: float, error: Array, v: Array, effort: Array | None, is_full: bool
    ) -> None:
        """Look at a state.

        Args:
            t: [s].
            dt: Since the last one [s].
            error: Of the joints, shape (n,).
            v: Their velocities, shape (n,).
            effort: What acted until then, NaN where not measured, shape (n,); None without.
            is_full: Whether the safe command takes no part.
        """
        if dt > 0.0:
            self._note_period(dt)
            if effort is not None:
                oldest = max(_OLDEST * min(self.tolerable, LONGEST), _RECENT)
                self.meter.measure(t, effort, self.period, oldest)
        self._note_settling(t, error, is_full)
        self._reasons = self._late() + self._fast(v, 1.0) + self._off(error, 1.0)
        if self.fault:
            self._maybe_return(t, bool(self._too_late() + self._fast(v, _LOST_SPEED)))
        elif self._reasons:
            far = self._off(error, self.limits.error)
            self._maybe_end(t, self._too_late() + self._fast(v, _LOST_SPEED) + far)
        else:
            self._passed = 0

    def _note_period(self, dt: float) -> None:
        self._intervals += 1
        share = max(_PERIOD_WEIGHT, 1.0 / self._intervals)
        self.period += share * (dt - self.period)
        if (
            self._intervals >= 10
            and abs(self.period - self._computed) > _PERIOD_CHANGE * self._computed
        ):
            self._compute()

    def _compute(self) -> None:
        """The bounds for this period: the worst over the poses."""
        self._computed, law = self.period, self._controller
        gains = [law.loop_gains(r, self.period) for r in self._rest]
        delays = [tolerable_delay(g, self.period).min() for g in gains if g is not None]
        self.tolerable = float(min(delays)) if delays else np.inf
        bounds = [law.tracking_bound(r, self.period) for r in self._rest]
        self.promised = np.max(bounds, axis=0) if bounds else self.promised

    def _note_settling(self, t: float, error: Array, is_full: bool) -> None:
        """The error that a hand-over leaves is not that of the control law."""
        if not is_full:
            self._full, self._is_settled = None, False
        elif not self._is_settled:
            self._full = t if self._full is None else self._full
            is_small = bool((np.abs(error) <= self.promised).all())
            self._is_settled = is_small or t - self._full > _SETTLING

    def _late(self) -> list[str]:
        delay = self.meter.delay
        if delay is None or delay <= self.tolerable + 0.5 * self.period:
            return []
        return [f"loop delay {1e3 * delay:.3g} ms, tolerable are {1e3 * self.tolerable:.3g} ms"]

    def _too_late(self) -> list[str]:
        """A delay that ends the loop: where gains leave no room for any, error and speed judge."""
        return self._late() if self.tolerable > 0.0 else []

    def _fast(self, v: Array, margin: float) -> list[str]:
        limit = margin * self.limits.speed
        if (np.abs(v) <= limit).all():
            return []
        return [f"speed {self._worst(np.abs(v), limit)} beyond its limit"]

    def _off(self, error: Array, factor: float) -> list[str]:
        size, bounds = np.abs(error), self.promised
        if not self._is_settled or factor == np.inf or (size <= factor * bounds).all():
            return []
        return [f"tracking error {self._worst(size, bounds)} beyond its bound"]

    def _worst(self, size: Array, limit: Array) -> str:
        k = int((size / np.maximum(limit, 1e-12)).argmax())
        return f"{size[k]:.3g} of {self._names[k]} (bound {limit[k]:.3g})"

    def _maybe_end(self, t: float, lost: list[str]) -> None:
        if not lost:
            self._passed = 0
            return
        if not self._passed:
            self._since = t
        self._passed += 1
        held = _HELD - 0.5 * min(self.tolerable, LONGEST)  # a late answer shows late
        if self._passed >= _STATES_IN_A_ROW and t - self._since >= held:
            is_again = t - self._back < _CALM
            self._wait = min(2.0 * self._wait, _LONGEST_WAIT) if is_again else _FIRST_WAIT
            self.fault, self._since, self._passed = "; ".join(lost), t, 0
            self.faults += 1
            self._late_by = LONGEST if self.meter.delay is None else self.meter.delay
            self.meter.reset()  # it is to be measured anew, or to be forgotten

    def _maybe_return(self, t: float, is_lost: bool) -> None:
        if is_lost or t < self._since:  # also the first state after a gap
            self._since = t
        elif t - self._since >= self._wait:
            self.fault, self._back = "", t
            self.begin()


class LossLimits(NamedTuple):
    """When the loop counts as lost.

    Attributes:
        speed: Velocity of each joint [rad/s or m/s], shape (n,); inf without a limit.
        error: Multiple of the error bound of the control law; inf: the error is only reported.
    """

    speed: Array
    error: float


class DelayMeter:
    """Finds the sent command whose echo is the measured effort.

    A drive tells with each state the effort that acted until then, exactly (a simulator) or with
    noise. For every age of a command the squared difference between echo and command is summed
    and forgotten exponentially; the age with the least sum is that of the loop, where that sum is
    far below those of ages about it: efforts that do not change tell no age, and a drive that
    reports no effort, or another one, tells nothing. The transport need not help.

    Args:
        size: Number of joints.

    Attributes:
        delay: Age of the command less one period, for which it acts [s]; None while not known.

    Source: the sum is the average square difference function of time delay estimation;
        G. Jacovitti, G. Scarano, IEEE Trans. Signal Process. 41, 1993, 525-533.
    """

    def __init__(self, size: int) -> None:
        self._sent = np.zeros((2 * _CAPACITY, size))  # from `first` on, newest first
        self._times = np.zeros(2 * _CAPACITY)
        self._misfits = np.zeros(_CAPACITY)
        self.reset()

    def reset(self) -> None:
        """Forget what was sent."""
        self.delay: float | None = None
        self._count, self._first = 0, _CAPACITY

    def send(self, t: float, effort: Array) -> None:
        """Note the command that answers the state of time t [s]; effort of shape (n,)."""
        if self._first == 0:
            self._first = _CAPACITY
            self._sent[_CAPACITY:] = self._sent[:_CAPACITY]
            self._times[_CAPACITY:] = self._times[:_CAPACITY]
        self._first -= 1
        self._sent[self._first], self._times[self._first] = effort, t
        if self._count < _CAPACITY:
            self._misfits[self._count] = 0.0
            self._count += 1

    def measure(self, t: float, effort: Array, period: float, oldest: float = _HORIZON) -> None:
        """Compare the effort that acted until a time with the commands that were sent before.

        Args:
            t: Of the state, later than that of the last command [s].
            effort: [N·m or N], shape (n,); nothing is learned from one that is not finite.
            period: Time for which a command acts [s].
            oldest: Age up to which commands are compared [s].
        """
        total = float(effort.sum())
        if total - total != 0.0:
            return
        reach = int(min(oldest, _HORIZON) / period) + _ASIDE + _FEWEST_UPDATES
        count, first = min(self._count, reach), self._first
        miss = self._sent[first : first + count] - effort
        misfits = self._misfits[:count]
        misfits *= min(max(math.exp(-period / _MISFIT_MEMORY), _KEPT_SHARE[0]), _KEPT_SHARE[1])
        misfits += np.einsum("ij,ij->i", miss, miss)
        best = self._best(misfits[: count - _FEWEST_UPDATES]) if count > _FEWEST_UPDATES else None
        if best is not None:
            self.delay = max(t - float(self._times[first + best]) - period, 0.0)

    def _best(self, misfits: Array) -> int | None:
        """Where the least misfit is, if it stands out: far below those of ages about it."""
        best = int(misfits.argmin())
        aside = _ASIDE + best // 4
        if best + aside >= len(misfits):
            return None
        around = min(misfits[best + aside], misfits[best - aside] if best >= aside else np.inf)
        return best if misfits[best] <= _DISTINCT_MISFIT * around and around > 0.0 else None


def rest_responses(joints: ControlledJoints, initial: State) -> list[Response]:
    """How the joints answer at rest: in the initial pose, and in others within their limits."""
    system, newest = joints.system, joints.newest
    rng, robot = np.random.default_rng(0), system.robot
    lower = np.array([max(joint.lower, -np.pi) for joint in robot.joints])
    upper = np.array([min(joint.upper, np.pi) for joint in robot.joints])
    poses = [initial.q, *(rng.uniform(lower, upper) for _ in range(_REST_POSES))]
    still, found = np.zeros(robot.model.nv), []
    for q in poses:
        try:
            at_rest = system.reduce(State(initial.t, q, still))
            found.append(joints.response(system.expand(assemble(system, at_rest))))
        except SolveError:  # a pose that the loops cannot take
            continue
    joints.newest = newest
    return found


class ChatterMeter:
    """Mean square of commands above a frequency, forgotten exponentially.

    Commands u are held until the next one. A critically damped high-pass of second order,

        h = (s / (s + w))^2 u,   w = 2 pi f / sqrt(1 + sqrt 2)

    with half power at f leaves a motion at 0.1 f with 6e-4 of its power; chatter passes. Then

        T E' = h^2 - E

    Both are integrated exactly over every hold, so that E does not depend on how a constant
    command is divided into samples. A command counts once it has acted, that is, from the next
    update on.

    Args:
        size: Number of joints.
        cutoff: Frequency f from which motion of a command counts as chatter; arm and leg
            movements stay below 10 Hz.
        memory: T, > 0.

    Attributes:
        energy: E of each joint [(N·m)^2 or N^2], shape (n,); a new array each update.

    Source: the steps are the variation of constants of the two filters.
    """

    def __init__(
        self,
        size: int,
        cutoff: Annotated[float, Within(1.0e-3, 1.0e6), Unit("Hz")] = 20.0,
        memory: Annotated[float, Unit("s")] = 0.5,
    ) -> None:
        self._w = 2.0 * math.pi * cutoff / math.sqrt(1.0 + math.sqrt(2.0))
        self._memory = memory
        self._dt, self._factors = -1.0, (1.0, 0.0, 1.0, 0.0, 0.0, 0.0)
        self._first, self._second = np.zeros(size), np.zeros(size)  # u - first, less second, is h
        self._u = np.zeros(size)
        self.reset()

    @property
    def rms(self) -> Array:
        """Square root of `energy` [N·m or N], shape (n,)."""
        return np.sqrt(self.energy)

    @property
    def total(self) -> float:
        """Energy of all joints; of use where they have one unit [(N·m)^2 or N^2]."""
        return float(self.energy.sum())

    def reset(self) -> None:
        """Forget the past; the next command counts as held for ever."""
        self.energy: Array = np.zeros(len(self._u))
        self._is_new = True

    def update(self, u: Array, dt: float) -> None:
        """Take a new command.

        Args:
            u: [N·m or N], finite, shape (n,).
            dt: Time since the last one [s]; what is < 0 counts as 0.
        """
        if self._is_new:
            self._first[:], self._second[:], self._is_new = u, 0.0, False
        elif dt > 0.0:
            self._advance(dt)
        self._u[:] = u

    def _advance(self, dt: float) -> None:
        """Hold the last command for a time: h = exp(-w t) (h0 - w t d), d = u - first at 0."""
        if dt != self._dt:
            self._dt, self._factors = dt, self._factors_of(dt)
        decay, ramp, kept, square, cross, slope = self._factors
        d = self._u - self._first
        h = d - self._second
        self.energy = kept * self.energy + square * (h * h) - cross * (h * d) + slope * (d * d)
        self._first += (1.0 - decay) * d
        self._second *= decay
        self._second += ramp * d

    def _factors_of(self, dt: float) -> tuple[float, float, float, float, float, float]:
        """Decay of d, its share in `second`, and E+ as a form in E, h0 and d.

        E+ = e^{-dt/T} E + 1/T integral of e^{-(dt-t)/T} e^{-2wt} (h0 - wtd)^2 over [0, dt]; the
        substitution t = dt x leaves moments of e^{-ax} with a = (2w - 1/T) dt.
        """
        wt, forget = self._w * dt, dt / self._memory
        decay, kept = math.exp(-wt), math.exp(-forget)
        m0, m1, m2 = (forget * m for m in _moments(2.0 * wt - forget, kept, decay * decay))
        return decay, decay * wt, kept, m0, 2.0 * wt * m1, wt * wt * m2


def _moments(a: float, start: float, end: float) -> tuple[float, float, float]:
    """Integrals of x^k start exp(-a x) over [0, 1], k = 0, 1, 2; it ends at `end`."""
    if abs(a) < 1.0:  # the closed forms cancel: x^k exp(-a x) as a series
        terms = [start * (-a) ** j / math.factorial(j) for j in range(20)]
        sums = (sum(t / (j + k + 1) for j, t in enumerate(terms)) for k in range(3))
        return next(sums), next(sums), next(sums)
    m0 = (start - end) / a
    m1 = (m0 - end) / a
    return m0, m1, (2.0 * m1 - end) / a
