"""Node `marker_kinematics`: places of markers in, joint states out."""

from functools import partial
from typing import Any

from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from visualization_msgs.msg import MarkerArray

from mbd_ros.core.state import Array
from mbd_ros.errors import SolveError
from mbd_ros.methods.signals.differentiation import SampleStatus
from mbd_ros.nodes.marker_kinematics.parameters import PARAMETERS
from mbd_ros.nodes.marker_kinematics.pipeline import MarkerPipeline
from mbd_ros.nodes.shell.joint_state_node import SENSOR, JointStateNode
from msg_adapters.diagnostics import OK
from msg_adapters.errors import MessageError

DEPTH = 100  # a reader may be away for half a second at 200 Hz


class MarkerKinematicsNode(JointStateNode):
    """Answers every array of markers with the joint states that fit it best."""

    NAME = "marker_kinematics"
    PARAMETERS = PARAMETERS
    STAMPED, SAMPLE, TOPIC = "markers", "array of markers", "markers"
    _pipeline: MarkerPipeline  # type: ignore[assignment]

    def build(self, description: str | None) -> None:
        """Build the scene."""
        self._pipeline = MarkerPipeline(self.parameters, description)
        self._failures = 0

    def configure_core(self) -> None:
        """Build the scene and its topics."""
        self._states = self.publish_to(JointState, "~/joint_states", DEPTH)
        self._residuals = self.publish_to(Float64MultiArray, "~/residuals", DEPTH)
        super().configure_core()

    def listen(self) -> None:
        """Subscribe to markers."""
        self.subscribe(MarkerArray, self.TOPIC, self._take_markers, SENSOR, single_publisher=True)

    def forget(self) -> None:
        """Empty filters; the next frame is sought from the default pose."""
        self._pipeline.forget()
        self._failures = 0

    def retune(self, values: Any) -> None:
        """New tuning; filters start again."""
        changed = ("cutoff", "rewind", "residual_tolerance")
        if any(getattr(values, name) != getattr(self.parameters, name) for name in changed):
            self._pipeline.tune(values)

    def health(self) -> tuple[int, str, dict[str, str]]:
        """State of the stream, then fit of the markers."""
        details = {**self._pipeline.details(), **self.stream_details()}
        level, text = self.stream_health()
        if level == OK:
            level, text = self._pipeline.health()
        return level, text, details

    def _take_markers(self, msg: Any) -> None:
        pipeline = self._pipeline
        try:
            sample = pipeline.joints.read(msg)
        except MessageError as error:
            self.drop_state("malformed", f"{self.TOPIC}: {error}")
            return
        stamp = self.stamp_of(sample.stamp)
        if stamp is not None:
            self.judge(partial(self._answer_places, stamp, sample.places), pipeline.joints)

    def _answer_places(self, stamp: int, places: Array) -> SampleStatus | None:
        try:
            answer = self._pipeline.answer(stamp, places)
        except SolveError as error:
            self._drop_unsolved(error)
            return None
        if isinstance(answer, SampleStatus):
            return answer
        self._failures = 0
        self._states.publish(answer.states)
        self._residuals.publish(answer.residuals)
        self.note_answer(stamp)
        return None

    def _drop_unsolved(self, error: SolveError) -> None:
        self._failures += 1
        if self._failures >= self.parameters.failures:
            raise SolveError(f"{self._failures} messages in a row: {error}") from error
        self.drop_state("unsolved", f"{self.TOPIC}: {error}")
