"""Node `muscle_forces`: joint states and wrenches in, forces of muscles and joint loads out."""

from collections.abc import Sequence
from typing import Any

from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from mbd_ros.jobs.options import parameters_of
from mbd_ros.methods.inverse_dynamics.torque_estimator import Observation
from mbd_ros.nodes.inverse_dynamics.muscle_forces.pipeline import MusclePipeline
from mbd_ros.nodes.inverse_dynamics.node import InverseDynamicsNode
from mbd_ros.nodes.shell.joint_state_stream import SENSOR
from mbd_ros.nodes.shell.parameters import STREAM, Parameter
from msg_adapters.errors import MessageError

DEPTH = 100  # a reader may be away for 0.1 s at 1 kHz
_KEYS = parameters_of("mbd_ros.features.muscles.task:task_of_keys")
PARAMETERS = (
    *STREAM,
    Parameter(
        "objective",
        str,
        "What the activations make least, as of `mbd-ros muscles`.",
        _KEYS["objective"].default,
        choices=_KEYS["objective"].choices,
    ),
    Parameter(
        "exponent",
        float,
        "Of the activations, from 1 on; 0 for that of the objective.",
        0.0,
        low=0.0,
        high=10.0,
    ),
    Parameter("passive", bool, "Passive force of the fibres takes part.", False),
    Parameter(
        "reserves",
        float,
        "Optimal force of a reserve on every coordinate [N·m, N]; 0 for none.",
        1.0,
        low=0.0,
        high=1.0e9,
    ),
    Parameter(
        "reserve_file",
        str,
        "Reserves from actuators of OpenSim (.xml) in place of these; empty for none.",
        "",
    ),
    Parameter(
        "rise", float, "Fastest rise of an activation [1/s]; 0 for any.", 0.0, low=0.0, high=1.0e9
    ),
    Parameter(
        "fall", float, "Fastest fall of an activation [1/s]; 0 for any.", 0.0, low=0.0, high=1.0e9
    ),
    Parameter(
        "emg_use",
        str,
        "Measured activations on ~/emg: none are heard, activations are near them (track), or not "
        "below them (least).",
        "none",
        choices=("none", *_KEYS["emg_use"].choices),
    ),
    Parameter(
        "emg_weight",
        float,
        "Of the squared distance from measured activations.",
        _KEYS["emg_weight"].default,
        low=1.0e-9,
        high=1.0e9,
    ),
    Parameter(
        "emg_max_age",
        float,
        "How long measured activations stand [s].",
        0.1,
        low=0.0,
        high=60.0,
    ),
    Parameter(
        "reactions",
        str,
        "Loads of joints to publish: none, on the child in its axes, on the parent in its axes, "
        "or on the child in world axes (ground).",
        "none",
        choices=("none", *_KEYS["reactions"].choices),
    ),
    Parameter("links", list[str], "Links whose joint is asked for; empty for all with mass.", ()),
)


class MuscleForcesNode(InverseDynamicsNode):
    """Answers every joint state with the forces of muscles that explain the motion."""

    NAME = "muscle_forces"
    PARAMETERS = PARAMETERS
    _pipeline: MusclePipeline

    def build(self, description: str | None) -> None:
        """Build the scene."""
        self._pipeline = MusclePipeline(self.parameters, description)

    def open_outputs(self) -> None:
        """Topics of muscles, reserves and loads of joints; measured activations."""
        self._forces = self.publish_to(JointState, "~/muscle_forces", DEPTH)
        self._activations = self.publish_to(Float64MultiArray, "~/activations", DEPTH)
        self._reserves = self.publish_to(JointState, "~/reserve_forces", DEPTH)
        self._loads = [
            self.publish_to(WrenchStamped, f"~/joint_loads/{link}", DEPTH)
            for link in self._pipeline.links
        ]
        if self.parameters.emg_use != "none":
            self.subscribe(Float64MultiArray, "~/emg", self._on_emg, SENSOR)

    def publish_answer(self, x: Observation, wrenches: Sequence[Any]) -> bool:
        """Share and publish; False where what the motion needs is not finite.

        Raises:
            SolveError: Muscles and reserves cannot produce the motion.
        """
        answer = self._pipeline.share(x, wrenches)
        if answer is None:
            return False
        self._forces.publish(answer.forces)
        self._activations.publish(answer.activations)
        if answer.reserves is not None:
            self._reserves.publish(answer.reserves)
        for publisher, load in zip(self._loads, answer.loads, strict=True):
            publisher.publish(load)
        return True

    def _on_emg(self, msg: Any) -> None:
        try:
            self._pipeline.measured.take(msg)
        except MessageError as error:
            self.drop("emg", f"emg: {error}")
