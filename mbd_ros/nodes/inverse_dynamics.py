"""Node `inverse_dynamics`: joint states and wrenches in, torques and coupling forces out."""

import sys
from collections.abc import Callable, Sequence
from typing import Any

from geometry_msgs.msg import WrenchStamped
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from mbd_ros.core.differentiation import Sample
from mbd_ros.core.state import NANOSECOND
from mbd_ros.core.torque_estimator import Observation
from mbd_ros.errors import MbdError, SolveError
from mbd_ros.nodes.inverse_dynamics_parameters import PARAMETERS, tuning
from mbd_ros.nodes.pipeline import Pipeline
from mbd_ros.nodes.process import run
from mbd_ros.nodes.shell import Shell
from mbd_ros.scene import description_topic
from msg_adapters.diagnostics import OK, STALE
from msg_adapters.errors import MessageError
from msg_adapters.wrench import read_wrench

# Best effort also hears reliable publishers; the depth bridges a pause of 0.5 s at 1 kHz,
# beyond which the transport itself keeps no more.
SENSOR = QoSProfile(depth=500, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_NEVER = -(2**62)  # ns


class InverseDynamicsNode(Shell):
    """Answers every joint state with the torques that explain the motion."""

    NAME = "inverse_dynamics"
    PARAMETERS = PARAMETERS

    def __init__(self, argv: Sequence[str] = ()) -> None:
        super().__init__(argv)
        self._pipeline: Pipeline | None = None
        self._newest, self._answered, self._is_stampless = 0, 0, False
        self._two_clocks = self._last_drop = ""
        self._extra: set[str] = set()
        self._description: str | None = None
        self._description_topic: str | None = None
        self.create_service(Trigger, "~/reset", self._on_reset)
        if self.parameters.scene:
            self._listen_for_description()

    def configure_core(self) -> None:
        """Build the scene and its topics."""
        if self._description_topic is not None and self._description is None:
            raise MbdError(f"waiting for the robot description on {self._description_topic}")
        self._pipeline = Pipeline(self.parameters, self._description)
        self._torques = self.publish_to(JointState, "~/joint_torques", 10)
        self._constraint_forces = self.publish_to(JointState, "~/constraint_forces", 10)
        for name, wrench in self._pipeline.scene.wrenches.items():
            topic = wrench.topic or f"~/wrench/{name}"
            self.subscribe(WrenchStamped, topic, self._on_wrench(name), SENSOR)
        if self._pipeline.scene.wrenches:
            self.every(max(self.parameters.wrench_wait / 2.0, 1e-3), self._flush)
        self.subscribe(
            JointState, "joint_states", self._on_state, SENSOR, single_publisher=True, raw=True
        )

    def activate_core(self) -> None:
        """Begin with an empty past."""
        self.reset("activated")

    def retune(self, values: Any) -> None:
        """New tuning for the estimator; its filters start again."""
        if self._pipeline is not None and tuning(values) != tuning(self.parameters):
            self._pipeline.estimator.tune(tuning(values))

    def reset(self, reason: str) -> None:
        """Empty filters, wrench buffers and the queue."""
        self._newest, self._answered, self._agreed = 0, 0, _NEVER
        self._two_clocks = self._last_drop = ""
        if self._pipeline is not None:
            self._pipeline.reset()

    def health(self) -> tuple[int, str, dict[str, str]]:
        """State of the stream, then what the numbers contain."""
        assert self._pipeline is not None
        details = self._pipeline.details()
        details["joints ignored"] = ", ".join(sorted(self._extra)) or "none"
        details["messages answered in the last second"] = str(self._answered)
        self._answered = 0
        level, text = self._stream_health()
        if level == OK:
            level, text = self._pipeline.health(self.parameters.coupling_tolerance)
        return level, text, details

    def _stream_health(self) -> tuple[int, str]:
        if not self.active:
            return OK, ""
        if self._two_clocks:
            return STALE, self._two_clocks
        dropped = f"; last one dropped: {self._last_drop}" if self._last_drop else ""
        if self._newest == 0:
            topic = self.resolve_topic_name("joint_states")
            return STALE, f"no joint state answered yet on {topic}{dropped}"
        age = (self.get_clock().now().nanoseconds - self._newest) * NANOSECOND
        if age > self.parameters.timeout:
            return STALE, f"newest answered joint state is {age:.2f} s old{dropped}"
        return OK, ""

    # ------------------------------------------------------------------ messages

    def _on_state(self, cdr: bytes) -> None:
        pipeline = self._pipeline
        assert pipeline is not None
        try:
            sample = pipeline.reader.read(cdr)
        except MessageError as error:
            self._drop_state("malformed", f"joint_states: {error}")
            return
        stamp = sample.stamp or self._receive_time()
        if not self._same_clock(stamp):
            return
        reader = pipeline.joints
        x = pipeline.estimator.observe(stamp, sample.position, sample.velocity, reader.present)
        if not isinstance(x, Observation):
            lacking = f" ({', '.join(pipeline.held())})" if x is Sample.INCOMPLETE else ""
            self._drop_state(x.name.lower(), f"joint_states: {x.value}{lacking}")
            return
        if not self._extra.issuperset(reader.extra):
            self._extra.update(reader.extra)
            self.get_logger().info(f"joints ignored: {', '.join(sorted(self._extra))}")
        if pipeline.scene.wrenches:
            pipeline.queue.add(x, self.parameters.wrench_wait)
            self._flush()
        else:
            self._answer(x, ())

    def _on_wrench(self, name: str) -> Callable[[Any], None]:
        def take(msg: Any) -> None:
            assert self._pipeline is not None
            buffer = self._pipeline.queue.buffers[name]
            expected = self._pipeline.scene.wrenches[name].load.expressed_in
            try:
                sample = read_wrench(msg)
            except MessageError as error:
                self.drop("wrench", f"wrench '{name}': {error}")
                return
            if sample.frame_id not in ("", expected):
                self.drop(
                    "wrench", f"wrench '{name}': frame '{sample.frame_id}', expected '{expected}'"
                )
            elif not buffer.add(sample.stamp or self._receive_time(), sample.wrench):
                self.drop("wrench", f"wrench '{name}': stamp not newer than the last")
            else:
                self._flush()

        return take

    def _flush(self) -> None:
        """Answer the joint states that wait for nothing more."""
        assert self._pipeline is not None
        for x, wrenches in self._pipeline.queue.take():
            lacking = [name for name, wrench in wrenches.items() if wrench is None]
            if lacking:
                self._drop_state("no_wrench", f"no wrench '{lacking[0]}' near the joint state")
            else:
                self._answer(x, tuple(wrenches.values()))

    def _answer(self, x: Observation, wrenches: Sequence[Any]) -> None:
        assert self._pipeline is not None
        try:
            messages = self._pipeline.answer(x, wrenches)
        except SolveError as error:
            self._drop_state("unsolved", str(error))
            return
        if messages is None:
            self._drop_state("result", "the torques of a joint state are not finite")
            return
        torques, constraint_forces = messages
        self._torques.publish(torques)
        if constraint_forces is not None:
            self._constraint_forces.publish(constraint_forces)
        self._newest, self._last_drop = x.stamp, ""
        self._answered += 1

    def _drop_state(self, reason: str, text: str) -> None:
        self._last_drop = text
        self.drop(reason, text)

    # ------------------------------------------------------------------ time

    def _receive_time(self) -> int:
        if not self._is_stampless:
            self._is_stampless = True
            self.get_logger().warning("stamp 0 in joint states or wrenches: receive time is used")
        return int(self.get_clock().now().nanoseconds)

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
            f"joint state of {stamp * NANOSECOND:.3f} s, node clock {now * NANOSECOND:.3f} s: "
            "two clocks; does use_sim_time fit the publisher?"
        )
        self.drop("two_clocks", self._two_clocks)
        return False

    # ------------------------------------------------------------------ robot description

    def _listen_for_description(self) -> None:
        try:
            self._description_topic = description_topic(self.parameters.scene)
        except MbdError:
            return  # configure_core says it
        if self._description_topic is not None:
            topic = self._description_topic
            self.subscribe(String, topic, self._on_description, LATCHED, always=True)

    def _on_description(self, msg: Any) -> None:
        """Start with the first description; a later one replaces the robot whole or is refused."""
        if self._pipeline is None or not self.configured:
            self._description = msg.data
            self.try_start()
            return
        if msg.data == self._description:
            return  # its publisher came back
        try:
            pipeline = Pipeline(self.parameters, msg.data)
        except MbdError as error:
            self.drop("robot_description", f"new robot description refused: {error}")
            return
        self._description, self._pipeline = msg.data, pipeline
        self.get_logger().info("new robot description in use")

    def _on_reset(self, request: Any, response: Any) -> Any:
        self.reset("asked to")
        response.success, response.message = True, "filters and buffers are empty"
        return response


def main() -> int:
    """Entry point `inverse_dynamics`."""
    return run(InverseDynamicsNode)


if __name__ == "__main__":
    sys.exit(main())
