"""A stream of joint states that a node answers: their stamps, clocks and silence."""

from collections.abc import Callable, Sequence
from functools import partial
from time import perf_counter
from typing import Any, Protocol

from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from mbd_ros.core.state import NANOSECOND
from mbd_ros.errors import MbdError, SolveError
from mbd_ros.methods.signals.differentiation import SampleStatus
from mbd_ros.nodes.shell.clock import SimulatedClock
from mbd_ros.nodes.shell.robot_description import RobotDescription
from mbd_ros.nodes.shell.serialized import require_size
from mbd_ros.nodes.shell.shell import Shell
from msg_adapters.diagnostics import OK, STALE, WARN
from msg_adapters.errors import MessageError, listed
from msg_adapters.joint_state import JointSample, JointStateReader
from msg_adapters.joint_state_cdr import JointStateCdrReader

# Best effort also hears reliable publishers; the depth bridges a pause of 0.5 s at 1 kHz,
# beyond which the transport itself keeps no more.
SENSOR = QoSProfile(depth=500, reliability=ReliabilityPolicy.BEST_EFFORT)
_NEVER = -(2**62)  # ns
_STANDING = 0.5  # [s] for which one joint state may come again and again, or all be dropped
_DROPPED = 0.05  # share of the joint states of a second that may be dropped without a word
_LATELY = 1.5  # s, a bit more than the time between two diagnostics
MOST_IGNORED = 100  # joints whose names are kept to be listed once

Answering = Callable[[int, JointSample], SampleStatus | None]


