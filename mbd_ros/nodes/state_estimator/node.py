"""Node `state_estimator`: noisy and partial measurements in, states of all joints out."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from mbd_ros.errors import DivergedError, SolveError
from mbd_ros.features.estimation.tracker import SampleOutcome
from mbd_ros.methods.signals.differentiation import SampleStatus
from mbd_ros.nodes.shell.commands import command_reader
from mbd_ros.nodes.shell.joint_state_stream import SENSOR, JointStateStream
from mbd_ros.nodes.shell.robot_description import RobotDescription
from mbd_ros.nodes.shell.sensor_messages import SensorMessage
from mbd_ros.nodes.shell.serialized import read_load
from mbd_ros.nodes.shell.shell import Shell
from mbd_ros.nodes.state_estimator.parameters import PARAMETERS
from mbd_ros.nodes.state_estimator.pipeline import Answer, EstimateMessages, EstimatorPipeline
from msg_adapters.diagnostics import OK
from msg_adapters.errors import MessageError
from msg_adapters.joint_state import JointSample

DEPTH = 100  # a reader may be away for 0.2 s at 500 Hz


class StateEstimatorNode(Shell):
    """Answers every measurement with the state that explains all of them best."""

    NAME = "state_estimator"
    PARAMETERS = PARAMETERS
    _pipeline: EstimatorPipeline

    def __init__(self, argv: Sequence[str] = ()) -> None:
        super().__init__(argv)
        self._description = RobotDescription(self, self.build)
        self._stream = JointStateStream(
            self,
            self._description,
            lambda: self._pipeline,
            self.forget,
            stamped="joint states and sensors",
        )

    def build(self, description: str | None) -> None:
        """Build the scene."""
        self._pipeline = EstimatorPipeline(self.parameters, description, self.parameters.lag)
        self._stream.failures = 0

    def configure_core(self) -> None:
        """Build the scene and its topics."""
        self._states = self.publish_to(JointState, "~/joint_states", DEPTH)
        self._disturbance = self.publish_to(JointState, "~/disturbance", DEPTH)
        self._forces = self.publish_to(JointState, "~/constraint_forces", DEPTH)
        self._deviations = self.publish_to(Float64MultiArray, "~/deviations", DEPTH)
        self._numbers = self._covariance = None
        if self.parameters.parameters:
            self._numbers = self.publish_to(Float64MultiArray, "~/parameters", DEPTH)
        if self.parameters.covariance:
            self._covariance = self.publish_to(Float64MultiArray, "~/covariance", DEPTH)
        self._innovations = self.publish_to(Float64MultiArray, "~/innovations", DEPTH)
        self._description.build()
        self._stream.listen(self.answer)
        for one in self._pipeline.messages:
            self.subscribe(one.type, one.topic, self._on_sensor(one), SENSOR)
        for name, wrench in self._pipeline.scene.wrenches.items():
            self.subscribe(WrenchStamped, wrench.heard_on, self._on_wrench(name), SENSOR)
        if self.parameters.inputs == "commands":
            self._commands = command_reader(self._pipeline.estimation.scene, ())
            self.subscribe(JointState, "joint_commands", self._take_command, SENSOR)

    def prepare(self, values: Any) -> None:
        """Listen for the robot of another scene."""
        self._description.follow(values)

    def activate_core(self) -> None:
        """Begin with an empty past."""
        self._stream.restart()

    def reset(self, reason: str) -> None:
        """Begin anew: another past and another clock count alike."""
        self._stream.restart()

    def forget(self) -> None:
        """The next joint state is the first one."""
        self._pipeline.forget()

    def health(self) -> tuple[int, str, dict[str, str]]:
        """State of the stream, then of the estimate."""
        details = {**self._pipeline.details(), **self._stream.details()}
        level, text = self._stream.health()
        if level == OK:
            level, text = self._pipeline.health()
        return level, text, details

    def answer(self, stamp: int, sample: JointSample) -> SampleStatus | None:
        """Estimate the state at one joint state."""
        return self._answer(partial(self._pipeline.answer, stamp, sample))

    def _answer(self, ask: Callable[[], Answer]) -> SampleStatus | None:
        try:
            answer = ask()
        except (SolveError, DivergedError) as error:
            self._pipeline.restart()
            self._stream.drop_unsolved(error)
            return None
        self._stream.failures = 0
        if isinstance(answer, SampleOutcome):
            return SampleStatus.OLD if answer is SampleOutcome.OLD else None
        for one in answer:
            self.publish_answer(one)
        self._stream.note_answer(self._pipeline.newest)
        return None

    def publish_answer(self, answer: EstimateMessages) -> None:
        """Send what was estimated."""
        self._states.publish(answer.states)
        if answer.disturbance is not None:
            self._disturbance.publish(answer.disturbance)
        if answer.forces is not None:
            self._forces.publish(answer.forces)
        self._deviations.publish(answer.deviations)
        self._innovations.publish(answer.innovations)
        for message, topic in (
            (answer.parameters, self._numbers),
            (answer.covariance, self._covariance),
        ):
            if message is not None and topic is not None:
                topic.publish(message)

    def _take_command(self, msg: Any) -> None:
        try:
            self._pipeline.take_command(self._commands.read_named(msg))
        except MessageError as error:
            self.drop("command", f"joint_commands: {error}")

    def _on_sensor(self, sensor_message: SensorMessage) -> Callable[[Any], None]:
        name = sensor_message.sensor.name

        def take(msg: Any) -> None:
            try:
                sample = sensor_message.read(msg)
            except MessageError as error:
                self.drop("sensor", f"{sensor_message.topic}: {error}")
                return
            stamp = self._stream.stamp_of(sample.stamp)
            if stamp is not None:
                ask = partial(self._pipeline.answer_sensor, name, stamp, sample.values)
                self._stream.judge(partial(self._answer, ask), self._pipeline.joints)

        return take

    def _on_wrench(self, name: str) -> Callable[[Any], None]:
        def take(msg: Any) -> None:
            try:
                sample = read_load(msg, self._pipeline.scene.wrenches[name])
            except MessageError as error:
                self.drop("wrench", str(error))
                return
            stamp = sample.stamp or self._stream.receive_time()
            if not self._pipeline.wrenches[name].add(stamp, sample.wrench):
                self.drop("wrench", f"wrench '{name}': stamp not newer than the last")

        return take
