"""Nodes `qp_controller` and `sliding_mode_controller`: joint states and references to commands."""

import math
import time
from collections.abc import Sequence
from functools import partial
from time import perf_counter
from typing import Any

from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from mbd_ros.errors import SolveError
from mbd_ros.features.control.trajectory import TargetError
from mbd_ros.methods.signals.differentiation import SampleStatus
from mbd_ros.nodes.controller.parameters import OF_QP, OTHERS, parameters, with_law
from mbd_ros.nodes.controller.pipeline import ControlPipeline
from mbd_ros.nodes.controller.trajectory_action import ABSENT, NAME, TrajectoryAction, action_type
from mbd_ros.nodes.shell.joint_state_stream import JointStateStream
from mbd_ros.nodes.shell.parameters import PARAMETERS, Parameter
from mbd_ros.nodes.shell.robot_description import RobotDescription
from mbd_ros.nodes.shell.shell import Shell
from mbd_ros.scene.schema.code_permission import permitting
from msg_adapters.diagnostics import ERROR, OK, STALE, WARN
from msg_adapters.errors import MessageError
from msg_adapters.joint_state import JointSample, JointStateReader
from msg_adapters.joint_trajectory import read_joint_trajectory

MOST_NOTES = 20  # what was said of references and is kept, so that it is said once
WATCH = 0.01  # s between looks at the stream, and between commands while none comes
COMMANDS = QoSProfile(depth=1)
STATES = QoSProfile(depth=100)  # a recorder may be away for 0.1 s at 1 kHz


