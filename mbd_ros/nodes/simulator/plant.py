"""A built scene between commands and the messages that show its motion."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from mbd_ros.core.contracts import without_multiplier
from mbd_ros.core.dynamics.tiers import tier_of
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError
from mbd_ros.files.bag_paths import WORLD, by_member
from mbd_ros.methods.simulation.live_simulation import LiveSimulation
from mbd_ros.methods.simulation.safe_command import CommandWatch
from mbd_ros.nodes.shell.commands import command_reader
from mbd_ros.nodes.shell.parameters import ParameterError
from mbd_ros.nodes.shell.serialized import read_load
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.runs.simulation import Tell, build_simulation
from msg_adapters.errors import MessageError, listed
from msg_adapters.joint_state_cdr import JointStateCdrWriter
from msg_adapters.joint_trajectory import JointMotionWriter
from msg_adapters.multi_array import MultiArrayCdrWriter
from msg_adapters.time import NANOSECONDS
from msg_adapters.wrench import read_wrench

EVERY = "*"  # stands for all links that move
_PREFIX = "pushed_"


class Plant:
    """Scene and simulation of a configured node `simulator`.

    Args:
        description: URDF, where the scene takes it from a topic.
        tell: Is told what takes time.

    Attributes:
        scene: The scene, with a load for every link that can be pushed.
        pushes: Which links these are.
        seed: Of the noise of sensors.
        reader: Messages to commands.
        has_actuators: Whether anything can be commanded.
        wrenches: What takes the external loads, by name.
        members: Where the joints of each robot stand in a state, by its name, empty for the only
            robot.
        bodies: Names of the free bodies.
        rows: Names of the constraint rows.
        shown: Names of what parts show besides.

    Raises:
        MbdError: The scene, `joints` or `rate` do not fit.
    """

    def __init__(self, values: Any, description: str | None, tell: Tell | None = None) -> None:
        self.pushes = Pushes(load_scene(values.scene, description), values.pushed_links)
        self.scene = scene = self.pushes.scene
        self.seed = values.seed
        self.has_actuators = bool(scene.commanded)
        self.reader = command_reader(scene, values.joints)
        times = values.command_timeout, values.safe_ramp
        self.wrenches = {name: CommandWatch(*times) for name in scene.wrenches}
        heard = [(scene.wrenches[name].u, watch) for name, watch in self.wrenches.items()]
        watch = CommandWatch(*times)
        solver = {"type": "compiled"} if values.compiled else None
        build = partial(build_simulation, scene, solver=solver, tell=tell)
        self.live = LiveSimulation(
            build, scene.initial, 1.0 / values.rate, watch, scene.safe, heard
        )
        names = [joint.name for joint in scene.robot.joints]
        self.bodies = [base.name for base in scene.robot.bases]
        members = by_member(names, scene.robot.members)
        if not members and not self.bodies:
            members[""] = {}  # a scene where nothing moves says so
        self.members = {
            member: [names.index(name) for name in joint_names.values()]
            for member, joint_names in members.items()
        }
        numbers = [output.name for output in self.live.showing.numbers]
        count = len(self.live.simulation.system.multiplier_rows)
        self.rows = [without_multiplier(name) for name in numbers[:count]]
        self.shown = numbers[count:]
        self._states = [JointStateCdrWriter(list(joint_names)) for joint_names in members.values()]
        self._only = self._states[0] if len(self._states) == 1 else None
        self._forces = JointStateCdrWriter(self.rows, ("effort",))
        self._shown = MultiArrayCdrWriter(len(self.shown), self.shown)
        self._motion = JointMotionWriter(JointTrajectory(), JointTrajectoryPoint(), names)
        self._odometry = []
        if scene.robot.bases:
            from msg_adapters.pose import OdometryCdrWriter  # only where something flies

            self._odometry = [OdometryCdrWriter(WORLD, base.frame) for base in scene.robot.bases]
        self._event_table = None
        if self.live.simulation.guards:
            from mbd_ros.features.simulation.events import event_table  # only with events

            self._event_table = event_table

    @property
    def time(self) -> int:
        """Simulated time [ns]; 1 at the start, as ROS reads 0 as no time at all."""
        return round(self.live.now.t * NANOSECONDS) or 1

    @property
    def silence(self) -> str:
        """Time since which no command acts, and its substitute; empty while one acts."""
        watch = self.live.watch
        if not (self.has_actuators and watch.is_safe):
            return ""
        since = "yet" if watch.last is None else f"for {watch.age:.3g} s"
        return f"no command {since}, instead: {self.scene.safe}"

    def hear(self, name: str, msg: Any) -> None:
        """Take a WrenchStamped of an external load; MessageError as that of `read_load`."""
        self.wrenches[name].take(read_load(msg, self.scene.wrenches[name]).wrench)

    @property
    def loads(self) -> dict[str, Callable[[Any], None]]:
        """Topic -> what takes its WrenchStamped."""
        found = {self.scene.wrenches[n].heard_on: partial(self.hear, n) for n in self.heard}
        return found | ({"~/push": self._push} if self.pushes.loads else {})

    def _push(self, msg: Any) -> None:
        name, wrench = self.pushes.read(msg)
        self.wrenches[name].take(wrench)

    @property
    def heard(self) -> dict[str, CommandWatch]:
        """Receivers of the external loads of the scene, by name."""
        return {n: one for n, one in self.wrenches.items() if n not in self.pushes.loads}

    @property
    def lost_wrenches(self) -> list[str]:
        """A text for every external load that is no longer heard."""
        return [
            f"no wrench '{name}' for {watch.age:.3g} s, instead: none"
            for name, watch in self.heard.items()
            if watch.last is not None and watch.is_safe
        ]

    def joint_states(self, stamp: int) -> list[bytes]:
        """Serialized JointState of the newest state, one for each of `members`."""
        now = self.live.now
        position, velocity, effort = now.position, now.velocity, now.effort
        if self._only is not None:
            return [self._only.write(stamp, position=position, velocity=velocity, effort=effort)]
        return [
            writer.write(stamp, position=position[at], velocity=velocity[at], effort=effort[at])
            for writer, at in zip(self._states, self.members.values(), strict=True)
        ]

    def odometry(self, stamp: int) -> list[bytes]:
        """Serialized Odometry of the newest state, one for each of `bodies`."""
        now = self.live.now
        rows = zip(self._odometry, now.poses, now.twists, strict=True)
        return [writer.write(stamp, pose, twist) for writer, pose, twist in rows]

    def constraint_forces(self, stamp: int) -> bytes:
        """Serialized JointState with the multipliers."""
        return self._forces.write(stamp, effort=self.live.now.shown[: len(self.rows)])

    def outputs(self) -> bytes:
        """Serialized Float64MultiArray of what parts show besides, with names as labels."""
        return self._shown.write(self.live.now.shown[len(self.rows) :].tolist())

    def events(self) -> list[bytes]:
        """Serialized Float64MultiArray of each event of the last tick, given once."""
        simulation, events = self.live.simulation, self.live.events
        if not events or self._event_table is None:
            return []
        self.live.events = ()
        table = self._event_table(simulation, events)
        writer = MultiArrayCdrWriter(len(table), list(table))
        return [writer.write(row.tolist()) for row in np.column_stack(list(table.values()))]

    def motion(self, stamp: int) -> Any:
        """JointTrajectory whose point is the newest state with accelerations."""
        now = self.live.now
        return self._motion.write(stamp, now.position, now.velocity, now.acceleration, now.effort)

    def details(self) -> dict[str, str]:
        """Contents and origin of the motion, for diagnostics."""
        robot, live, watch = self.scene.robot, self.live, self.live.watch
        system, violation = live.simulation.system, live.violation()
        unheard = [name for name, one in self.heard.items() if one.last is None]
        details = {
            "gravity": f"included, {robot.model.gravity.linear.tolist()} m/s^2",
            "joints dropped": ", ".join(robot.locked) or "none",
            "external wrenches not heard": ", ".join(unheard) or "none",
            "solver tier": tier_of(system),
            "simulated time": f"{live.now.t:.9g}",
            "drift of positions": f"{violation.position:.3g}",
            "drift of velocities": f"{violation.velocity:.3g}",
            "commands received": str(watch.received),
            "commands superseded before a tick": str(watch.superseded),
            "age of the last command": "none" if watch.last is None else f"{watch.age:.6g}",
            "share of the safe command": "1" if watch.last is None else f"{watch.weight:.6g}",
            "safe command": str(self.scene.safe),
        }
        if live.phase:
            details["phase"] = live.phase
        if live.simulation.how:
            details["steps"] = live.simulation.how
        if any(block.part.stops for block in system.layout.yielding):
            details["stops passed"] = "; ".join(live.simulation.passed_stops()) or "none"
        if live.showing.cones:
            from mbd_ros.nodes.shell.contact_topics import contact_details  # only with contacts

            details |= contact_details(live)
        if system.bounded is not None:
            s = system.bounded.qp.statistics
            details["QP"] = (
                f"{s.solves} solves, {s.cold} cold, {s.damped} damped, {s.failed} failed"
            )
        return details


class Pushes:
    """Links that can be pushed, and which external load stands for each.

    Links that one joint carries share a load: an idle one costs a call in every evaluation.

    Args:
        scene: The scene, without these loads.
        links: Names of links, or `EVERY`.

    Attributes:
        scene: The scene with them.
        loads: Names of the loads, those of the scene itself left out.

    Raises:
        ParameterError: There is no such link, or nothing can move it.
    """

    def __init__(self, scene: Scene, links: Sequence[str]) -> None:
        self._model = scene.robot.model
        self._frames = {
            link: _frame(scene.robot, link) for link in _pushed_links(scene.robot, links)
        }
        carriers = {int(self._model.frames[at].parentJoint) for at in self._frames.values()}
        self._loads = {joint: f"{_PREFIX}{joint}" for joint in carriers}
        self._first = {
            joint: next(at for at in self._frames.values() if self._joint(at) == joint)
            for joint in carriers
        }
        self.loads = tuple(self._loads.values())
        self.scene = _loaded(scene, self._entries()) if links else scene

    def read(self, msg: Any) -> tuple[str, Array]:
        """The load that a WrenchStamped is for, and the wrench as that load takes it.

        Raises:
            MessageError: No link that can be pushed, or a component that is not finite.
        """
        sample = read_wrench(msg)
        at = self._frames.get(sample.frame_id)
        if at is None:
            known = listed(list(self._frames)) or "none, see parameter pushed_links"
            raise MessageError(f"frame {listed([sample.frame_id])} is no pushed link: {known}")
        joint = self._joint(at)
        first, link = self._model.frames[self._first[joint]], self._model.frames[at]
        there = first.placement.actInv(link.placement)
        return self._loads[joint], there.act(pin.Force(sample.wrench)).vector

    def _joint(self, frame: int) -> int:
        return int(self._model.frames[frame].parentJoint)

    def _entries(self) -> dict[str, Any]:
        frames = self._model.frames
        return {
            self._loads[joint]: {"frame": frames[at].name} for joint, at in self._first.items()
        }


def _frame(robot: Robot, link: str) -> int:
    try:
        at = robot.frame(link)
    except ModelError as error:
        raise ParameterError(f"parameter 'pushed_links': {error}") from error
    if robot.model.frames[at].parentJoint == 0:
        raise ParameterError(f"parameter 'pushed_links': nothing moves the link '{link}'")
    return at


def _pushed_links(robot: Robot, links: Sequence[str]) -> Sequence[str]:
    if EVERY not in links:
        return links
    frames = robot.model.frames
    return [f.name for f in frames if f.type == pin.FrameType.BODY and f.parentJoint > 0]


def _loaded(scene: Scene, entries: Mapping[str, Any]) -> Scene:
    from mbd_ros.scene.variants import with_sections

    given = scene.entries.get("external_wrenches") or {}
    return with_sections(scene, external_wrenches={**given, **entries})
