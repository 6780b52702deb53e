"""A built scene between messages: from a serialized joint state to its answers."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from geometry_msgs.msg import WrenchStamped

from mbd_ros.core.inverse_dynamics.observed_loops import ObservedLoops
from mbd_ros.core.inverse_dynamics.standing import Nearness
from mbd_ros.core.inverse_dynamics.torque_estimator import Observation, TorqueEstimator
from mbd_ros.core.inverse_dynamics.torques import SampleSolver
from mbd_ros.core.kinematics.free_bases import IndependentCoordinates
from mbd_ros.core.kinematics.poses import TWIST
from mbd_ros.core.signals.differentiation import SampleStatus
from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import SceneError
from mbd_ros.nodes.inverse_dynamics.wrench_queue import WrenchQueue
from mbd_ros.nodes.shell.serialized import joint_state
from mbd_ros.nodes.shell.stream_parameters import tuning
from mbd_ros.scene.describe.check import tier
from mbd_ros.scene.reader import load_scene
from msg_adapters.diagnostics import OK, WARN
from msg_adapters.errors import MessageError
from msg_adapters.joint_state import JointSample, JointStateReader
from msg_adapters.joint_state_cdr import JointStateCdrReader, JointStateCdrWriter
from msg_adapters.wrench import write_wrench

if TYPE_CHECKING:
    from mbd_ros.nodes.inverse_dynamics.power import PowerAnswer
    from mbd_ros.nodes.inverse_dynamics.whole_samples import WholeSample, WholeSamples


class Answer(NamedTuple):
    """Messages for an observation.

    Attributes:
        torques: JointState of the independent joints.
        forces: JointState of rows: position = violation of the coupling or loop, effort =
            multiplier; None without any.
        residuals: WrenchStamped of what nothing carries of each free body.
        power: Float64MultiArray of powers; None where nobody asked.
    """

    torques: Any
    forces: Any
    residuals: list[Any]
    power: Any


class Pipeline:
    """Scene and estimator of a configured node `inverse_dynamics`.

    Args:
        values: Parameters of the node.
        description: URDF, where the scene takes it from a topic.

    Attributes:
        scene: The scene.
        estimator: Samples to torques.
        joints: Which joints the newest joint state carried.
        reader: Serialized joint states to samples.
        whole: Samples that come on several topics; None where one has all.
        queue: Observations that wait for their wrenches; unused without wrenches.
    """

    def __init__(self, values: Any, description: str | None) -> None:
        self.scene = load_scene(values.scene, description)
        couplings, robot = self.scene.couplings, self.scene.robot
        self._solver = self.make_solver(values)
        self.estimator = TorqueEstimator(self.scene.robot, self._solver, tuning(values))
        self.joints = JointStateReader(self.estimator.names, with_effort=False)
        self.reader = JointStateCdrReader(self.joints, joint_state)
        bodies = [base.name for base in robot.bases]
        self.whole: WholeSamples | None = None
        if bodies or robot.members:
            from mbd_ros.nodes.inverse_dynamics import whole_samples  # only for several topics

            names = self.estimator.names
            self.whole = whole_samples.WholeSamples(names, robot.members, bodies, joint_state)
        self._at = IndependentCoordinates(robot, couplings) if bodies else None
        self._residuals = [WrenchStamped() for _ in bodies]
        self._torques = JointStateCdrWriter(couplings.independent)
        rows = self._solver.rows
        self._forces = JointStateCdrWriter(rows, ("position", "effort"))
        self._has_rows, self._has_loops = bool(rows), len(rows) > len(couplings.dependent)
        ages = round(values.wrench_max_age / NANOSECOND), round(values.rewind / NANOSECOND)
        self.queue = WrenchQueue(self.scene.wrenches, *ages)
        self._violation = np.zeros(len(couplings.dependent))
        self._power: PowerAnswer | None = None

    def make_solver(self, values: Any) -> SampleSolver:
        """The solver that the parameters ask for.

        Raises:
            SceneError: Unknown forces of contacts are asked for, and there are none.
        """
        if values.stance == "none":
            if values.phase_topic:
                raise SceneError("phase_topic goes with stance: minimum-norm")
            return self.scene.inverse_dynamics()
        contacts = self.scene.unmeasured_contacts
        if not contacts:
            raise SceneError(
                f"{self.scene.name}: stance {values.stance}: no rigid contact without a wrench; "
                "accepted: none"
            )
        near = Nearness(values.stance_gap, values.stance_speed)
        return self.scene.inverse_dynamics(contacts=contacts, near=near)

    def take_phase(self, name: str) -> None:
        """Contacts of a phase are on the ground from now on.

        Raises:
            MessageError: The scene has no such phase.
        """
        phases, loops = self.scene.phases, self._solver
        if name not in phases:
            known = ", ".join(phases) or "none"
            raise MessageError(f"phase '{name}' is none of the scene; it has {known}")
        if isinstance(loops, ObservedLoops) and loops.inverse.standing is not None:
            plan = phases[name]
            loops.told = loops.inverse.standing.of(plan.contacts) if plan.held else None

    def with_power(self) -> None:
        """Answer with powers from now on."""
        from mbd_ros.nodes.inverse_dynamics.power import PowerAnswer  # only where asked for

        self._power = PowerAnswer(self.scene, self._solver)

    def reset(self) -> None:
        """Forget the past."""
        self.estimator.reset()
        self.queue.clear()
        if self.whole is not None:
            self.whole.clear()

    def answer(self, x: Observation, wrenches: Sequence[Any]) -> Answer | None:
        """Messages for an observation; None if the torques are not finite.

        Args:
            x: The observation.
            wrenches: One (6,) array for every load of the scene.

        Returns:
            Kept messages.
        """
        torques = self.estimator.solve(x, wrenches)
        if torques is None:
            return None
        position, velocity, effort, at = x.position, x.velocity, torques.tau, self._at
        if at is not None:
            position, velocity = position[at.joint_y], velocity[at.joint_w]
            effort = effort[at.joint_w]
        answer = self._torques.write(x.stamp, position=position, velocity=velocity, effort=effort)
        residuals = self._carried(x.stamp, torques.residual) if self._residuals else []
        power = None if self._power is None else self._power.write(x, torques, wrenches)
        if not self._has_rows:
            return Answer(answer, None, residuals, power)
        self._violation = off = self.estimator.violation(x)
        if self._has_loops:
            off = np.concatenate([off, self._solver.gap[len(off) :]])
        forces = self._forces.write(x.stamp, position=off, effort=torques.multipliers)
        return Answer(answer, forces, residuals, power)

    def _carried(self, stamp: int, residual: Array) -> list[Any]:
        """WrenchStamped of each free body, in axes of its link."""
        rows = zip(
            self._residuals, self.scene.robot.bases, residual.reshape(-1, TWIST), strict=True
        )
        return [write_wrench(msg, stamp, base.frame, row) for msg, base, row in rows]

    def health(self, tolerance: float) -> tuple[int, str]:
        """WARN where a measured joint is off its coupling or the loops, or a force is in doubt.

        Args:
            tolerance: Accepted distance [rad or m].
        """
        off = [
            f"{name} by {distance:.4g}"
            for name, distance in zip(self._dependent, self._violation, strict=True)
            if abs(distance) > tolerance
        ]
        if off:
            return WARN, f"off their couplings: {', '.join(off)}; the independent joints are used"
        if self._solver.moved > tolerance:
            return WARN, f"off the loops by {self._solver.moved:.4g}; the nearest state is used"
        doubts = self._solver.doubts()
        if doubts:
            return WARN, "; ".join(doubts)
        return OK, "torques published"

    def observe(self, stamp: int, sample: JointSample) -> Observation | SampleStatus:
        """A joint state with its derivatives, or why it cannot be used."""
        present = self.joints.present
        return self.estimator.observe(stamp, sample.position, sample.velocity, present)

    def observe_whole(self, whole: "WholeSample") -> Observation | SampleStatus:
        """A sample of several topics with its derivatives, or why it cannot be used."""
        stamp, position, velocity, _ = whole.joints
        bodies = whole.bodies if self._residuals else None
        return self.estimator.observe(stamp, position, velocity, whole.present, bodies)

    def held(self) -> list[str]:
        """Independent joints that the newest joint state lacked."""
        return [name for name in self._missing if name not in self._dependent]

    def details(self) -> dict[str, str]:
        """Contents and origin of the numbers, for diagnostics."""
        robot, filters = self.scene.robot, self.estimator.differentiator
        reconstructed = [name for name in self._missing if name in self._dependent]
        several = self.whole is not None
        feet = self._feet
        contacts = "" if feet else ", ".join(self.scene.unmeasured_contacts)
        return {
            "gravity": f"included, {robot.model.gravity.linear.tolist()} m/s^2",
            "joints dropped": ", ".join(robot.locked) or "none",
            "inertias in doubt": "; ".join(robot.doubts) or "none",
            "joints reconstructed": ", ".join(reconstructed) or "none",
            "joints held": ", ".join(self.held()) or "none",
            "derivatives": f"causal, delay {filters.delay:.4f} s, "
            f"settled after {filters.settling_time:.4f} s",
            "largest coupling violation": f"{np.abs(self._violation).max(initial=0.0):.6g}",
            "solver tier": tier(self.scene),
            **({"off the loops": f"{self._solver.moved:.6g}"} if self._has_loops else {}),
            **({"contacts of unknown force": contacts} if contacts else {}),
            **({"on the ground": feet} if feet else {}),
            **({"topics not heard": self._unheard} if several else {}),
        }

    @property
    def _feet(self) -> str:
        """Features on the ground in the newest sample; empty where nobody asks."""
        solver = self._solver
        if not isinstance(solver, ObservedLoops) or solver.inverse.standing is None:
            return ""
        standing = solver.inverse.standing
        if solver.motion is None:
            return "none"
        told = solver.told
        stands = standing.at(solver.motion[0]) if told is None else told
        on = zip(standing.features, stands, strict=True)
        return ", ".join(name for name, is_on in on if is_on) or "none"

    @property
    def _missing(self) -> tuple[str, ...]:
        return self.joints.missing if self.whole is None else self.whole.missing

    @property
    def _unheard(self) -> str:
        return ", ".join(sorted(self.whole.unheard)) or "none" if self.whole else ""

    @property
    def _dependent(self) -> tuple[str, ...]:
        return self.scene.couplings.dependent
