"""Node `digital_twin`: a few measurements of a machine in, all of it out, with alarms."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import WrenchStamped
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from mbd_ros.errors import MbdError
from mbd_ros.nodes.shell.parameters import Parameter, tunable
from mbd_ros.nodes.state_estimator.digital_twin.pipeline import TwinPipeline
from mbd_ros.nodes.state_estimator.node import DEPTH, StateEstimatorNode
from mbd_ros.nodes.state_estimator.parameters import ESTIMATION
from mbd_ros.nodes.state_estimator.pipeline import EstimateMessages
from msg_adapters.time import write_time

PARAMETERS = (
    *ESTIMATION,
    Parameter(
        "reactions",
        list[str],
        "Joints whose reactions are published on `~/reactions/<joint>`; `all` for every one.",
        (),
    ),
    tunable("horizon", 1.0, 1e-3, 60.0, "Time that `~/predict` predicts [s]."),
    tunable("prediction_step", 0.01, 1e-3, 1.0, "Between two points of a prediction [s]."),
    Parameter(
        "look_ahead",
        float,
        "Singular configurations that are no farther away are flagged [s].",
        0.05,
        low=1e-3,
        high=1.0,
    ),
    Parameter(
        "amplification",
        float,
        "Amplification of errors of what is measured from which a configuration is singular.",
        100.0,
        low=1.0,
        high=1e9,
    ),
    Parameter(
        "alarm_threshold",
        float,
        "Cumulative sum of residuals, in deviations, that is an alarm.",
        30.0,
        low=1.0,
        high=1e6,
    ),
    Parameter(
        "hypotheses",
        list[str],
        "Faults that may be named: `<name>: <part>.<argument>=<number>, ..`, one a text.",
        (),
    ),
    Parameter(
        "naming_window",
        float,
        "Time over which faults are compared [s].",
        1.0,
        low=0.01,
        high=600.0,
    ),
)
_NS = 1_000_000_000  # ns in a second


class DigitalTwinNode(StateEstimatorNode):
    """Answers every measurement with the state of the whole machine, and its reactions."""

    NAME = "digital_twin"
    PARAMETERS = PARAMETERS
    _pipeline: TwinPipeline

    def __init__(self, argv: Any = ()) -> None:
        super().__init__(argv)
        self.create_service(Trigger, "~/predict", self._on_predict)

    def build(self, description: str | None) -> None:
        """Build the scene."""
        self._pipeline = TwinPipeline(self.parameters, description)
        self._stream.failures = 0

    def configure_core(self) -> None:
        """Build the scene and its topics."""
        super().configure_core()
        self._determination = self.publish_to(Float64MultiArray, "~/determination", DEPTH)
        self._prediction = self.publish_to(JointTrajectory, "~/prediction", 1)
        self._reactions = {
            name: self.publish_to(WrenchStamped, f"~/reactions/{name}", DEPTH)
            for name in self._pipeline.reactions
        }

    def publish_answer(self, answer: EstimateMessages) -> None:
        """Send what was estimated."""
        super().publish_answer(answer)
        more = self._pipeline.more(answer.stamp)
        self._determination.publish(more.determination)
        for name, message in more.reactions.items():
            self._reactions[name].publish(message)

    def _on_predict(self, request: Any, response: Any) -> Any:
        response.success = False
        if not self.active or self._pipeline.tracker is None:
            response.message = "nothing is estimated yet"
            return response
        values = self.parameters
        try:
            prediction = self._pipeline.predicted(values.horizon, values.prediction_step)
        except MbdError as error:
            response.message = str(error)
            return response
        stamp, times, q, v = prediction
        message = JointTrajectory()
        write_time(message.header.stamp, stamp)
        message.joint_names = [joint.name for joint in self._pipeline.scene.robot.joints]
        for t, position, velocity in zip(times.tolist(), q.tolist(), v.tolist(), strict=True):
            point = JointTrajectoryPoint(positions=position, velocities=velocity)
            whole = round(t * _NS)
            point.time_from_start.sec, point.time_from_start.nanosec = divmod(whole, _NS)
            message.points.append(point)
        self._prediction.publish(message)
        response.success, response.message = True, f"{len(times)} points on ~/prediction"
        return response
