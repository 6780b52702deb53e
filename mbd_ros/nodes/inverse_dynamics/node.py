"""Node `inverse_dynamics`: joint states and wrenches in, torques and coupling forces out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

from mbd_ros.errors import SolveError
from mbd_ros.methods.inverse_dynamics.stance import StanceThresholds
from mbd_ros.methods.inverse_dynamics.torque_estimator import Observation
from mbd_ros.methods.signals.differentiation import SampleStatus
from mbd_ros.nodes.inverse_dynamics.pipeline import Part, Pipeline
from mbd_ros.nodes.shell.joint_state_stream import SENSOR, JointStateStream
from mbd_ros.nodes.shell.parameters import STREAM, Parameter, tuning
from mbd_ros.nodes.shell.robot_description import LATCHED, RobotDescription
from mbd_ros.nodes.shell.serialized import read_load, require_size
from mbd_ros.nodes.shell.shell import Shell
from msg_adapters.diagnostics import OK, WARN
from msg_adapters.errors import MessageError
from msg_adapters.joint_state import JointSample

PARAMETERS = (
    *STREAM,
    Parameter("power", bool, "Publish powers and their balance on ~/power.", False),
    Parameter(
        "stance",
        str,
        "Forces of rigid contacts that no wrench gives: 0, or unknowns with the least efforts.",
        "none",
        choices=("none", "minimum-norm"),
    ),
    Parameter(
        "phase_topic",
        str,
        "Topic of the name of the phase, whose contacts are on the ground; empty for geometry.",
        "",
    ),
    Parameter(
        "stance_gap",
        float,
        "Largest gap of what is on the ground, as a multiple of the size [-].",
        StanceThresholds().gap,
        low=0.0,
        high=1.0,
    ),
    Parameter(
        "stance_speed",
        float,
        "Largest speed of it along the normal, of the root of gravity times size [-].",
        StanceThresholds().speed,
        low=0.0,
        high=100.0,
    ),
)
POWERS = 100  # a reader may be away for 0.1 s at 1 kHz


class InverseDynamicsNode(Shell):
    """Answers every joint state with the torques that explain the motion."""

    NAME = "inverse_dynamics"
    PARAMETERS = PARAMETERS
    _pipeline: Pipeline

    def __init__(self, argv: Sequence[str] = ()) -> None:
        super().__init__(argv)
        self._description = RobotDescription(self, self.build)
        self._stream = JointStateStream(
            self,
            self._description,
            lambda: self._pipeline,
            self.forget,
            stamped="joint states or wrenches",
        )

    def build(self, description: str | None) -> None:
        """Build the scene."""
        self._pipeline = Pipeline(self.parameters, description)

    def configure_core(self) -> None:
        """Build the scene and its topics."""
        self._description.build()
        self._listen()
        self.open_outputs()
        wrenches = self._pipeline.scene.wrenches
        for name, wrench in wrenches.items():
            self.subscribe(WrenchStamped, wrench.heard_on, self._on_wrench(name), SENSOR)
        if wrenches:
            self.every(max(self.parameters.wrench_wait / 2.0, 1e-3), self._flush)

    def open_outputs(self) -> None:
        """Topics of torques, constraint forces and residuals; powers and phases where asked."""
        self._torques = self.publish_to(JointState, "~/joint_torques", 10)
        self._constraint_forces = self.publish_to(JointState, "~/constraint_forces", 10)
        if self.parameters.phase_topic:
            self.subscribe(String, self.parameters.phase_topic, self._on_phase, LATCHED)
        if self.parameters.power:
            self._pipeline.with_power()
            self._power = self.publish_to(Float64MultiArray, "~/power", POWERS)
        self._residuals = [
            self.publish_to(WrenchStamped, f"~/residual/{base.name}", 10)
            for base in self._pipeline.scene.robot.bases
        ]

    def _listen(self) -> None:
        """Subscribe to joint states, and to what belongs to them on other topics."""
        assembler = self._pipeline.assembler
        if assembler is None:
            self._stream.listen(self.answer)
            return
        for topic in assembler.joint_topics:
            take = self._on_part(topic, partial(self._read_joints, topic))
            self.subscribe(JointState, topic, take, SENSOR, single_publisher=True, raw=True)
        if not assembler.body_topics:
            return
        from nav_msgs.msg import Odometry  # only where something flies

        from msg_adapters.pose import read_odometry

        for topic, base in zip(
            assembler.body_topics, self._pipeline.scene.robot.bases, strict=True
        ):
            take = self._on_part(topic, partial(read_odometry, link=base.frame))
            self.subscribe(Odometry, topic, take, SENSOR, single_publisher=True)

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
        """Empty filters, wrench buffers and the queue."""
        self._pipeline.reset()

    def retune(self, values: Any) -> None:
        """New tuning for the estimator; its filters start again."""
        if tuning(values) != tuning(self.parameters):
            self._pipeline.estimator.tune(tuning(values))

    def health(self) -> tuple[int, str, dict[str, str]]:
        """State of the stream, then contents of the numbers."""
        details = {**self._pipeline.details(), **self._stream.details()}
        level, text = self._stream.health()
        assembler = self._pipeline.assembler
        if level != OK and assembler is not None and assembler.unheard:
            text = f"{text}; nothing heard on {', '.join(sorted(assembler.unheard))}"
        if level == OK:
            level, text = self._pipeline.health(self.parameters.coupling_tolerance)
        doubts = self._pipeline.scene.robot.inertia_warnings
        if doubts:
            return max(level, WARN), f"{text}; inertias in doubt: {'; '.join(doubts)}", details
        return level, text, details

    def answer(self, stamp: int, sample: JointSample) -> SampleStatus | None:
        """Publish the torques of one joint state, or let it wait for its wrenches."""
        return self._answer(self._pipeline.observe(stamp, sample))

    def _answer(self, x: Observation | SampleStatus) -> SampleStatus | None:
        pipeline = self._pipeline
        if isinstance(x, SampleStatus):
            return x
        if pipeline.scene.wrenches:
            pipeline.queue.add(x, self.parameters.wrench_wait)
            self._flush()
        else:
            self._solve(x, ())
        return None

    def _read_joints(self, topic: str, cdr: bytes) -> JointSample:
        require_size(cdr, JointState)
        assert self._pipeline.assembler is not None
        return self._pipeline.assembler.read(topic, cdr)

    def _on_part(self, topic: str, read: Callable[[Any], Part]) -> Callable[[Any], None]:
        """Return the callback for a part of samples that come on several topics."""

        def take(message: Any) -> None:
            pipeline = self._pipeline
            assert pipeline.assembler is not None
            try:
                part = read(message)
                stamp = self._stream.stamp_of(part.stamp) if part.stamp else 0
                if stamp is None:
                    return
                sample, lost = pipeline.assembler.add(topic, stamp, part)
            except MessageError as error:
                self._stream.drop("malformed", f"{topic}: {error}")
                return
            for _ in range(lost):
                self._stream.drop("no_partner", "messages of one stamp did not come on all topics")
            if sample is not None:
                observed = partial(pipeline.observe_assembled, sample)
                self._stream.judge(lambda: self._answer(observed()), pipeline.assembler)

        return take

    def _on_wrench(self, name: str) -> Callable[[Any], None]:
        def take(msg: Any) -> None:
            buffer = self._pipeline.queue.buffers[name]
            try:
                sample = read_load(msg, self._pipeline.scene.wrenches[name])
            except MessageError as error:
                self.drop("wrench", str(error))
                return
            if not buffer.add(sample.stamp or self._stream.receive_time(), sample.wrench):
                self.drop("wrench", f"wrench '{name}': stamp not newer than the last")
            else:
                self._flush()

        return take

    def _on_phase(self, msg: Any) -> None:
        try:
            self._pipeline.take_phase(msg.data)
        except MessageError as error:
            self.drop("phase", str(error))

    def _flush(self) -> None:
        """Answer the joint states whose wrenches are complete or overdue."""
        for x, wrenches in self._pipeline.queue.take():
            lacking = [name for name, wrench in wrenches.items() if wrench is None]
            if lacking:
                self._stream.drop("no_wrench", f"no wrench '{lacking[0]}' near the joint state")
            else:
                self._solve(x, tuple(wrenches.values()))

    def _solve(self, x: Observation, wrenches: Sequence[Any]) -> None:
        try:
            is_answered = self.publish_answer(x, wrenches)
        except SolveError as error:
            self._stream.drop("unsolved", str(error))
            return
        if not is_answered:
            self._stream.drop("result", "the torques of a joint state are not finite")
            return
        self._stream.note_answer(x.stamp)

    def publish_answer(self, x: Observation, wrenches: Sequence[Any]) -> bool:
        """Solve and publish; False where torques are not finite.

        Raises:
            SolveError: There are none.
        """
        messages = self._pipeline.answer(x, wrenches)
        if messages is None:
            return False
        self._torques.publish(messages.torques)
        if messages.forces is not None:
            self._constraint_forces.publish(messages.forces)
        for publisher, residual in zip(self._residuals, messages.residuals, strict=True):
            publisher.publish(residual)
        if messages.power is not None:
            self._power.publish(messages.power)
        return True
