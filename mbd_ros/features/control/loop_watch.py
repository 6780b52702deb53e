"""Monitor of a control loop: tracking error, speed and delay against their bounds, and chatter.

The bounds of error and delay are those of the control law at rest, in several poses, for the
measured period. The delay is the age of the command whose echo a measured state carries. Chatter
is the power of the commands behind a high-pass filter.
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
_HORIZON = 0.2  # s, largest age of a command
_MISFIT_MEMORY = 0.005  # [s] after which a misfit is forgotten
_DECAY = (0.5, 0.95)  # smallest and largest factor of misfits in an update
_DISTINCT_MISFIT = 0.1  # largest ratio of the smallest misfit to those of ages around it
_ASIDE = 3  # distance of these ages in commands, besides a quarter of the age
_FEWEST_UPDATES = 3  # of a misfit before it counts
_REST_POSES = 12  # besides the initial pose
_LASTING = 0.04  # s beyond a bound until a fault, less half the tolerable delay
_STATES_IN_A_ROW = 2  # beyond a bound until a fault
_SETTLING = 0.5  # s of full control until the error is judged, unless it was small before
_FIRST_WAIT = 1.0  # s without a fault before control returns
_LONGEST_WAIT = 60.0  # s, after repeated faults
_CALM = 30.0  # s without a fault, after which the wait is the first one again
_OLDEST = 4.0  # largest age of compared commands, in tolerable delays
_RECENT = 0.03  # s, smallest bound of the age of compared commands
_LOST_SPEED = 2.0  # times the velocity limit, at which the loop counts as lost
_PERIOD_CHANGE = 0.25  # relative change of the period that updates the bounds
_PERIOD_WEIGHT = 0.1  # weight of the latest period


class LoopWatch:
    """Monitor that compares error, speed and delay of a loop with their bounds.

    A value that exceeds its bound for 20 to 40 ms is a fault: the safe command must take over.
    Control may return after 1 s without a fault of speed or delay. Every fault within 30 s of the
    last return doubles this wait, up to a minute. `reset` ends the wait at once.

    Args:
        names: Joints, for messages.
        controller: The control law; it may be replaced.
        rest: Responses of the joints at rest, from `rest_responses`.
        limits: Values beyond which the loop counts as lost.

    Attributes:
        fault: Reason for the safe command; empty without one.
        faults: Number of faults.
        period: Smoothed period of the states [s]; 0 while not known.
        tolerable: Delay that the loop tolerates [s]; inf while not known.
        error_bound: Bounds of the tracking errors [rad or m], shape (n,); inf while not known.
        meter: Meter of the delay.
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
        self._controller = controller
        self._computed = 0.0
        self.tolerable = np.inf
        self.error_bound = np.full(len(self._names), np.inf)

    def reset(self) -> None:
        """Forget a fault and all states."""
        self.fault = ""
        self._reasons = list[str]()
        self._late_by = 0.0
        self._wait = _FIRST_WAIT
        self._returned = -np.inf
        self.begin()

    def begin(self) -> None:
        """Start with the first state, or the first one after a gap."""
        self.meter.reset()
        self._intervals = 0
        self._exceeded = 0
        self._since = np.inf
        self._full: float | None = None
        self._is_settled = False

    @property
    def safe_step(self) -> float:
        """Time to add to the step of a safe command, which is delayed like any command [s].

        A damper with a delay D is stable as long as its time constant is at least 2 D / pi. D is
        the measured delay, or `LONGEST` after a loss without a measurement.
        """
        measured = self.meter.delay
        late_by = self._late_by if measured is None or self.fault else measured
        return 2.0 * max(late_by, measured or 0.0)

    @property
    def delay(self) -> float | None:
        """Measured delay [s]; None while not known."""
        return self.meter.delay

    def warnings(self) -> list[str]:
        """Return a sentence for each value that is beyond its bound now."""
        none = f"the gains tolerate no delay at a period of {1e3 * self.period:.3g} ms"
        return [*self._reasons, *([none] if self.tolerable == 0.0 else [])]

    def update(
        self, t: float, dt: float, error: Array, v: Array, effort: Array | None, is_full: bool
    ) -> None:
        """Judge a state.

        Args:
            t: Time of the state [s].
            dt: Time since the last state [s].
            error: Tracking errors [rad or m], shape (n,).
            v: Velocities [rad/s or m/s], shape (n,).
            effort: Efforts that acted until then [N·m or N], NaN if not measured, shape (n,);
                None without any.
            is_full: Whether the safe command has no share.
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
            self._exceeded = 0

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
        """Compute the bounds for this period: the smallest ones over the poses."""
        self._computed, law = self.period, self._controller
        gains = [law.loop_gains(r, self.period) for r in self._rest]
        delays = [tolerable_delay(g, self.period).min() for g in gains if g is not None]
        self.tolerable = float(min(delays)) if delays else np.inf
        bounds = [law.tracking_bound(r, self.period) for r in self._rest]
        self.error_bound = np.max(bounds, axis=0) if bounds else self.error_bound

    def _note_settling(self, t: float, error: Array, is_full: bool) -> None:
        """Judge errors only after a hand-over, whose errors are not those of the control law."""
        if not is_full:
            self._full, self._is_settled = None, False
        elif not self._is_settled:
            self._full = t if self._full is None else self._full
            is_small = bool((np.abs(error) <= self.error_bound).all())
            self._is_settled = is_small or t - self._full > _SETTLING

    def _late(self) -> list[str]:
        delay = self.meter.delay
        if delay is None or delay <= self.tolerable + 0.5 * self.period:
            return []
        return [f"loop delay {1e3 * delay:.3g} ms, tolerable are {1e3 * self.tolerable:.3g} ms"]

    def _too_late(self) -> list[str]:
        """Return the delay as a reason for a fault, unless the gains tolerate no delay at all."""
        return self._late() if self.tolerable > 0.0 else []

    def _fast(self, v: Array, margin: float) -> list[str]:
        limit = margin * self.limits.speed
        if (np.abs(v) <= limit).all():
            return []
        return [f"speed {self._worst(np.abs(v), limit)} beyond its limit"]

    def _off(self, error: Array, factor: float) -> list[str]:
        size, bounds = np.abs(error), self.error_bound
        if not self._is_settled or factor == np.inf or (size <= factor * bounds).all():
            return []
        return [f"tracking error {self._worst(size, bounds)} beyond its bound"]

    def _worst(self, size: Array, limit: Array) -> str:
        k = int((size / np.maximum(limit, 1e-12)).argmax())
        return f"{size[k]:.3g} of {self._names[k]} (bound {limit[k]:.3g})"

    def _maybe_end(self, t: float, lost: list[str]) -> None:
        if not lost:
            self._exceeded = 0
            return
        if not self._exceeded:
            self._since = t
        self._exceeded += 1
        lasting = _LASTING - 0.5 * min(self.tolerable, LONGEST)  # a late answer shows late
        if self._exceeded >= _STATES_IN_A_ROW and t - self._since >= lasting:
            is_again = t - self._returned < _CALM
            self._wait = min(2.0 * self._wait, _LONGEST_WAIT) if is_again else _FIRST_WAIT
            self.fault = "; ".join(lost)
            self._since = t
            self._exceeded = 0
            self.faults += 1
            self._late_by = LONGEST if self.meter.delay is None else self.meter.delay
            self.meter.reset()  # the delay is measured again, or forgotten

    def _maybe_return(self, t: float, is_lost: bool) -> None:
        if is_lost or t < self._since:  # also the first state after a gap
            self._since = t
        elif t - self._since >= self._wait:
            self.fault = ""
            self._returned = t
            self.begin()


class LossLimits(NamedTuple):
    """Values beyond which the loop counts as lost.

    Attributes:
        speed: Velocity of each joint [rad/s or m/s], shape (n,); inf without a limit.
        error: Multiple of the error bound of the control law; with inf the error is only reported.
    """

    speed: Array
    error: float


class DelayMeter:
    """Meter of the loop delay, by the sent command whose echo is the measured effort.

    A drive reports with each state the effort that acted until then, exactly (a simulator) or with
    noise. For every age of a command, the squared difference between echo and command is summed
    and forgotten exponentially. The age with the smallest sum is the delay if that sum is far
    below those of ages around it. Efforts that do not change show no age, nor does a drive that
    reports no effort or another one. The transport need not carry any time.

    Args:
        size: Number of joints.

    Attributes:
        delay: Age of the command less the one period for which it acts [s]; None while not known.

    Source: The sum is the average square difference function of time delay estimation;
        G. Jacovitti, G. Scarano, IEEE Trans. Signal Process. 41, 1993, 525-533.
    """

    def __init__(self, size: int) -> None:
        self._sent = np.zeros((2 * _CAPACITY, size))  # from `_first` on, latest first
        self._times = np.zeros(2 * _CAPACITY)
        self._misfits = np.zeros(_CAPACITY)
        self.reset()

    def reset(self) -> None:
        """Forget all commands."""
        self.delay: float | None = None
        self._count = 0
        self._first = _CAPACITY

    def send(self, t: float, effort: Array) -> None:
        """Record the command of shape (n,) that answers the state of time t [s]."""
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
            t: Time of the state, later than that of the last command [s].
            effort: Measured effort [N·m or N], shape (n,); ignored unless it is finite.
            period: Time for which a command acts [s].
            oldest: Largest age of compared commands [s].
        """
        total = float(effort.sum())
        if total - total != 0.0:
            return
        reach = int(min(oldest, _HORIZON) / period) + _ASIDE + _FEWEST_UPDATES
        count, first = min(self._count, reach), self._first
        difference = self._sent[first : first + count] - effort
        misfits = self._misfits[:count]
        misfits *= min(max(math.exp(-period / _MISFIT_MEMORY), _DECAY[0]), _DECAY[1])
        misfits += np.einsum("ij,ij->i", difference, difference)
        best = self._best(misfits[: count - _FEWEST_UPDATES]) if count > _FEWEST_UPDATES else None
        if best is not None:
            self.delay = max(t - float(self._times[first + best]) - period, 0.0)

    def _best(self, misfits: Array) -> int | None:
        """Return the index of the smallest misfit if it is far below those of ages around it."""
        best = int(misfits.argmin())
        aside = _ASIDE + best // 4
        if best + aside >= len(misfits):
            return None
        around = min(misfits[best + aside], misfits[best - aside] if best >= aside else np.inf)
        return best if misfits[best] <= _DISTINCT_MISFIT * around and around > 0.0 else None


