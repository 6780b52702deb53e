"""From serialized joint states and wrenches to messages with the torques that explain them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from time import monotonic
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from geometry_msgs.msg import WrenchStamped
from numpy.typing import NDArray

from mbd_ros.core.kinematics.poses import TWIST
from mbd_ros.core.loads.external_loads import WrenchBuffer
from mbd_ros.core.model.couplings import IndependentCoordinates
from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import SceneError
from mbd_ros.files.bag_paths import by_member, joint_state_topic, odometry_topic
from mbd_ros.methods.inverse_dynamics.closed_loop import ObservedLoops
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import SampleSolver, Torques
from mbd_ros.methods.inverse_dynamics.stance import StanceThresholds
from mbd_ros.methods.inverse_dynamics.torque_estimator import Observation, TorqueEstimator
from mbd_ros.methods.signals.differentiation import SampleStatus
from mbd_ros.nodes.shell.parameters import tuning
from mbd_ros.nodes.shell.serialized import joint_state
from mbd_ros.scene.describe.scene_summary import inverse_tier
from mbd_ros.scene.reader import load_scene
from msg_adapters.diagnostics import OK, WARN
from msg_adapters.errors import MessageError
from msg_adapters.joint_state import JointSample, JointStateReader
from msg_adapters.joint_state_cdr import JointStateCdrReader, JointStateCdrWriter
from msg_adapters.multi_array import MultiArrayCdrWriter
from msg_adapters.pose import OdometrySample
from msg_adapters.wrench import write_wrench

if TYPE_CHECKING:
    from mbd_ros.methods.inverse_dynamics.power import ObservedPower

MOST = 500  # samples that wait, as many as the transport keeps
Part = JointSample | OdometrySample


class Pipeline:
    """Scene and estimator of a configured node `inverse_dynamics`.

    Args:
        description: URDF, where the scene takes it from a topic.

    Attributes:
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
        self.assembler: SampleAssembler | None = None
        if bodies or robot.members:
            names = self.estimator.names
            self.assembler = SampleAssembler(names, robot.members, bodies, joint_state)
        self._at = IndependentCoordinates(robot, couplings) if bodies else None
        self._residuals = [WrenchStamped() for _ in bodies]
        self._torques = JointStateCdrWriter(couplings.independent)
        rows = self._solver.rows
        self._forces = JointStateCdrWriter(rows, ("position", "effort"))
        self._has_rows = bool(rows)
        self._has_loops = len(rows) > len(couplings.dependent)
        ages = round(values.wrench_max_age / NANOSECOND), round(values.rewind / NANOSECOND)
        self.queue = WrenchQueue(self.scene.wrenches, *ages)
        self._violation = np.zeros(len(couplings.dependent))
        self._power: ObservedPower | None = None

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
        thresholds = StanceThresholds(values.stance_gap, values.stance_speed)
        return self.scene.inverse_dynamics(contacts=contacts, thresholds=thresholds)

    def take_phase(self, name: str) -> None:
        """Contacts of a phase are on the ground from now on.

        Raises:
            MessageError: The scene has no such phase.
        """
        phases, loops = self.scene.phases, self._solver
        if name not in phases:
            known = ", ".join(phases) or "none"
            raise MessageError(f"phase '{name}' is none of the scene; it has {known}")
        if isinstance(loops, ObservedLoops) and loops.inverse.stance is not None:
            plan = phases[name]
            stance = loops.inverse.stance.select(plan.contacts) if plan.keeps_closed else None
            loops.prescribed_stance = stance

    def with_power(self) -> None:
        """Answer with powers from now on."""
        scene = self.scene
        from mbd_ros.methods.inverse_dynamics.power import ObservedPower  # only on request

        self._power = ObservedPower(
            scene.robot, self._solver, scene.wrenches, scene.forces_without_input
        )
        names = [output.name for output in self._power.outputs]
        self._power_writer = MultiArrayCdrWriter(len(names), names)

    def reset(self) -> None:
        """Forget the past."""
        self.estimator.reset()
        self.queue.clear()
        if self.assembler is not None:
            self.assembler.clear()

    def answer(self, x: Observation, wrenches: Sequence[Any]) -> Answer | None:
        """Messages for an observation; None if the torques are not finite.

        Args:
            x: Motion of one stamp.
            wrenches: One (6,) array for every load of the scene.
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
        power = self._powers(x, torques, wrenches)
        if not self._has_rows:
            return Answer(answer, None, residuals, power)
        self._violation = off = self.estimator.violation(x)
        if self._has_loops:
            off = np.concatenate([off, self._solver.gap[len(off) :]])
        forces = self._forces.write(x.stamp, position=off, effort=torques.multipliers)
        return Answer(answer, forces, residuals, power)

    def _powers(self, x: Observation, torques: Torques, wrenches: Sequence[Any]) -> bytes | None:
        """Float64MultiArray whose labels are names of powers; None where nobody asked."""
        if self._power is None:
            return None
        values = self._power.values(x.position, x.velocity, x.acceleration, torques, wrenches)
        return self._power_writer.write(values.tolist())

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
        if self._solver.correction > tolerance:
            correction = self._solver.correction
            return WARN, f"off the loops by {correction:.4g}; the nearest state is used"
        doubts = self._solver.doubts()
        if doubts:
            return WARN, "; ".join(doubts)
        return OK, "torques published"

    def observe(self, stamp: int, sample: JointSample) -> Observation | SampleStatus:
        """A joint state with its derivatives, or why it cannot be used."""
        present = self.joints.present
        return self.estimator.observe(stamp, sample.position, sample.velocity, present)

    def observe_assembled(self, sample: AssembledSample) -> Observation | SampleStatus:
        """A sample of several topics with its derivatives, or why it cannot be used."""
        stamp, position, velocity, _ = sample.joints
        bodies = sample.bodies if self._residuals else None
        return self.estimator.observe(stamp, position, velocity, sample.present, bodies)

    def held_joints(self) -> list[str]:
        """Independent joints that the newest joint state lacked."""
        return [name for name in self._missing if name not in self._dependent]

    def details(self) -> dict[str, str]:
        """Contents and origin of the numbers, for diagnostics."""
        robot, filters = self.scene.robot, self.estimator.differentiator
        reconstructed = [name for name in self._missing if name in self._dependent]
        several = self.assembler is not None
        feet = self._feet
        contacts = "" if feet else ", ".join(self.scene.unmeasured_contacts)
        return {
            "gravity": f"included, {robot.model.gravity.linear.tolist()} m/s^2",
            "joints dropped": ", ".join(robot.locked) or "none",
            "inertias in doubt": "; ".join(robot.inertia_warnings) or "none",
            "joints reconstructed": ", ".join(reconstructed) or "none",
            "joints held": ", ".join(self.held_joints()) or "none",
            "derivatives": f"causal, delay {filters.delay:.4f} s, "
            f"settled after {filters.settling_time:.4f} s",
            "largest coupling violation": f"{np.abs(self._violation).max(initial=0.0):.6g}",
            "solver tier": inverse_tier(self.scene),
            **({"off the loops": f"{self._solver.correction:.6g}"} if self._has_loops else {}),
            **({"contacts of unknown force": contacts} if contacts else {}),
            **({"on the ground": feet} if feet else {}),
            **({"topics not heard": self._unheard} if several else {}),
        }

    @property
    def _feet(self) -> str:
        """Features on the ground in the newest sample; empty where nobody asks."""
        solver = self._solver
        if not isinstance(solver, ObservedLoops) or solver.inverse.stance is None:
            return ""
        standing = solver.inverse.stance
        if solver.motion is None:
            return "none"
        prescribed = solver.prescribed_stance
        stands = standing.detect(solver.motion[0]) if prescribed is None else prescribed
        on = zip(standing.features, stands, strict=True)
        return ", ".join(name for name, is_on in on if is_on) or "none"

    @property
    def _missing(self) -> tuple[str, ...]:
        return self.joints.missing if self.assembler is None else self.assembler.missing

    @property
    def _unheard(self) -> str:
        return ", ".join(sorted(self.assembler.unheard)) or "none" if self.assembler else ""

    @property
    def _dependent(self) -> tuple[str, ...]:
        return self.scene.couplings.dependent


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


class SampleAssembler:
    """Puts samples together: joint states of each robot, and odometry of each free body.

    Parts of one stamp make a sample. A topic keeps its order, so when a sample is whole, parts
    that came before it and still wait have lost their partner.

    Args:
        names: Joints, in the order of a sample.
        members: Names of the robots and bodies in front of those of their joints.
        bodies: Names of the free bodies.
        deserialize: JointState of its bytes.

    Attributes:
        joint_topics: Topics with joint states.
        body_topics: Topics with odometry, in the order of the bodies.
        unheard: Topics that had no message since the last `clear`.
        present: Which joints the newest whole sample carried.
    """

    def __init__(
        self,
        names: Sequence[str],
        members: Collection[str],
        bodies: Sequence[str],
        deserialize: Callable[[bytes], Any],
    ) -> None:
        self._names = tuple(names)
        self._joints = {
            joint_state_topic(member): _Joints(joints, names, deserialize)
            for member, joints in by_member(names, members).items()
        }
        self.joint_topics = tuple(self._joints)
        self.body_topics = tuple(odometry_topic(body) for body in bodies)
        self.present = np.zeros(len(names), dtype=np.bool_)
        self.clear()

    def clear(self) -> None:
        """Forget what waits."""
        self._waiting: dict[int, dict[str, tuple[Part, Any]]] = {}
        self.unheard = {*self.joint_topics, *self.body_topics}

    def read(self, topic: str, cdr: bytes) -> JointSample:
        """Joints of one robot, in the order of its names; MessageError if malformed."""
        return self._joints[topic].read(cdr)

    @property
    def missing(self) -> tuple[str, ...]:
        """Joints that the newest whole sample lacked."""
        pairs = zip(self._names, self.present, strict=True)
        return tuple(name for name, is_there in pairs if not is_there)

    @property
    def extra(self) -> tuple[str, ...]:
        """Joints of the newest messages that were not asked for."""
        return tuple(name for part in self._joints.values() for name in part.reader.extra)

    def add(self, topic: str, stamp: int, part: Part) -> tuple[AssembledSample | None, int]:
        """Take a part.

        Args:
            topic: Where it came.
            stamp: Time [ns].
            part: What was read.

        Returns:
            The sample that it completes, or None, and how many incomplete ones are given up.

        Raises:
            MessageError: It has no stamp.
        """
        self.unheard.discard(topic)
        if not part.stamp:
            raise MessageError("stamp is 0, and parts of a sample are found by their stamps")
        present = self._joints[topic].reader.present if topic in self._joints else None
        parts = self._waiting.setdefault(stamp, {})
        parts[topic] = part, present
        if len(parts) < len(self.joint_topics) + len(self.body_topics):
            return None, self._give_up(len(self._waiting) - MOST)
        lost = self._give_up(list(self._waiting).index(stamp))
        return self._assemble(stamp, self._waiting.pop(stamp)), lost

    def _give_up(self, count: int) -> int:
        """Forget the oldest ones."""
        for stamp in list(self._waiting)[: max(count, 0)]:
            del self._waiting[stamp]
        return max(count, 0)

    def _assemble(self, stamp: int, parts: Mapping[str, tuple[Part, Any]]) -> AssembledSample:
        n = len(self._names)
        position, velocity = np.full(n, np.nan), np.full(n, np.nan)
        present = np.zeros(n, dtype=np.bool_)
        for topic, joints in self._joints.items():
            sample, there = parts[topic]
            position[joints.at], velocity[joints.at] = sample[1:3]
            present[joints.at] = there
        if not np.array_equal(present, self.present):
            self.present = present  # the same array as long as that does not change
        found = [parts[topic][0] for topic in self.body_topics]
        bodies = [part for part in found if isinstance(part, OdometrySample)]
        poses = np.array([body.pose for body in bodies]).reshape(-1, 7)
        twists = np.array([body.twist for body in bodies]).reshape(-1, 6)
        sample = JointSample(stamp, position, velocity, np.full(n, np.nan))
        return AssembledSample(sample, self.present, (poses, twists))


class AssembledSample(NamedTuple):
    """All parts of one stamp.

    Attributes:
        joints: All joints in the order of the names.
        present: Which of them the messages carried.
        bodies: Poses, shape (k, 7), and twists, shape (k, 6), of the free bodies.
    """

    joints: JointSample
    present: NDArray[np.bool_]
    bodies: tuple[Array, Array]


class _Joints:
    """Joint states of one robot; `own` maps names on its topic to names in the scene."""

    def __init__(
        self, joints: Mapping[str, str], names: Sequence[str], deserialize: Callable[[bytes], Any]
    ) -> None:
        self.reader = JointStateReader(list(joints), with_effort=False)
        self.read = JointStateCdrReader(self.reader, deserialize).read
        self.at = [names.index(name) for name in joints.values()]
        self.names = dict(joints)


class WrenchQueue:
    """Pairs observations with wrenches, in the order of the observations.

    Args:
        max_age: How long the newest wrench stands for later observations [ns].
        rewind: A stamp older than the last by more than this is a new beginning [ns].
        names: Wrenches, in the order of the scene.

    Attributes:
        buffers: Newest samples of every wrench, by name.
    """

    def __init__(self, names: Mapping[str, object], max_age: int, rewind: int) -> None:
        self.buffers = {name: WrenchBuffer(max_age, rewind) for name in names}
        self._rewind = rewind
        self._newest = 0
        self._waiting: deque[tuple[float, Observation]] = deque()

    def clear(self) -> None:
        """Forget all wrenches and observations."""
        self._waiting.clear()
        self._newest = 0
        for buffer in self.buffers.values():
            buffer.clear()

    def add(self, x: Observation, wait: float) -> None:
        """Let an observation wait for at most `wait` [s]."""
        if x.stamp < self._newest:
            self._forget_after(x.stamp)
        self._newest = x.stamp
        self._waiting.append((monotonic() + wait, x))

    def take(self) -> Iterator[tuple[Observation, dict[str, Array | None]]]:
        """Observations whose wrenches are there, or were waited for long enough.

        Yields:
            The observation and every wrench [N, N·m], None where no sample is near enough.
        """
        while self._waiting:
            due, x = self._waiting[0]
            complete = all(buffer.covers(x.stamp) for buffer in self.buffers.values())
            if not complete and monotonic() < due:
                return
            self._waiting.popleft()
            yield x, {name: buffer.at(x.stamp) for name, buffer in self.buffers.items()}

    def _forget_after(self, stamp: int) -> None:
        """Joint states began anew at `stamp`: drop wrenches of the time before."""
        for buffer in self.buffers.values():
            if buffer.covers(stamp + self._rewind // 2):
                buffer.clear()
