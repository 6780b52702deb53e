"""The topic `/clock`: messages that are no time, and whether a simulation still publishes it."""

from collections.abc import Callable
from time import perf_counter
from typing import Any

from rclpy.clock import Clock as RosClock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

from msg_adapters.errors import MessageError
from msg_adapters.time import read_clock

CLOCK = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
LOOK = 0.01  # s between looks
_FLOOR = 0.2  # s, some beats of a clock that stands
_SLACK = 4.0  # of the longest of the last waits
_FORGET = 0.99  # of that wait, a look that finds news
_REGULAR = 10  # looks with news until a clock counts as regular


def guard_clock(node: Node, drop: Callable[[str], None]) -> None:
    """Let a node in simulated time ignore messages of /clock without a valid time.

    A negative second raises in rclpy, out of the callback; a nanosec of a second or more gives a
    time that no stamp can carry.

    Args:
        node: The node, as constructed.
        drop: Told of each ignored message.
    """
    source = node._time_source
    take = source.clock_callback

    def take_if_time(msg: Any) -> None:
        try:
            now = read_clock(msg)
        except MessageError as error:
            drop(f"/clock: {error}")
            return
        if now < 0:
            drop(
                f"/clock: {msg.clock.sec} s is before the beginning of time; accepted: 0 and more"
            )
            return
        take(msg)

    source.clock_callback = take_if_time  # of a subscription that is made later
    if source._clock_sub is not None:
        source._clock_sub.callback = take_if_time


class SimulatedClock:
    """The clock of a simulation that a node lives by, if it lives by one.

    Args:
        steady: A clock that never stands.
    """

    def __init__(self, node: Node, steady: RosClock) -> None:
        self._node = node
        self._steady = steady
        self._watch = ClockWatch()
        self._hears = False

    @property
    def is_used(self) -> bool:
        """Whether the node has the time of a simulation."""
        clock = self._node.get_clock()
        return clock.clock_type == ClockType.ROS_TIME and clock.ros_time_is_active

    @property
    def is_gone(self) -> bool:
        """Whether the node has its time, and nobody publishes it."""
        return self.is_used and not self._node.count_publishers("/clock")

    def hear(self) -> None:
        """Watch /clock from the first time on that it counts."""
        if self.is_used and not self._hears:
            self._hears = True
            self._node.create_subscription(Clock, "/clock", self._watch.hear, CLOCK, raw=True)
            self._node.create_timer(LOOK, self._watch.look, clock=self._steady)

    def silence(self, timeout: float) -> float:
        """For how long it has been silent [s], as `ClockWatch.silence` says."""
        return self._watch.silence(timeout)

    def fault(self, timeout: float) -> str:
        """Return what is wrong with the clock, as the end of a sentence; empty if nothing is."""
        if not self.is_used:
            return ""
        if self.is_gone:
            return "; nobody publishes /clock any more"
        silence = self.silence(timeout)
        return f"; /clock is silent for {silence:.2f} s, a pause is not" if silence else ""


class ClockWatch:
    """Measures how long a clock has been silent that used to send messages.

    Simulated time does not tell a pause from a death: it stands in both. Nor does the graph, which
    keeps a killed publisher for up to 20 s. A simulator that is paused, slow or waiting repeats
    its time; one that was killed or hangs does not. The accepted wait is learnt from earlier ones.
    Time in which this process itself did not run counts for no more than two looks: where the
    whole machine stands, the clock is not to blame.
    """

    def __init__(self) -> None:
        self._messages = self._seen = 0
        self._forget()

    def hear(self, message: Any) -> None:
        """A message came."""
        self._messages += 1

    def look(self) -> None:
        """To be called every `LOOK` [s] of steady time."""
        now = perf_counter()
        self._quiet += min(now - self._looked, 2.0 * LOOK)
        self._looked = now
        if self._messages == self._seen:
            return
        if self._has_died or not self._news:
            self._forget()  # the first message, or another clock: it has a pace of its own
        self._seen, self._news = self._messages, self._news + 1
        self._longest = max(_FORGET * self._longest, self._quiet)
        self._quiet = 0.0

    def silence(self, timeout: float) -> float:
        """For how long the clock has been silent [s]; 0 while it is alive, or never was regular.

        Args:
            timeout: Shorter waits are none [s].
        """
        limit = max(timeout, _FLOOR, _SLACK * self._longest)
        self._has_died = self._news >= _REGULAR and self._quiet > limit
        return self._quiet if self._has_died else 0.0

    def _forget(self) -> None:
        self._news = 0
        self._longest = 0.0
        self._quiet = 0.0
        self._has_died = False
        self._looked = perf_counter()