def rest_responses(joints: ControlledJoints, initial: State) -> list[Response]:
    """Compute the responses of joints at rest, in the initial pose and in random ones."""
    system, newest = joints.system, joints.newest
    rng, robot = np.random.default_rng(0), system.robot
    lower = np.array([max(joint.lower, -np.pi) for joint in robot.joints])
    upper = np.array([min(joint.upper, np.pi) for joint in robot.joints])
    poses = [initial.q, *(rng.uniform(lower, upper) for _ in range(_REST_POSES))]
    zero, responses = np.zeros(robot.model.nv), []
    for q in poses:
        try:
            at_rest = system.reduce(State(initial.t, q, zero))
            responses.append(joints.response(system.expand(assemble(system, at_rest))))
        except SolveError:  # the loops cannot close in this pose
            continue
    joints.newest = newest
    return responses


class ChatterMeter:
    """Mean square of commands above a frequency, forgotten exponentially.

    A command u is constant until the next one. A critically damped high-pass of second order,

        h = (s / (s + w))^2 u,   w = 2 pi f / sqrt(1 + sqrt 2)

    with half power at f passes chatter, but only 6e-4 of the power of a motion at 0.1 f. Then

        T E' = h^2 - E

    Both are integrated exactly over constant commands, so that E does not depend on how a constant
    command is divided into samples. A command counts from the next update on, when it has acted.

    Args:
        size: Number of joints.
        cutoff: Frequency f above which a command counts as chatter; arm and leg movements stay
            below 10 Hz.
        memory: Time constant T, > 0.

    Attributes:
        energy: E of each joint [(N·m)^2 or N^2], shape (n,); a new array in each update.

    Source: The steps are the variation of constants of the two filters.
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
        """Sum of `energy`, which is meaningful for joints of one unit [(N·m)^2 or N^2]."""
        return float(self.energy.sum())

    def reset(self) -> None:
        """Forget the past; the next command counts as constant since ever."""
        self.energy: Array = np.zeros(len(self._u))
        self._is_new = True

    def update(self, u: Array, dt: float) -> None:
        """Add a command.

        Args:
            u: Finite efforts [N·m or N], shape (n,).
            dt: Time since the last command [s]; a negative time counts as 0.
        """
        if self._is_new:
            self._first[:], self._second[:], self._is_new = u, 0.0, False
        elif dt > 0.0:
            self._advance(dt)
        self._u[:] = u

    def _advance(self, dt: float) -> None:
        """Advance under the last command: h = exp(-w t) (h0 - w t d), with d = u - first at 0."""
        if dt != self._dt:
            self._dt, self._factors = dt, self._factors_of(dt)
        decay, ramp, fading, square, cross, slope = self._factors
        d = self._u - self._first
        h = d - self._second
        self.energy = fading * self.energy + square * (h * h) - cross * (h * d) + slope * (d * d)
        self._first += (1.0 - decay) * d
        self._second *= decay
        self._second += ramp * d

    def _factors_of(self, dt: float) -> tuple[float, float, float, float, float, float]:
        """Return the decay of d, its share in `second`, and the coefficients of E+ in E, h0 and d.

        E+ = e^{-dt/T} E + 1/T integral of e^{-(dt-t)/T} e^{-2wt} (h0 - wtd)^2 over [0, dt]; the
        substitution t = dt x leaves moments of e^{-ax} with a = (2w - 1/T) dt.
        """
        wt, forget = self._w * dt, dt / self._memory
        decay, fading = math.exp(-wt), math.exp(-forget)
        m0, m1, m2 = (forget * m for m in _moments(2.0 * wt - forget, fading, decay * decay))
        return decay, decay * wt, fading, m0, 2.0 * wt * m1, wt * wt * m2


def _moments(a: float, start: float, end: float) -> tuple[float, float, float]:
    """Return the integrals of x^k start exp(-a x) over [0, 1] for k = 0, 1, 2.

    Args:
        end: Value of start exp(-a).
    """
    if abs(a) < 1.0:  # the closed forms cancel: x^k exp(-a x) as a series
        terms = [start * (-a) ** j / math.factorial(j) for j in range(20)]
        sums = (sum(t / (j + k + 1) for j, t in enumerate(terms)) for k in range(3))
        return next(sums), next(sums), next(sums)
    m0 = (start - end) / a
    m1 = (m0 - end) / a
    return m0, m1, (2.0 * m1 - end) / a
