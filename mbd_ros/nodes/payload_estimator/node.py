"""Node `payload_estimator`: joint states with efforts in, mass and inertia of the payload out."""

from typing import Any

from geometry_msgs.msg import InertiaStamped
from std_msgs.msg import Float64MultiArray

from mbd_ros.core.model.inertial_parameters import COUNT, PLACES
from mbd_ros.methods.signals.differentiation import SampleStatus
from mbd_ros.nodes.payload_estimator.parameters import PARAMETERS
from mbd_ros.nodes.payload_estimator.pipeline import Carried, PayloadPipeline
from mbd_ros.nodes.shell.joint_state_node import JointStateNode
from msg_adapters.diagnostics import OK
from msg_adapters.inertia import write_inertia
from msg_adapters.joint_state import JointSample
from msg_adapters.multi_array_cdr import MultiArrayCdrWriter

DEPTH = 10
LABELS = tuple(f"{a}.{b}" for a in PLACES for b in PLACES)


class PayloadEstimatorNode(JointStateNode):
    """Says what a link carries, after every eighth of a period of the filter."""

    NAME = "payload_estimator"
    PARAMETERS = PARAMETERS
    _pipeline: PayloadPipeline

    def build(self, description: str | None) -> None:
        """Build the scene."""
        self._pipeline = PayloadPipeline(self.parameters, description)

    def configure_core(self) -> None:
        """Build the scene and its topics."""
        self._payload = self.publish_to(InertiaStamped, "~/payload", DEPTH)
        self._covariance = self.publish_to(Float64MultiArray, "~/covariance", DEPTH)
        self._message, self._writer = InertiaStamped(), MultiArrayCdrWriter(COUNT**2, LABELS)
        super().configure_core()

    def forget(self) -> None:
        """Empty filters, and forget the payload."""
        self._pipeline.forget()

    def retune(self, values: Any) -> None:
        """New tuning; the estimate starts again."""
        self._pipeline.tune(values)

    def health(self) -> tuple[int, str, dict[str, str]]:
        """State of the stream, then what the motion shows."""
        details = {**self._pipeline.details(), **self.stream_details()}
        level, text = self.stream_health()
        if level == OK:
            level, text = self._pipeline.health()
        return level, text, details

    def answer(self, stamp: int, sample: JointSample) -> SampleStatus | None:
        """Take one joint state."""
        found = self._pipeline.answer(stamp, sample)
        if isinstance(found, SampleStatus):
            return found
        if isinstance(found, Carried):
            numbers = found.mass, found.centre, found.moments
            self._payload.publish(
                write_inertia(self._message, stamp, self._pipeline.frame, *numbers)
            )
            self._covariance.publish(self._writer.write(found.covariance))
        self.note_answer(stamp)
        return None