class ControllerNode(Shell):
    """Answers every joint state with a command; without them the command goes safe.

    Subclasses set `NAME` and `PARAMETERS`.
    """

    _pipeline: ControlPipeline

    def __init__(self, argv: Sequence[str] = ()) -> None:
        self._lapsed = perf_counter()
        self._is_heard = True
        self._notes: set[str] = set()
        self._action: TrajectoryAction | None = None
        super().__init__(argv)
        self._description = RobotDescription(self, self.build)
        self._stream = JointStateStream(
            self, self._description, lambda: self._pipeline, self.forget
        )

    def build(self, description: str | None) -> None:
        """Build the scene and the control law; a new law takes over from one at work."""
        pipeline = ControlPipeline(self.parameters, description)
        if self.active:
            pipeline.take_over(self._pipeline)
        self._pipeline = pipeline

    def configure_core(self) -> None:
        """Build the scene and its topics."""
        self._commands = self.publish_to(Float64MultiArray, "~/commands", COMMANDS)
        self._states = self.publish_to(JointState, "~/state", STATES)
        self._description.build()
        self._stream.listen(self.answer)
        self.subscribe(JointState, "~/reference", self._on_reference, 10)
        self.subscribe(JointTrajectory, "~/joint_trajectory", self._on_trajectory, 10)
        self._offer_action()
        self.every(WATCH, self._watch)
        powerless = self._pipeline.loop.guard.powerless
        if powerless:
            self.get_logger().warning(f"no authority: effort limit 0 of {', '.join(powerless)}")

    def activate_core(self) -> None:
        """Begin with an empty past."""
        self._stream.restart()

    def forget(self) -> None:
        """Hold the next state that comes."""
        self._pipeline.forget()
        self._lapsed = perf_counter()

    def reset(self, reason: str) -> None:
        """Time began anew: the present efforts are unknown, so control comes in by its ramp."""
        self._stream.restart()
        self._pipeline.loop.weight = 1.0

    def all_parameters(self, values: Any) -> tuple[Parameter, ...]:
        """Those of a law that is not of this package among them."""
        with permitting(values.allow_code):
            return PARAMETERS + with_law(self.PARAMETERS, values.controller)

    def prepare(self, values: Any) -> None:
        """Refuse a law that cannot be had."""
        if values.controller != self.parameters.controller:
            self.all_parameters(values)
        self._description.follow(values)

    def retune(self, values: Any) -> None:
        """New gains and times; a refusal leaves the old ones."""
        with permitting(values.allow_code):
            self._pipeline.retune(values)

    def safe(self) -> None:
        """The safe command, at the newest state if it is fresh; nothing before the first one."""
        self._give_up("the controller stops: the safe command took over")
        pipeline = self._pipeline
        if pipeline.x is None:
            return
        is_fresh = self._stream.silence() <= self.parameters.timeout
        self._commands.publish(pipeline.commands(pipeline.loop.stop(is_fresh)))
        self._commands.wait_for_all_acked(Duration(seconds=0.1))

    def deactivate_core(self) -> None:
        """Ramp down within `safe_ramp`, then the safe command."""
        loop = self._pipeline.loop
        steps = math.ceil(self.parameters.safe_ramp / WATCH) if loop.weight < 1.0 else 0
        for _ in range(steps):
            effort = loop.lapse(WATCH)
            if effort is None:
                break
            self._commands.publish(self._pipeline.commands(effort))
            time.sleep(WATCH)
        self.safe()

    def health(self) -> tuple[int, str, dict[str, str]]:
        """State of the stream, then of the loop."""
        pipeline = self._pipeline
        action = self.resolve_topic_name(NAME) if self._action else f"none: {ABSENT}"
        details = {**pipeline.details(), "action": action, **self._stream.details()}
        level, text = self._stream.health()
        if level == STALE or not self.active:
            return level, text, details
        watch, wrong = pipeline.watch, [text] if text else []
        if watch.fault:
            lost = f"the loop was lost, the command went safe: {watch.fault}"
            return ERROR, "; ".join([lost, *wrong]), details
        wrong += [*watch.warnings(), *pipeline.loop.controller.warnings()]
        wrong += [self._stream.loss] if self._stream.loss else []
        if not self._is_heard:
            wrong.append("nobody hears the commands: integrals stand still")
        if pipeline.loop.guard.powerless:
            wrong.append(f"no authority over {', '.join(pipeline.loop.guard.powerless)}")
        if off := pipeline.off_couplings(self.parameters.coupling_tolerance):
            wrong.append(f"off their couplings: {off}; the independent joints are used")
        if pipeline.loop.failures:
            wrong.append(f"no answer of the law to {pipeline.loop.failures} states in a row")
        return (WARN if wrong else OK), "; ".join(wrong) or "controlling", details

    def answer(self, stamp: int, sample: JointSample) -> SampleStatus | None:
        """Send the command of the control law."""
        try:
            answer = self._pipeline.answer(stamp, sample)
        except SolveError as error:
            self._count_failures()
            self._stream.drop("unsolved", f"joint_states: {error}")
            return None
        if isinstance(answer, SampleStatus):
            return answer
        self._commands.publish(answer.commands)
        self._states.publish(answer.state)
        if self._action is not None:
            self._action.update(stamp)
        self._stream.note_answer(stamp)
        self._count_failures()
        return None

    def _count_failures(self) -> None:
        failures = self._pipeline.loop.failures
        if failures >= self.parameters.failures:
            raise SolveError(f"no answer of the law to {failures} states in a row")

    def _watch(self) -> None:
        """Ramp to the safe command where joint states stopped; look for listeners."""
        now = perf_counter()
        since, self._lapsed = now - self._lapsed, now
        loop = self._pipeline.loop
        self._is_heard = self._commands.get_subscription_count() > 0
        loop.is_frozen = not self._is_heard
        if self._stream.silence() > self.parameters.timeout:
            effort = loop.lapse(since)
            if loop.is_open:
                self._give_up("joint states stopped: the safe command took over")
            if effort is not None:
                self._commands.publish(self._pipeline.commands(effort))

    def _offer_action(self) -> None:
        """The action, where its messages are installed; else say why there is none."""
        kind = action_type()
        if kind is None:
            self.get_logger().info(f"no action {self.resolve_topic_name(NAME)}: {ABSENT}")
            return
        refused = partial(self.drop, "goal")
        self._action = TrajectoryAction(self, kind, lambda: self._pipeline, refused, self._note)
        self.keep(self._action, self._withdraw_action)

    def _withdraw_action(self, action: TrajectoryAction) -> None:
        self._action = None
        action.destroy()

    def _give_up(self, why: str) -> None:
        if self._action is not None:
            self._action.give_up(why)

    def _on_reference(self, msg: Any) -> None:
        try:
            names = tuple(msg.name)
            sample = JointStateReader(names, with_effort=False).read(msg)
            self._note(self._pipeline.aim(names, sample))
        except (MessageError, TargetError) as error:
            self.drop("reference", f"{self.resolve_topic_name('~/reference')}: {error}")

    def _on_trajectory(self, msg: Any) -> None:
        try:
            self._note(self._pipeline.follow(read_joint_trajectory(msg)))
        except (MessageError, TargetError) as error:
            self.drop("reference", f"{self.resolve_topic_name('~/joint_trajectory')}: {error}")

    def _note(self, text: str) -> None:
        """Report once which joints of references were mapped or left out."""
        if text and text not in self._notes and len(self._notes) < MOST_NOTES:
            self._notes.add(text)
            self.get_logger().info(f"references: {text}")


class QpControllerNode(ControllerNode):
    """Tracking by a constrained QP."""

    NAME = "qp_controller"
    PARAMETERS = parameters(OF_QP, "qp_tracking", takes_code=False)


class SlidingModeControllerNode(ControllerNode):
    """Sliding mode, super-twisting and their simpler relatives, or a law of another package."""

    NAME = "sliding_mode_controller"
    PARAMETERS = parameters(OTHERS, "sliding_mode", takes_code=True)
