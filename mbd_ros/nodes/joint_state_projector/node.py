"""Node `joint_state_projector`: measured joint states in, the nearest consistent ones out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from mbd_ros.errors import SolveError
from mbd_ros.methods.projection.state_projection import StateProjector
from mbd_ros.methods.signals.differentiation import SampleStatus
from mbd_ros.nodes.joint_state_projector.pipeline import ProjectorPipeline
from mbd_ros.nodes.shell.joint_state_stream import JointStateStream
from mbd_ros.nodes.shell.parameters import (
    TUNING,
    Parameter,
    constructor_parameters,
    stream_parameters,
    tuning,
)
from mbd_ros.nodes.shell.robot_description import RobotDescription
from mbd_ros.nodes.shell.shell import Shell
from msg_adapters.diagnostics import OK
from msg_adapters.joint_state import JointSample

PARAMETERS = (
    *stream_parameters(
        "scene",
        "allow_code",
        *TUNING,
        "timeout",
        "clock_tolerance",
    ),
    *constructor_parameters(
        StateProjector, {"limits": "limits", "amplification": "amplification"}, skip=1
    ),
    Parameter(
        "violation_tolerance",
        float,
        "Violation of a constraint or limit by the measurement that is reported [rad, m].",
        0.05,
        low=0.0,
        high=100.0,
        read_only=False,
    ),
    Parameter(
        "failures",
        int,
        "Joint states in a row without a consistent state near them after which the node "
        "deactivates.",
        1000,
        low=1,
        high=1_000_000,
        read_only=False,
    ),
)
DEPTH = 100  # a reader may be away for 0.1 s at 1 kHz


class JointStateProjectorNode(Shell):
    """Answers every joint state with the nearest one on the constraints and within limits."""

    NAME = "joint_state_projector"
    PARAMETERS = PARAMETERS
    _pipeline: ProjectorPipeline

    def __init__(self, argv: Sequence[str] = ()) -> None:
        super().__init__(argv)
        self._description = RobotDescription(self, self.build)
        self._stream = JointStateStream(
            self, self._description, lambda: self._pipeline, self.forget
        )

    def build(self, description: str | None) -> None:
        """Build the scene."""
        self._pipeline = ProjectorPipeline(self.parameters, description)
        self._stream.failures = 0

    def configure_core(self) -> None:
        """Build the scene and its topics."""
        self._states = self.publish_to(JointState, "~/joint_states", DEPTH)
        self._forces = self.publish_to(JointState, "~/constraint_forces", DEPTH)
        self._violation = self.publish_to(Float64MultiArray, "~/violation", DEPTH)
        self._description.build()
        self._stream.listen(self.answer)

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
        """Empty filters; missing joints start from the initial state of the scene again."""
        self._pipeline.forget()

    def retune(self, values: Any) -> None:
        """New tuning; filters start again."""
        if tuning(values) != tuning(self.parameters):
            self._pipeline.reconstructor.set_tuning(tuning(values))

    def health(self) -> tuple[int, str, dict[str, str]]:
        """State of the stream, then fit of the measurement to the mechanism."""
        details = {**self._pipeline.details(), **self._stream.details()}
        level, text = self._stream.health()
        if level == OK:
            level, text = self._pipeline.health(self.parameters.violation_tolerance)
        return level, text, details

    def answer(self, stamp: int, sample: JointSample) -> SampleStatus | None:
        """Project one joint state."""
        try:
            answer = self._pipeline.answer(stamp, sample)
        except SolveError as error:
            self._stream.drop_unsolved(error)
            return None
        if isinstance(answer, SampleStatus):
            return answer
        self._stream.failures = 0
        self._states.publish(answer.states)
        if answer.forces is not None:
            self._forces.publish(answer.forces)
        self._violation.publish(answer.violation)
        self._stream.note_answer(stamp)
        return None
