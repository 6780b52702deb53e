"""Common part of nodes that answer joint states: stamps, clocks, reset."""

from collections.abc import Callable, Sequence
from functools import partial
from time import perf_counter
from typing import Any, Protocol

from rclpy.clock import Clock as RosClock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from mbd_ros.core.state import NANOSECOND
from mbd_ros.methods.signals.differentiation import SampleStatus
from mbd_ros.nodes.shell.scene_node import SceneNode
from mbd_ros.nodes.shell.serialized import require_size
from msg_adapters.diagnostics import OK, STALE, WARN
from msg_adapters.errors import MessageError, listed
from msg_adapters.joint_state import JointSample, JointStateReader
from msg_adapters.joint_state_cdr import JointStateCdrReader

# ---- joint state node -------------------------------------------------------------------------
# Common part of nodes that answer joint states: stamps, clocks, reset.


# Whether the clock of a simulation is alive, seen from a clock that never stands.

CLOCK = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
LOOK = 0.01  # s between looks
_FLOOR = 0.2  # s, some beats of a clock that stands
_SLACK = 4.0  # of the longest of the last waits
_FORGET = 0.99  # of that wait, a look that finds news
_REGULAR = 10  # looks with news until a clock counts as regular


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
        self._news, self._longest, self._quiet = 0, 0.0, 0.0
        self._has_died, self._looked = False, perf_counter()


class SimulatedClock:
    """The clock of a simulation that a node lives by, if it lives by one.

    Args:
        node: The node.
        steady: A clock that never stands.
    """

    def __init__(self, node: Node, steady: RosClock) -> None:
        self._node, self._steady = node, steady
        self._watch, self._hears = ClockWatch(), False

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
        """As that of `ClockWatch`."""
        return self._watch.silence(timeout)

    def fault(self, timeout: float) -> str:
        """What is wrong with it, to follow other words; empty where nothing is."""
        if not self.is_used:
            return ""
        if self.is_gone:
            return "; nobody publishes /clock any more"
        silence = self.silence(timeout)
        return f"; /clock is silent for {silence:.2f} s, a pause is not" if silence else ""


# Best effort also hears reliable publishers; the depth bridges a pause of 0.5 s at 1 kHz,
# beyond which the transport itself keeps no more.
SENSOR = QoSProfile(depth=500, reliability=ReliabilityPolicy.BEST_EFFORT)
_NEVER = -(2**62)  # ns
_STANDING = 0.5  # [s] for which one joint state may come again and again, or all be dropped
_DROPPED = 0.05  # share of the joint states of a second that may be dropped without a word
_LATELY = 1.5  # s, a bit more than the time between two diagnostics
MOST_IGNORED = 100  # joints whose names are kept to be listed once


