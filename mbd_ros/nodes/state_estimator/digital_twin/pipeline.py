"""From a few measurements of a machine to messages with all of its state, and alarms."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import WrenchStamped

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.model.robot import child_link
from mbd_ros.core.state import NANOSECOND, Array, State
from mbd_ros.errors import MbdError
from mbd_ros.features.estimation.estimation import Estimation, prepare_scene
from mbd_ros.features.estimation.faults import Cusum, Diagnosis, FaultNaming
from mbd_ros.features.estimation.state_reconstruction import Determination, Determinations
from mbd_ros.features.estimation.tracker import SampleOutcome
from mbd_ros.methods.inverse_dynamics.reactions import SystemReactions
from mbd_ros.nodes.shell.parameters import ParameterError
from mbd_ros.nodes.state_estimator.pipeline import Answer, EstimatorPipeline, refuse_unknown
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.runs.simulation import build_simulation
from mbd_ros.scene.variants import with_numbers
from msg_adapters.diagnostics import OK, WARN
from msg_adapters.joint_state import JointSample
from msg_adapters.multi_array import MultiArrayCdrWriter
from msg_adapters.wrench import write_wrench

_FORM = "<name>: <part>.<argument>=<number>, .."
_NUMBERS = ("amplification", "multiplier_amplification", "time_to_singular", "is_singular")
_ALL = "all"


class TwinPipeline(EstimatorPipeline):
    """Scene, estimator and watches of a configured node `digital_twin`.

    Args:
        description: URDF, where the scene takes it from a topic.

    Attributes:
        determination: How well the newest state is determined.
        alarms: Of numbers that are measured.
        fault: What explains unknown efforts.
    """

    def __init__(self, values: Any, description: str | None) -> None:
        self._cusum: Cusum | None = None
        super().__init__(values, description)
        setup, robot = self.estimation, self.scene.robot
        system = setup.process.simulation.system
        self._system = system
        names = [joint.name for joint in robot.joints]
        measured = list(values.measured) or names
        self._determinations = Determinations(
            system, measured, values.look_ahead, values.amplification
        )
        self._compared = [name for name in names if name not in measured]
        numbers = (*setup.process.sensors.names, *self._compared)
        self._cusum = Cusum(numbers, threshold=values.alarm_threshold)
        wanted = list(names if _ALL in values.reactions else values.reactions)
        refuse_unknown(wanted, names)
        self.reactions = {name: (names.index(name), WrenchStamped()) for name in wanted}
        self._felt = SystemReactions(system)
        self._frames = {j.name: child_link(robot.model, j.v) for j in robot.joints}
        self._writer_of_numbers = MultiArrayCdrWriter(len(_NUMBERS), _NUMBERS)
        self._naming = self._name_faults(values)

    def _name_faults(self, values: Any) -> FaultNaming | None:
        if not values.hypotheses:
            return None
        if values.parameters:
            raise ParameterError("hypotheses and parameters: accepted is one of them")
        found = self.estimation
        systems = hypothesis_systems(self.scene, found, values.hypotheses)
        at = np.array([self.scene.robot.joint(name).v for name in found.disturbed], dtype=np.intp)
        return FaultNaming(self._system, systems, at, values.naming_window)

    def forget(self) -> None:
        """Forget the past, that of the watches too."""
        super().forget()
        self.determination = Determination(0.0, 1.0, math.inf)
        self.fault = Diagnosis("", {}, 0.0)
        self._began = 0.0
        if self._cusum is not None:
            self._cusum.reset()
            if self._naming is not None:
                self._naming.reset()

    def answer(self, stamp: int, sample: JointSample) -> Answer:
        """Messages for a joint state, whose measurements are watched for faults."""
        answer = super().answer(stamp, sample)
        if not isinstance(answer, SampleOutcome):
            self._watch(sample)
        return answer

    def _watch(self, sample: JointSample) -> None:
        assert self.tracker is not None and self._cusum is not None
        belief, system = self.tracker.belief, self._system
        now = self._writer.now
        self.determination = self._determinations.at(belief.x, system.integrated(now.a))
        assert belief.innovation is not None
        self._cusum.add(np.concatenate((belief.innovation.normalized, self._off(now.x, sample))))
        if self._naming is not None and self.estimation.disturbed:
            lacking = self.estimation.unknown_efforts(now.x)
            nz = len(belief.x.z)
            spread = np.sqrt(belief.P.diagonal()[-nz:][self.estimation.disturbance])
            self._naming.add(now.x, self._newest_u, lacking, spread)
            self.fault = self._naming.diagnose()

    def _off(self, x: State, sample: JointSample) -> Array:
        """Measured less predicted of joints that do not count, in deviations."""
        assert self.tracker is not None
        robot, values = self.scene.robot, self._values
        rows = [robot.joint(name) for name in self._compared]
        at = [self.joints.names.index(name) for name in self._compared]
        lift = self.estimation.process.tangent.lift_to_joints(self.tracker.belief.x)
        known = lift[[joint.v for joint in rows]]
        spread = np.einsum("ij,ij->i", known.dot(self.tracker.belief.P), known)
        error = sample.position[at] - x.q[[joint.q for joint in rows]]
        return np.asarray(error / np.sqrt(spread + values.position_noise**2))

    def more(self, stamp: int) -> TwinMessages:
        """Return the results of the twin besides the newest estimate."""
        now = self._writer.now
        reactions = {}
        if self.reactions:
            local = self._felt.at(now.x, self._newest_u, now.a, now.lam)
            for name, (row, message) in self.reactions.items():
                reactions[name] = write_wrench(message, stamp, self._frames[name], local[row])
        found = self.determination
        is_singular = math.isfinite(found.time)
        time = found.time if is_singular else self._values.look_ahead
        numbers = found.amplification, found.of_multipliers, time, float(is_singular)
        return TwinMessages(reactions, self._writer_of_numbers.write(numbers))

    def predicted(self, horizon: float, step: float) -> tuple[int, Array, Array, Array]:
        """The motion that follows, under the inputs that are.

        Args:
            horizon: [s].
            step: Between two points [s].

        Returns:
            Stamp of the estimate [ns], times after it [s], shape (n,), positions and velocities
            of all joints, shape (n, joints).

        Raises:
            SolveError: Nothing is estimated yet, or equations contradict one another.
            DivergedError: The prediction is no longer finite.
        """
        assert self.tracker is not None
        belief, joints = self.tracker.belief, self.scene.robot.joints
        simulation = build_simulation(self.estimation.scene)
        system = simulation.system
        y = simulation.start(self._system.expand(belief.x), self._newest_u)
        times = np.arange(1, max(1, round(horizon / step)) + 1) * step
        q, v = np.empty((2, len(times), len(joints)))
        for i, t in enumerate(times.tolist()):
            y = simulation.advance(y, self._newest_u, belief.t + t)
            x = system.expand(y)
            q[i], v[i] = x.q[[j.q for j in joints]], x.v[[j.v for j in joints]]
        return self._origin + round(belief.t / NANOSECOND), times, q, v

    def health(self) -> tuple[int, str]:
        """WARN as the estimator does, at alarms, named faults and near singular configurations."""
        level, text = super().health()
        assert self._cusum is not None
        reasons = [f"{name}: {what}" for name, what in self._cusum.alarms().items()]
        if self.fault.name:
            reasons.insert(0, f"fault: {self.fault.name}")
        if math.isfinite(self.determination.time):
            reasons.append(f"singular configuration in {self.determination.time:.3f} s")
        if not reasons:
            return level, text
        return WARN, "; ".join([*reasons, *([text] if level != OK else [])])

    def details(self) -> dict[str, str]:
        """Return figures of the newest estimate and the watches, for diagnostics."""
        result = self.determination
        shares = ", ".join(f"{name} {share:.2g}" for name, share in self.fault.shares.items())
        assert self._cusum is not None
        return {
            **super().details(),
            "amplification of errors": f"{result.amplification:.4g}",
            "amplification of multipliers": f"{result.of_multipliers:.4g}",
            "alarms": ", ".join(self._cusum.alarms()) or "none",
            "fault": self.fault.name or "none",
            "unexplained by hypotheses": shares or "none compared",
        }


class TwinMessages(NamedTuple):
    """Results of the twin besides the estimate.

    Attributes:
        reactions: WrenchStamped by joint, in the axes of the joint on its child.
        determination: Float64MultiArray, labelled, serialized.
    """

    reactions: dict[str, Any]
    determination: bytes


def hypothesis_systems(
    scene: Scene, estimation: Estimation, texts: Sequence[str]
) -> dict[str, System]:
    """Name -> the mechanism with other numbers in it.

    Args:
        scene: As it is thought to be, as it is read.
        estimation: What is estimated of it.
        texts: Of the parameter `hypotheses`.

    Raises:
        ParameterError: A text of another form, or a number that the scene does not have.
    """
    systems = {}
    for text in texts:
        name, _, assignments = text.partition(":")
        if not name.strip() or not assignments.strip():
            raise ParameterError(f"hypotheses: '{text}', accepted: {_FORM}")
        try:
            changed = with_numbers(scene, _numbers(text, assignments))
            prepared = prepare_scene(changed, estimation.task, estimation.disturbed)
            systems[name.strip()] = prepared.system()
        except MbdError as error:
            raise ParameterError(f"hypotheses: '{text}': {error}") from error
    return systems


def _numbers(text: str, assignments: str) -> dict[str, float]:
    numbers = {}
    for one in assignments.split(","):
        key, _, value = one.partition("=")
        try:
            numbers[key.strip()] = float(value)
        except ValueError as error:
            raise ParameterError(f"hypotheses: '{text}', accepted: {_FORM}") from error
    return numbers
