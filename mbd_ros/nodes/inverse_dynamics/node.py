"""Node `inverse_dynamics`: joint states and wrenches in, torques and coupling forces out."""

from collections.abc import Callable, Sequence
from typing import Any

from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState

from mbd_ros.core.estimation.differentiation import SampleStatus
from mbd_ros.core.estimation.torque_estimator import Observation
from mbd_ros.errors import SolveError
from mbd_ros.nodes.inverse_dynamics.parameters import PARAMETERS, tuning
from mbd_ros.nodes.inverse_dynamics.pipeline import Pipeline
from mbd_ros.nodes.shell.joint_state_node import SENSOR, JointStateNode
from mbd_ros.nodes.shell.wrenches import read_load
from msg_adapters.diagnostics import OK, WARN
from msg_adapters.errors import MessageError
from msg_adapters.joint_state import JointSample


class InverseDynamicsNode(JointStateNode):
    """Answers every joint state with the torques that explain the motion."""

    NAME = "inverse_dynamics"
    PARAMETERS = PARAMETERS
    STAMPED = "joint states or wrenches"
    _pipeline: Pipeline

    def build(self, description: str | None) -> None:
        """Build the scene."""
        self._pipeline = Pipeline(self.parameters, description)

    def configure_core(self) -> None:
        """Build the scene and its topics."""
        self._torques = self.publish_to(JointState, "~/joint_torques", 10)
        self._constraint_forces = self.publish_to(JointState, "~/constraint_forces", 10)
        super().configure_core()
        wrenches = self._pipeline.scene.wrenches
        for name, wrench in wrenches.items():
            self.subscribe(WrenchStamped, wrench.heard_on, self._on_wrench(name), SENSOR)
        if wrenches:
            self.every(max(self.parameters.wrench_wait / 2.0, 1e-3), self._flush)

    def forget(self) -> None:
        """Empty filters, wrench buffers and the queue."""
        self._pipeline.reset()

    def retune(self, values: Any) -> None:
        """New tuning for the estimator; its filters start again."""
        if tuning(values) != tuning(self.parameters):
            self._pipeline.estimator.tune(tuning(values))

    def health(self) -> tuple[int, str, dict[str, str]]:
        """State of the stream, then contents of the numbers."""
        details = {**self._pipeline.details(), **self.stream_details()}
        level, text = self.stream_health()
        if level == OK:
            level, text = self._pipeline.health(self.parameters.coupling_tolerance)
        doubts = self._pipeline.scene.robot.doubts
        if doubts:
            return max(level, WARN), f"{text}; inertias in doubt: {'; '.join(doubts)}", details
        return level, text, details

    def answer(self, stamp: int, sample: JointSample) -> SampleStatus | None:
        """Publish the torques of one joint state, or let it wait for its wrenches."""
        pipeline = self._pipeline
        x = pipeline.observe(stamp, sample)
        if isinstance(x, SampleStatus):
            return x
        if pipeline.scene.wrenches:
            pipeline.queue.add(x, self.parameters.wrench_wait)
            self._flush()
        else:
            self._solve(x, ())
        return None

    def _on_wrench(self, name: str) -> Callable[[Any], None]:
        def take(msg: Any) -> None:
            buffer = self._pipeline.queue.buffers[name]
            try:
                sample = read_load(msg, self._pipeline.scene.wrenches[name])
            except MessageError as error:
                self.drop("wrench", str(error))
                return
            if not buffer.add(sample.stamp or self.receive_time(), sample.wrench):
                self.drop("wrench", f"wrench '{name}': stamp not newer than the last")
            else:
                self._flush()

        return take

    def _flush(self) -> None:
        """Answer the joint states whose wrenches are complete or overdue."""
        for x, wrenches in self._pipeline.queue.take():
            lacking = [name for name, wrench in wrenches.items() if wrench is None]
            if lacking:
                self.drop_state("no_wrench", f"no wrench '{lacking[0]}' near the joint state")
            else:
                self._solve(x, tuple(wrenches.values()))

    def _solve(self, x: Observation, wrenches: Sequence[Any]) -> None:
        try:
            messages = self._pipeline.answer(x, wrenches)
        except SolveError as error:
            self.drop_state("unsolved", str(error))
            return
        if messages is None:
            self.drop_state("result", "the torques of a joint state are not finite")
            return
        torques, constraint_forces = messages
        self._torques.publish(torques)
        if constraint_forces is not None:
            self._constraint_forces.publish(constraint_forces)
        self.note_answer(x.stamp)
