"""Node `marker_kinematics`: places of markers in, joint states out."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from visualization_msgs.msg import MarkerArray

from mbd_ros.core.state import Array
from mbd_ros.errors import SolveError
from mbd_ros.methods.signals.differentiation import SampleStatus
from mbd_ros.nodes.marker_kinematics.pipeline import MarkerPipeline
from mbd_ros.nodes.shell.joint_state_stream import SENSOR, JointStateStream
from mbd_ros.nodes.shell.parameters import Parameter, stream_parameters, tunable
from mbd_ros.nodes.shell.robot_description import RobotDescription
from mbd_ros.nodes.shell.shell import Shell
from msg_adapters.diagnostics import OK
from msg_adapters.errors import MessageError

PARAMETERS = (
    *stream_parameters("scene", "allow_code", "cutoff", "rewind", "clock_tolerance"),
    Parameter(
        "task",
        str,
        "Task file with weights of markers and coordinates, or a set-up of OpenSim's inverse "
        "kinematics; empty for the weights of the scene.",
        "",
    ),
    Parameter("limits", bool, "Whether joints keep their position limits.", True),
    tunable("timeout", 0.5, 1e-3, 3600.0, "Age of the newest markers that is reported STALE [s]."),
    tunable(
        "residual_tolerance",
        0.1,
        0.0,
        100.0,
        "Root mean square distance of the markers that is reported [m].",
    ),
    Parameter(
        "failures",
        int,
        "Messages in a row without a fit after which the node deactivates.",
        1000,
        low=1,
        high=1_000_000,
        read_only=False,
    ),
)
TOPIC = "markers"
DEPTH = 100  # a reader may be away for half a second at 200 Hz


class MarkerKinematicsNode(Shell):
    """Answers every array of markers with the joint states that fit it best."""

    NAME = "marker_kinematics"
    PARAMETERS = PARAMETERS
    _pipeline: MarkerPipeline

    def __init__(self, argv: Sequence[str] = ()) -> None:
        super().__init__(argv)
        self._description = RobotDescription(self, self.build)
        self._stream = JointStateStream(
            self,
            self._description,
            lambda: self._pipeline,
            self.forget,
            sample="array of markers",
            topic=TOPIC,
            stamped="markers",
            plural="messages",
        )

    def build(self, description: str | None) -> None:
        """Build the scene."""
        self._pipeline = MarkerPipeline(self.parameters, description)
        self._stream.failures = 0

    def configure_core(self) -> None:
        """Build the scene and its topics."""
        self._states = self.publish_to(JointState, "~/joint_states", DEPTH)
        self._residuals = self.publish_to(Float64MultiArray, "~/residuals", DEPTH)
        self._description.build()
        self.subscribe(MarkerArray, TOPIC, self._take_markers, SENSOR, single_publisher=True)

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
        """Empty filters; the next frame is sought from the default pose."""
        self._pipeline.forget()

    def retune(self, values: Any) -> None:
        """New tuning; filters start again."""
        changed = ("cutoff", "rewind", "residual_tolerance")
        if any(getattr(values, name) != getattr(self.parameters, name) for name in changed):
            self._pipeline.tune(values)

    def health(self) -> tuple[int, str, dict[str, str]]:
        """State of the stream, then fit of the markers."""
        details = {**self._pipeline.details(), **self._stream.details()}
        level, text = self._stream.health()
        if level == OK:
            level, text = self._pipeline.health()
        return level, text, details

    def _take_markers(self, msg: Any) -> None:
        pipeline = self._pipeline
        try:
            sample = pipeline.joints.read(msg)
        except MessageError as error:
            self._stream.drop("malformed", f"{TOPIC}: {error}")
            return
        stamp = self._stream.stamp_of(sample.stamp)
        if stamp is not None:
            self._stream.judge(partial(self._answer_places, stamp, sample.places), pipeline.joints)

    def _answer_places(self, stamp: int, places: Array) -> SampleStatus | None:
        try:
            answer = self._pipeline.answer(stamp, places)
        except SolveError as error:
            self._stream.drop_unsolved(error)
            return None
        if isinstance(answer, SampleStatus):
            return answer
        self._stream.failures = 0
        self._states.publish(answer.states)
        self._residuals.publish(answer.residuals)
        self._stream.note_answer(stamp)
        return None
