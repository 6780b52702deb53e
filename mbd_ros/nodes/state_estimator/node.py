"""Node `state_estimator`: noisy and partial measurements in, states of all joints out."""

from collections.abc import Callable
from functools import partial
from typing import Any

from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray

from mbd_ros.core.estimation.differentiation import SampleStatus
from mbd_ros.core.estimation.tracker import Taken
from mbd_ros.errors import DivergedError, SolveError
from mbd_ros.nodes.shell.joint_state_node import SENSOR, JointStateNode
from mbd_ros.nodes.simulator.commands import command_reader
from mbd_ros.nodes.state_estimator.parameters import PARAMETERS
from mbd_ros.nodes.state_estimator.pipeline import EstimateMessages, EstimatorPipeline
from msg_adapters.diagnostics import OK
from msg_adapters.errors import MessageError
from msg_adapters.imu import read_imu
from msg_adapters.joint_state import JointSample

DEPTH = 100  # a reader may be away for 0.2 s at 500 Hz


class StateEstimatorNode(JointStateNode):
    """Answers every measurement with the state that explains all of them best."""

    NAME = "state_estimator"
    PARAMETERS = PARAMETERS
    STAMPED = "joint states and IMUs"
    _pipeline: EstimatorPipeline

    def build(self, description: str | None) -> None:
        """Build the scene."""
        self._pipeline = EstimatorPipeline(self.parameters, description)
        self._failures = 0

    def configure_core(self) -> None:
        """Build the scene and its topics."""
        self._states = self.publish_to(JointState, "~/joint_states", DEPTH)
        self._disturbance = self.publish_to(JointState, "~/disturbance", DEPTH)
        self._forces = self.publish_to(JointState, "~/constraint_forces", DEPTH)
        self._deviations = self.publish_to(Float64MultiArray, "~/deviations", DEPTH)
        self._innovations = self.publish_to(Float64MultiArray, "~/innovations", DEPTH)
        super().configure_core()

    def listen(self) -> None:
        """Subscribe to joint states, and to what else is measured."""
        super().listen()
        for name, (sensor, _) in self._pipeline.imus.items():
            topic = sensor.label or f"~/imu/{name}"
            self.subscribe(Imu, topic, self._on_imu(name, topic, sensor.frame), SENSOR)
        if self.parameters.inputs == "commands":
            self._commands = command_reader(self._pipeline.estimation.scene, ())
            self.subscribe(JointState, "joint_commands", self._take_command, SENSOR)

    def forget(self) -> None:
        """The next joint state is the first one."""
        self._pipeline.forget()
        self._failures = 0

    def health(self) -> tuple[int, str, dict[str, str]]:
        """State of the stream, then of the estimate."""
        details = {**self._pipeline.details(), **self.stream_details()}
        level, text = self.stream_health()
        if level == OK:
            level, text = self._pipeline.health()
        return level, text, details

    def answer(self, stamp: int, sample: JointSample) -> SampleStatus | None:
        """Estimate the state at one joint state."""
        return self._answer(partial(self._pipeline.answer, stamp, sample))

    def _answer(self, ask: Callable[[], EstimateMessages | Taken]) -> SampleStatus | None:
        try:
            answer = ask()
        except (SolveError, DivergedError) as error:
            self._drop_unsolved(error)
            return None
        self._failures = 0
        if isinstance(answer, Taken):
            return SampleStatus.OLD if answer is Taken.OLD else None
        self.publish_answer(answer)
        self.note_answer(answer.stamp)
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

    def _take_command(self, msg: Any) -> None:
        try:
            self._pipeline.take_command(self._commands.read_named(msg))
        except MessageError as error:
            self.drop("command", f"joint_commands: {error}")

    def _on_imu(self, name: str, topic: str, frame: str) -> Callable[[Any], None]:
        def take(msg: Any) -> None:
            try:
                sample = read_imu(msg)
            except MessageError as error:
                self.drop("imu", f"{topic}: {error}")
                return
            if sample.frame_id not in ("", frame):
                self.drop("imu", f"{topic}: frame '{sample.frame_id}', expected '{frame}'")
                return
            stamp = self.stamp_of(sample.stamp)
            if stamp is not None:
                ask = partial(self._pipeline.answer_imu, name, stamp, sample.values)
                self.judge(partial(self._answer, ask), self._pipeline.joints)

        return take

    def _drop_unsolved(self, error: SolveError | DivergedError) -> None:
        self._failures += 1
        self._pipeline.forget()
        if self._failures >= self.parameters.failures:
            raise SolveError(f"{self._failures} joint states in a row: {error}") from error
        self.drop_state("unsolved", f"joint_states: {error}")