class JointStateStream:
    """Judges the samples that a node answers, and reports what became of them.

    A sample is a joint state, or whatever else a node answers in its place. It is dropped where
    it is malformed, where its stamp is of another clock than that of the node, and where the node
    has no answer. The service `~/reset` empties filters and buffers.

    Args:
        node: The node. Its parameters must hold timeout and clock_tolerance.
        description: Builds the scene of the node.
        pipeline: Gives what was built last.
        forget: Empties its filters.
        sample: What is answered.
        topic: Where that comes from.
        stamped: Whose stamps count.
        plural: Of the samples, for messages.

    Attributes:
        failures: Samples in a row that had no solution; a node sets it to 0 where one has.
        loss: Which share of the samples of the last second was dropped; empty if it was small.
    """

    def __init__(
        self,
        node: Shell,
        description: RobotDescription,
        pipeline: Callable[[], "JointStatePipeline"],
        forget: Callable[[], None],
        *,
        sample: str = "joint state",
        topic: str = "joint_states",
        stamped: str = "joint states",
        plural: str = "joint states",
    ) -> None:
        self._node = node
        self._description = description
        self._pipeline = pipeline
        self._forget = forget
        self._sample = sample
        self._topic = topic
        self._stamped = stamped
        self._plural = plural
        self.failures = 0
        self._newest = 0
        self._answered = 0
        self._is_stampless = False
        self._dropped = 0
        self.loss = ""
        self._mark()
        self._moved = self._heard
        self._agreed = _NEVER
        self._two_clocks = self._last_drop = ""
        self._extra: set[str] = set()
        self._simulated = SimulatedClock(node, node.steady_clock)
        node.create_service(Trigger, "~/reset", self._on_reset)

    def listen(self, answer: Answering) -> None:
        """Answer joint states of the topic `joint_states`; for `configure_core`.

        Args:
            answer: Answers a joint state of a time [ns]; why it cannot be used, if so.
        """

        def take(cdr: bytes) -> None:
            pipeline = self._pipeline()
            try:
                require_size(cdr, JointState)
                sample = pipeline.reader.read(cdr)
            except MessageError as error:
                self.drop("malformed", f"joint_states: {error}")
                return
            stamp = self.stamp_of(sample.stamp)
            if stamp is not None:
                self.judge(partial(answer, stamp, sample), pipeline.joints)

        self._node.subscribe(
            JointState, "joint_states", take, SENSOR, single_publisher=True, raw=True
        )

    def restart(self) -> None:
        """Empty filters and forget all answers: at activation, ~/reset and jumps of time."""
        self._simulated.hear()
        self._newest = 0
        self._answered = 0
        self.failures = 0
        self._agreed = _NEVER
        self._two_clocks = self._last_drop = ""
        self._mark()
        self._moved = self._heard
        if self._description.is_built:
            self._forget()

    def stamp_of(self, stamp: int) -> int | None:
        """The stamp [ns], receive time instead of 0; None if it is of another clock."""
        stamp = stamp or self.receive_time()
        return stamp if self._same_clock(stamp) else None

    def receive_time(self) -> int:
        """Substitute of a stamp of 0 [ns]."""
        if not self._is_stampless:
            self._is_stampless = True
            self._node.get_logger().warning(f"stamp 0 in {self._stamped}: receive time is used")
        return self._now()

    def judge(self, answer: Callable[[], SampleStatus | None], joints: "Heard") -> None:
        """Answer a sample, or drop it and say why.

        Args:
            answer: Answers; why the sample cannot be used, if so.
            joints: What its messages carried.
        """
        try:
            refused = answer()
        except MessageError as error:
            self.drop("result", f"{self._topic}: what would answer is dropped: {error}")
            return
        if refused is None:
            self._note_extra(joints.extra)
            return
        held = ", ".join(self._pipeline().held_joints())
        lacking = f" ({held})" if refused is SampleStatus.INCOMPLETE else ""
        self.drop(refused.name.lower(), f"{self._topic}: {refused.value}{lacking}")

    def note_answer(self, stamp: int) -> None:
        """Remember that a sample of this stamp [ns] was answered."""
        is_new = stamp != self._newest
        self._newest = stamp
        self._last_drop = ""
        self._answered += 1
        self._mark()
        if is_new:
            self._moved = self._heard

    def drop_unsolved(self, error: MbdError) -> None:
        """Count a sample that has no solution.

        Raises:
            SolveError: As many in a row have none as the parameter failures says.
        """
        self.failures += 1
        if self.failures >= self._node.parameters.failures:
            raise SolveError(f"{self.failures} {self._plural} in a row: {error}") from error
        self.drop("unsolved", f"{self._topic}: {error}")

    def drop(self, reason: str, text: str) -> None:
        """Count a sample that is not answered."""
        self._last_drop = text
        self._dropped += 1
        self._node.drop(reason, text)

    def details(self) -> dict[str, str]:
        """Return rates of the last second, for diagnostics."""
        answered, self._answered = self._answered, 0
        dropped, self._dropped = self._dropped, 0
        is_much = dropped > _DROPPED * (dropped + answered)
        self.loss = f"{dropped} of {dropped + answered} {self._stamped} dropped" if is_much else ""
        return {
            "joints ignored": listed(sorted(self._extra)) or "none",
            "messages answered in the last second": str(answered),
            "messages dropped in the last second": str(dropped),
            f"age of the newest {self._sample}": f"{self._age():.6g}" if self._newest else "none",
        }

    def health(self) -> tuple[int, str]:
        """STALE without answers, with the reason; WARN where samples come and time stands."""
        if not self._node.active:
            return OK, ""
        if self._two_clocks:
            return STALE, self._two_clocks
        dropped = f"; last one dropped: {self._last_drop}" if self._last_drop else ""
        if self._newest == 0:
            topic = self._node.resolve_topic_name(self._topic)
            return STALE, f"no {self._sample} answered yet on {topic}{dropped}"
        timeout = self._node.parameters.timeout
        if self._age() > timeout:
            return STALE, f"newest answered {self._sample} is {self._age():.2f} s old{dropped}"
        if self.silence() > timeout:
            why = self._simulated.fault(timeout) or dropped
            return STALE, f"no {self._sample} answered for {self.silence():.2f} s{why}"
        now = perf_counter()
        if self._last_drop and now - self._heard > _STANDING:
            return WARN, f"no {self._sample} answered, last one dropped: {self._last_drop}"
        if self._heard - self._moved > _STANDING and now - self._heard < _LATELY:
            stamp = self._newest * NANOSECOND
            return WARN, f"the {self._sample} of {stamp:.9g} s comes again and again: time stands"
        return OK, ""

    def silence(self) -> float:
        """For how long no sample was answered [s]; a standing clock does not count.

        Where the clock of a simulation is silent or has no publisher any more, steady time counts.
        """
        if self._simulated.is_used and not self._simulated.is_gone:
            stood = (self._now() - self._heard_ros) * NANOSECOND
            return max(stood, self._simulated.silence(self._node.parameters.timeout))
        return perf_counter() - self._heard

    def _same_clock(self, stamp: int) -> bool:
        """Whether stamp and node clock are one clock; asked again whenever the stamps moved on."""
        tolerance = self._node.parameters.clock_tolerance
        if not self._two_clocks and abs(stamp - self._agreed) * NANOSECOND < tolerance:
            return True
        now = self._now()
        ahead = (stamp - now) * NANOSECOND
        if now == 0 or abs(ahead) <= tolerance:
            self._two_clocks = ""
            self._agreed = stamp
            return True
        self._two_clocks = (
            f"{self._sample} of {stamp * NANOSECOND:.3f} s, node clock {now * NANOSECOND:.3f} s: "
            "two clocks; does use_sim_time fit the publisher?"
        )
        self._node.drop("two_clocks", self._two_clocks)
        return False

    def _note_extra(self, extra: tuple[str, ...]) -> None:
        """Remember joints of a joint state that are not used; list them once."""
        if not self._extra.issuperset(extra) and len(self._extra) < MOST_IGNORED:
            self._extra.update(extra[:MOST_IGNORED])
            self._node.get_logger().info(f"joints ignored: {listed(sorted(self._extra))}")

    def _on_reset(self, request: Any, response: Any) -> Any:
        self.restart()
        response.success, response.message = True, "filters and buffers are empty"
        return response

    def _mark(self) -> None:
        """Silence begins now."""
        self._heard = perf_counter()
        self._heard_ros = self._now()

    def _age(self) -> float:
        """Age of the newest answered stamp [s]."""
        return (self._now() - self._newest) * NANOSECOND

    def _now(self) -> int:
        """Time of the node [ns]."""
        return int(self._node.get_clock().now().nanoseconds)


class Heard(Protocol):
    """Contents of the newest messages."""

    @property
    def extra(self) -> tuple[str, ...]:
        """Joints that were not asked for."""
        ...


class JointStatePipeline(Protocol):
    """From serialized joint states to samples.

    Attributes:
        reader: Serialized joint states to samples; needed by `JointStateStream.listen`.
        joints: Which joints the newest joint state carried.
    """

    reader: JointStateCdrReader
    joints: JointStateReader

    def held_joints(self) -> Sequence[str]:
        """Joints that the newest joint state lacked, and that nothing else gives."""
        ...
