"""Node `payload_estimator`: joint states with efforts in, mass and inertia of the payload out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from geometry_msgs.msg import InertiaStamped
from std_msgs.msg import Float64MultiArray

from mbd_ros.core.model.inertial_parameters import COUNT, PARAMETER_NAMES
from mbd_ros.errors import SolveError
from mbd_ros.methods.signals.differentiation import SampleStatus
from mbd_ros.nodes.payload_estimator.pipeline import Carried, PayloadPipeline
from mbd_ros.nodes.shell.joint_state_stream import JointStateStream
from mbd_ros.nodes.shell.parameters import TUNING, Parameter, stream_parameters, tunable
from mbd_ros.nodes.shell.robot_description import RobotDescription
from mbd_ros.nodes.shell.shell import Shell
from msg_adapters.diagnostics import OK
from msg_adapters.inertia import write_inertia
from msg_adapters.joint_state import JointSample
from msg_adapters.multi_array import MultiArrayCdrWriter

PARAMETERS = (
    *stream_parameters(
        "scene",
        "allow_code",
        *TUNING,
        "timeout",
        "clock_tolerance",
    ),
    Parameter("frame", str, "Link that carries the payload; empty: the last one.", ""),
    tunable("memory", 10.0, 0.1, 1e4, "Time after which samples count 1/e [s]."),
    tunable("largest_mass", 10.0, 1e-6, 1e6, "Mass that may be expected [kg]."),
    tunable("size", 0.2, 1e-4, 100.0, "Size of the payload that may be expected [m]."),
)
DEPTH = 10
LABELS = tuple(f"{a}.{b}" for a in PARAMETER_NAMES for b in PARAMETER_NAMES)


class PayloadEstimatorNode(Shell):
    """Says what a link carries, after every eighth of a period of the filter."""

    NAME = "payload_estimator"
    PARAMETERS = PARAMETERS
    _pipeline: PayloadPipeline

    def __init__(self, argv: Sequence[str] = ()) -> None:
        super().__init__(argv)
        self._description = RobotDescription(self, self.build)
        self._stream = JointStateStream(
            self, self._description, lambda: self._pipeline, self.forget
        )

    def build(self, description: str | None) -> None:
        """Build the scene."""
        self._pipeline = PayloadPipeline(self.parameters, description)

    def configure_core(self) -> None:
        """Build the scene and its topics."""
        self._payload = self.publish_to(InertiaStamped, "~/payload", DEPTH)
        self._covariance = self.publish_to(Float64MultiArray, "~/covariance", DEPTH)
        self._message = InertiaStamped()
        self._writer = MultiArrayCdrWriter(COUNT**2, LABELS)
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
        """Empty filters, and forget the payload."""
        self._pipeline.forget()

    def retune(self, values: Any) -> None:
        """New tuning; the estimate starts again."""
        self._pipeline.tune(values)

    def health(self) -> tuple[int, str, dict[str, str]]:
        """State of the stream, then what the motion shows."""
        details = {**self._pipeline.details(), **self._stream.details()}
        level, text = self._stream.health()
        if level == OK:
            level, text = self._pipeline.health()
        return level, text, details

    def answer(self, stamp: int, sample: JointSample) -> SampleStatus | None:
        """Take one joint state."""
        try:
            payload = self._pipeline.answer(stamp, sample)
        except SolveError as error:
            self._stream.drop("unsolved", f"joint_states: {error}")
            return None
        if isinstance(payload, SampleStatus):
            return payload
        if isinstance(payload, Carried):
            numbers = payload.mass, payload.centre, payload.moments
            self._payload.publish(
                write_inertia(self._message, stamp, self._pipeline.frame, *numbers)
            )
            self._covariance.publish(self._writer.write(payload.covariance))
        self._stream.note_answer(stamp)
        return None