class JointStateNode(SceneNode):
    """Hears `joint_states` and judges their stamps; subclasses answer.

    Subclasses override `build`, `forget` and `answer`. Parameters must hold scene, timeout and
    clock_tolerance.
    """

    STAMPED = "joint states"  # whose stamps count
    SAMPLE, TOPIC = "joint state", "joint_states"  # what is answered, and where it comes from
    _pipeline: "JointStatePipeline"

    def __init__(self, argv: Sequence[str] = ()) -> None:
        super().__init__(argv)
        self._newest, self._answered, self._is_stampless = 0, 0, False
        self._dropped, self._loss = 0, ""
        self._mark()
        self._moved = self._heard
        self._two_clocks = self._last_drop = ""
        self._extra: set[str] = set()
        self._simulated = SimulatedClock(self, self._steady)
        self.create_service(Trigger, "~/reset", self._on_reset)

    def forget(self) -> None:
        """Empty filters."""

    def answer(self, stamp: int, sample: JointSample) -> SampleStatus | None:
        """Answer a joint state of this time [ns]; why it cannot be used, if so."""
        raise NotImplementedError

    def configure_core(self) -> None:
        """Build, and listen."""
        super().configure_core()
        self.listen()

    def listen(self) -> None:
        """Subscribe to joint states."""
        self.subscribe(
            JointState, "joint_states", self._take, SENSOR, single_publisher=True, raw=True
        )

    def activate_core(self) -> None:
        """Begin with an empty past."""
        self.begin_anew()

    def reset(self, reason: str) -> None:
        """Begin anew: another past and another clock count alike."""
        self.begin_anew()

    def begin_anew(self) -> None:
        """Empty filters, forget all answers."""
        self._simulated.hear()
        self._newest, self._answered, self._agreed = 0, 0, _NEVER
        self._two_clocks = self._last_drop = ""
        self._mark()
        self._moved = self._heard
        if self.is_built:
            self.forget()

    def stream_details(self) -> dict[str, str]:
        """Of the last second, for diagnostics."""
        answered, self._answered = self._answered, 0
        dropped, self._dropped = self._dropped, 0
        is_much = dropped > _DROPPED * (dropped + answered)
        self._loss = f"{dropped} of {dropped + answered} {self.STAMPED} dropped" if is_much else ""
        return {
            "joints ignored": listed(sorted(self._extra)) or "none",
            "messages answered in the last second": str(answered),
            "messages dropped in the last second": str(dropped),
            f"age of the newest {self.SAMPLE}": f"{self._age():.6g}" if self._newest else "none",
        }

    def stream_health(self) -> tuple[int, str]:
        """STALE without answers, with the reason."""
        if not self.active:
            return OK, ""
        if self._two_clocks:
            return STALE, self._two_clocks
        dropped = f"; last one dropped: {self._last_drop}" if self._last_drop else ""
        if self._newest == 0:
            topic = self.resolve_topic_name(self.TOPIC)
            return STALE, f"no {self.SAMPLE} answered yet on {topic}{dropped}"
        if self._age() > self.parameters.timeout:
            return STALE, f"newest answered {self.SAMPLE} is {self._age():.2f} s old{dropped}"
        if self.silence() > self.parameters.timeout:
            why = self._simulated.fault(self.parameters.timeout) or dropped
            return STALE, f"no {self.SAMPLE} answered for {self.silence():.2f} s{why}"
        return self._standing_health()

    def _standing_health(self) -> tuple[int, str]:
        """WARN where joint states come and time stands all the same."""
        now = perf_counter()
        if self._last_drop and now - self._heard > _STANDING:
            return WARN, f"no {self.SAMPLE} answered, last one dropped: {self._last_drop}"
        if self._heard - self._moved > _STANDING and now - self._heard < _LATELY:
            stamp = self._newest * NANOSECOND
            return WARN, f"the {self.SAMPLE} of {stamp:.9g} s comes again and again: time stands"
        return OK, ""

    def silence(self) -> float:
        """For how long no joint state was answered [s]; a standing clock does not count.

        Where the clock of a simulation is silent or has no publisher any more, steady time counts.
        """
        if self._simulated.is_used and not self._simulated.is_gone:
            stood = (self.get_clock().now().nanoseconds - self._heard_ros) * NANOSECOND
            return max(stood, self._simulated.silence(self.parameters.timeout))
        return perf_counter() - self._heard

    def _take(self, cdr: bytes) -> None:
        """Read, judge and answer a serialized joint state."""
        pipeline = self._pipeline
        try:
            require_size(cdr, JointState)
            sample = pipeline.reader.read(cdr)
        except MessageError as error:
            self.drop_state("malformed", f"joint_states: {error}")
            return
        stamp = self.stamp_of(sample.stamp)
        if stamp is not None:
            self.judge(partial(self.answer, stamp, sample), pipeline.joints)

    def judge(self, answer: Callable[[], SampleStatus | None], joints: "Heard") -> None:
        """Answer a sample, or drop it and say why.

        Args:
            answer: Answers; why the sample cannot be used, if so.
            joints: What its messages carried.
        """
        try:
            refused = answer()
        except MessageError as error:
            self.drop_state("result", f"{self.TOPIC}: what would answer is dropped: {error}")
            return
        if refused is None:
            self._note_extra(joints.extra)
            return
        held = ", ".join(self._pipeline.held())
        lacking = f" ({held})" if refused is SampleStatus.INCOMPLETE else ""
        self.drop_state(refused.name.lower(), f"{self.TOPIC}: {refused.value}{lacking}")

    def stamp_of(self, stamp: int) -> int | None:
        """The stamp [ns], receive time instead of 0; None if it is of another clock."""
        stamp = stamp or self.receive_time()
        return stamp if self._same_clock(stamp) else None

    def receive_time(self) -> int:
        """Substitute of a stamp of 0 [ns]."""
        if not self._is_stampless:
            self._is_stampless = True
            self.get_logger().warning(f"stamp 0 in {self.STAMPED}: receive time is used")
        return int(self.get_clock().now().nanoseconds)

    def note_answer(self, stamp: int) -> None:
        """Remember that a joint state was answered."""
        is_new = stamp != self._newest
        self._newest, self._last_drop = stamp, ""
        self._answered += 1
        self._mark()
        if is_new:
            self._moved = self._heard

    def _note_extra(self, extra: tuple[str, ...]) -> None:
        """Remember joints of a joint state that are not used; list them once."""
        if not self._extra.issuperset(extra) and len(self._extra) < MOST_IGNORED:
            self._extra.update(extra[:MOST_IGNORED])
            self.get_logger().info(f"joints ignored: {listed(sorted(self._extra))}")

    def drop_state(self, reason: str, text: str) -> None:
        """Count a joint state that is not answered."""
        self._last_drop = text
        self._dropped += 1
        self.drop(reason, text)

    def _age(self) -> float:
        """Of the newest answered stamp [s]."""
        return (self.get_clock().now().nanoseconds - self._newest) * NANOSECOND

    def _mark(self) -> None:
        """Silence begins now."""
        self._heard, self._heard_ros = perf_counter(), self.get_clock().now().nanoseconds

    def _same_clock(self, stamp: int) -> bool:
        """Whether stamp and node clock are one clock; asked again whenever the stamps moved on."""
        tolerance = self.parameters.clock_tolerance
        if not self._two_clocks and abs(stamp - self._agreed) * NANOSECOND < tolerance:
            return True
        now = self.get_clock().now().nanoseconds
        ahead = (stamp - now) * NANOSECOND
        if now == 0 or abs(ahead) <= tolerance:
            self._two_clocks, self._agreed = "", stamp
            return True
        self._two_clocks = (
            f"{self.SAMPLE} of {stamp * NANOSECOND:.3f} s, node clock {now * NANOSECOND:.3f} s: "
            "two clocks; does use_sim_time fit the publisher?"
        )
        self.drop("two_clocks", self._two_clocks)
        return False

    def _on_reset(self, request: Any, response: Any) -> Any:
        self.begin_anew()
        response.success, response.message = True, "filters and buffers are empty"
        return response


# ---- joint state pipeline ---------------------------------------------------------------------
# Contracts of what a node that answers joint states builds when it is configured.


class Heard(Protocol):
    """What the newest messages carried."""

    @property
    def extra(self) -> tuple[str, ...]:
        """Joints that were not asked for."""
        ...


class JointStatePipeline(Protocol):
    """From serialized joint states to samples.

    Attributes:
        reader: Serialized joint states to samples.
        joints: Which joints the newest joint state carried.
    """

    reader: JointStateCdrReader
    joints: JointStateReader

    def held(self) -> Sequence[str]:
        """Joints that the newest joint state lacked, and that nothing else gives."""
        ...
