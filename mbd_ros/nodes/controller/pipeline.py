"""From serialized joint states and references to messages with commands."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.state import NANOSECOND, Array, State
from mbd_ros.errors import SolveError
from mbd_ros.features.control.control_loop import Command, ControlLoop, Guard
from mbd_ros.features.control.loop_watch import ChatterMeter, LoopWatch, LossLimits, rest_responses
from mbd_ros.features.control.reference import ReferenceGenerator, ReferenceMap, Selection
from mbd_ros.features.control.trajectory import ReferenceTrajectory, TargetError
from mbd_ros.methods.control.contract import Reference
from mbd_ros.methods.inverse_dynamics.torque_estimator import JointObserver, Observation
from mbd_ros.methods.projection.state_projection import ObservedState
from mbd_ros.methods.signals.differentiation import SampleStatus
from mbd_ros.nodes.controller.parameters import (
    build_controller,
    check_lengths,
    effort_limits,
    gains,
)
from mbd_ros.nodes.shell.commands import command_order, driven_joints
from mbd_ros.nodes.shell.parameters import tuning
from mbd_ros.nodes.shell.serialized import joint_state
from mbd_ros.scene.reader import load_scene
from msg_adapters.errors import MessageError
from msg_adapters.joint_state import JointSample, JointStateReader
from msg_adapters.joint_state_cdr import JointStateCdrReader, JointStateCdrWriter
from msg_adapters.joint_trajectory import Trajectory
from msg_adapters.multi_array import write_answered, write_multi_array


class ControlPipeline:
    """Scene and loop of a configured controller node.

    Args:
        description: URDF, where the scene takes it from a topic.

    Attributes:
        loop: Reference, control law and guard.
        watch: Whether the loop does what its gains promise.
        observer: Judges joint states.
        joints: Which joints the newest joint state carried.
        reader: Serialized joint states to samples.
        x: The newest state; None before the first.

    Raises:
        MbdError: Scene, joints, limits or gains do not fit.
    """

    def __init__(self, values: Any, description: str | None) -> None:
        self.scene = scene = load_scene(values.scene, description)
        self._controlled = scene.controlled_joints()
        names = self._controlled.names
        check_lengths(values, self._controlled)
        self._loads = Loads(scene.robot.model.nv, (), scene.actuators)
        order = command_order(values.joints, driven_joints(scene.actuators) or names)
        self._order = [names.index(name) for name in order]
        self._observed = ObservedState(self._controlled.system, scene.couplings)
        self.observer = JointObserver(scene.robot, scene.couplings, tuning(values))
        law = build_controller(values, self._controlled)
        rest = rest_responses(self._controlled, scene.initial)
        self.watch = LoopWatch(names, law, rest, self._limits(values))
        self.loop = ControlLoop(
            law,
            ReferenceGenerator(self._controlled),
            Guard(names, effort_limits(values, self._controlled, scene.actuators)),
            scene.safe,
            values.safe_ramp,
            values.timeout,
            ChatterMeter(len(names), values.chatter_cutoff),
            self.watch,
        )
        self._tune(values)
        self.joints = JointStateReader(self.observer.names)
        self._acted = [self.observer.names.index(name) for name in names]
        self.reader = JointStateCdrReader(self.joints, joint_state)
        self._references = References(self.loop.generator, names, scene.couplings)
        self._commands = Float64MultiArray()
        self._state = JointStateCdrWriter(names)
        self._answer = Float64MultiArray(layout=MultiArrayLayout(dim=[MultiArrayDimension()]))
        self.x: State | None = None
        self._epoch: int | None = None
        self._violation = np.zeros(len(scene.couplings.dependent))

    @property
    def names(self) -> tuple[str, ...]:
        """The controlled joints."""
        return self._controlled.names

    def retune(self, values: Any) -> None:
        """New gains, limits and times; nothing changes where one of them is refused."""
        check_lengths(values, self._controlled)
        if gains(values) != self._gains:
            self.loop.replace(build_controller(values, self._controlled))
        if tuning(values) != self._tuning:
            self.observer.tune(tuning(values))
        self._tune(values)

    def _tune(self, values: Any) -> None:
        generator, loop = self.loop.generator, self.loop
        self._tuning = tuning(values)
        self._gains = gains(values)
        generator.ramp, generator.ramp_speed = values.reference_ramp, values.reference_ramp_speed
        generator.timeout = values.reference_timeout
        loop.ramp, loop.longest = values.safe_ramp, values.timeout
        loop.guard.rate = values.effort_rate or math.inf
        self.watch.limits = self._limits(values)

    def _limits(self, values: Any) -> LossLimits:
        speeds = np.array([joint.max_velocity for joint in self._controlled.joints])
        return LossLimits(speeds, values.error_limit or math.inf)

    def forget(self) -> None:
        """Hold the next state that comes."""
        self.observer.reset()
        self.loop.restart()
        self._epoch = None

    def take_over(self, other: ControlPipeline) -> None:
        """Continue without a bump where another pipeline with the same joints was at work."""
        fits = self._controlled.names == other._controlled.names
        if fits and other.x is not None and len(other.x.q) == len(self.scene.initial.q):
            self.x = other.x
            self._epoch = other._epoch
            self.loop.take_over(other.loop)

    def answer(self, stamp: int, sample: JointSample) -> ControlMessages | SampleStatus:
        """Messages for a joint state, or why it cannot be used.

        Raises:
            SolveError: The state does not fit the loops, or the control law has no answer and had
                none.
        """
        observer = self.observer
        before = observer.checkpoint()
        seen = observer.observe(stamp, sample.position, sample.velocity, self.joints.present)
        if not isinstance(seen, Observation):
            return seen
        if self._epoch is None:
            self._epoch = stamp
        try:
            x = self._observed.state(self._seconds(stamp), seen.position, seen.velocity)
        except SolveError:
            observer.restore(before)
            raise
        self.x = x
        off = seen.dependent - self._observed.dependent
        self._violation = np.where(np.isfinite(off), off, 0.0)
        command = self.loop.update(x, sample.effort[self._acted])
        write_answered(self._answer, len(self._order), stamp)
        commands = self._filled(self._answer, command.effort)
        return ControlMessages(commands, self._loop_state(stamp, command))

    def commands(self, effort: Array) -> Any:
        """Kept message with the commands of the actuators for these efforts.

        Raises:
            SolveError: It is not finite.
        """
        return self._filled(self._commands, effort)

    def _filled(self, message: Any, effort: Array) -> Any:
        if self._loads.actuators:
            x = self.x if self.x is not None else self.scene.initial
            effort = self._loads.command(effort, x)
        try:
            return write_multi_array(message, effort[self._order])
        except MessageError as error:
            raise SolveError(f"commands: {error}") from error

    def _loop_state(self, stamp: int, command: Command) -> Any:
        chatter = self.loop.chatter.rms
        return self._state.write(stamp, position=command.error, velocity=command.s, effort=chatter)

    def aim(self, names: tuple[str, ...], sample: JointSample) -> str:
        """Take a reference of one instant, `sample` in the order of `names`; returns a remark.

        Raises:
            TargetError: It is refused.
        """
        return self._references.aim(self._now(), names, sample)

    def follow(self, trajectory: Trajectory) -> str:
        """Take a trajectory; returns a remark.

        Raises:
            TargetError: It is refused.
        """
        plan = self.plan(trajectory)
        self.take(plan)
        return plan.note

    def plan(self, trajectory: Trajectory) -> Plan:
        """Check a trajectory; one without points stops all joints.

        Raises:
            TargetError: It is refused.
        """
        now = self._now()
        if not len(trajectory.times):
            self._references.check(trajectory.names)
            return Plan(None, now, "")
        begin = self._seconds(trajectory.stamp) if trajectory.stamp else now
        return self._references.plan(now, begin, trajectory)

    def take(self, plan: Plan) -> None:
        """Follow a plan from now on."""
        if plan.trajectory is None:
            self.stop()
        else:
            self.loop.generator.take(self._now(), plan.trajectory)

    def stop(self) -> None:
        """Come to rest where the joints are, or where the next joint state finds them."""
        if self.x is not None and not self.loop.is_open:
            self.loop.generator.hold(*self.measured())
        self.loop.generator.kind = "held"

    def measured(self) -> tuple[float, Array, Array]:
        """Newest time [s], positions and velocities of the controlled joints, shape (n,) each.

        Raises:
            TargetError: No joint state yet, or none any more.
        """
        x = self._newest()
        return x.t, self._controlled.positions(x), self._controlled.velocities(x)

    def held_joints(self) -> list[str]:
        """Independent joints that the newest joint state lacked."""
        dependent = self.scene.couplings.dependent
        return [name for name in self.joints.missing if name not in dependent]

    def off_couplings(self, tolerance: float) -> str:
        """Measured joints that are further off their couplings or loops than accepted."""
        dependent = self.scene.couplings.dependent
        pairs = zip(dependent, self._violation, strict=True)
        off = [f"{name} by {by:.4g}" for name, by in pairs if abs(by) > tolerance]
        if self._observed.correction > tolerance:
            off.append(f"loops by {self._observed.correction:.4g}")
        return ", ".join(off)

    def details(self) -> Mapping[str, str]:
        """Contents and origin of the commands, for diagnostics."""
        robot = self.scene.robot
        reconstructed = [n for n in self.joints.missing if n in self.scene.couplings.dependent]
        return {
            "gravity": f"included, {robot.model.gravity.linear.tolist()} m/s^2",
            "joints dropped": ", ".join(robot.locked) or "none",
            "joints reconstructed": ", ".join(reconstructed) or "none",
            "joints held": ", ".join(self.held_joints()) or "none",
            "solver tier": self._controlled.system.tier,
            "distance from couplings": f"{np.abs(self._violation).max(initial=0.0):.6g}",
            "distance from loops": f"{self._observed.correction:.6g}",
            **loop_details(self.loop, self.x.t if self.x is not None else 0.0),
        }

    def _seconds(self, stamp: int) -> float:
        """Time since the first joint state [s]: a float of the epoch is good to 0.2 us only."""
        return (stamp - (self._epoch or 0)) * NANOSECOND

    def _now(self) -> float:
        """Time of the newest joint state [s]: the one in which references are followed."""
        return self._newest().t

    def _newest(self) -> State:
        if self.x is None or self.loop.is_open:
            raise TargetError("reference refused: no joint state yet, or none any more")
        return self.x


class ControlMessages(NamedTuple):
    """Kept messages that answer a joint state: commands, and the state of the loop."""

    commands: Any
    state: Any


class References:
    """Hands references in messages to the reference generator of the controlled joints.

    Args:
        couplings: Of the scene: a reference may name dependent joints.
    """

    def __init__(
        self, generator: ReferenceGenerator, names: Sequence[str], couplings: Couplings
    ) -> None:
        self._generator = generator
        self._map = ReferenceMap(names, couplings)
        self._selections: dict[tuple[tuple[str, ...], bool], Selection] = {}

    def aim(self, now: float, names: tuple[str, ...], sample: JointSample) -> str:
        """Take a reference of one instant, `sample` in the order of `names`; returns a remark.

        Raises:
            TargetError: It is refused.
        """
        selection = self._selection(names, False)
        rates = np.where(np.isfinite(sample.velocity), sample.velocity, 0.0)
        q = selection.positions(sample.position)
        self._generator.aim(now, Reference(q, selection.rates(rates), np.zeros(len(q))))
        return selection.note

    def plan(self, now: float, begin: float, trajectory: Trajectory) -> Plan:
        """The plan for a trajectory with points that begins at `begin` [s].

        Joints that it does not give hold their present reference.

        Raises:
            TargetError: It is refused.
        """
        selection, current = self._selection(trajectory.names, True), self._generator.at(now).q
        is_named, rest = selection.is_given, np.zeros(len(current))
        parts = trajectory.velocity, trajectory.acceleration
        v, a = (
            None if part is None else np.where(is_named, selection.rates(part), rest)
            for part in parts
        )
        q = np.where(is_named, selection.positions(trajectory.position), current)
        trajectory = self._generator.plan(now, begin + trajectory.times, q, v, a)
        return Plan(trajectory, begin, selection.note)

    def check(self, names: tuple[str, ...]) -> None:
        """Refuse joints of a trajectory without points that are not controlled.

        Raises:
            TargetError: Names them.
        """
        if names:
            self._selection(names, True)

    def _selection(self, names: tuple[str, ...], partial: bool) -> Selection:
        key = names, partial
        if key not in self._selections:
            self._selections = {key: self._map.select(names, partial=partial)}
        return self._selections[key]


class Plan(NamedTuple):
    """A trajectory that was checked and is not followed yet.

    Attributes:
        trajectory: For the reference generator; None to stop.
        begin: Time from which the times of its points count [s].
        note: Joints that were mapped or left out, for people.
    """

    trajectory: ReferenceTrajectory | None
    begin: float
    note: str


def loop_details(loop: ControlLoop, t: float) -> dict[str, str]:
    """Diagnostics of a control loop at a time [s]; efforts in N·m or N, one a joint."""
    control, limits, largest = loop.control, [], 0.0
    if control is not None:
        acts = zip(loop.controller.limit_names, control.active, strict=False)
        limits = [name for name, is_active in acts if is_active]
        largest = float(np.abs(control.s).max())
    return {
        "reference": loop.generator.state(t),
        "largest |s|": f"{largest:.6g}",
        "equivalent part": "none" if control is None else _listed(control.equivalent),
        "chatter": _listed(loop.chatter.rms),
        "share of the safe command": f"{loop.weight:.6g}",
        "limits that act": ", ".join(limits) or "none",
        "safe command": str(loop.safe),
        "times gone safe": str(loop.lapses),
        "updates without an answer of the law": str(loop.failures),
        **loop.controller.details(),
        **(_watched(loop.watch) if loop.watch is not None else {}),
    }


def _listed(values: Array) -> str:
    return ", ".join(f"{value:.3g}" if np.isfinite(value) else "none" for value in values)


def _watched(watch: LoopWatch) -> dict[str, str]:
    delay, is_known = watch.delay, watch.tolerable < np.inf
    return {
        "loop delay": "not measured" if delay is None else f"{delay:.6g} s",
        "tolerable loop delay": f"{watch.tolerable:.6g} s" if is_known else "not known",
        "error bounds": _listed(watch.error_bound) if is_known else "not known",
        "times the loop was lost": str(watch.faults),
    }
