"""Topics of one robot: what they tell, as a sample to draw, and what a page sends.

A page pulls links by wrenches and leads joints by references.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from visualization_msgs.msg import MarkerArray

from mbd_ros.core.contracts import without_multiplier
from mbd_ros.core.dynamics.output_values import Showing
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.kinematics.poses import configuration_of
from mbd_ros.core.model.points import Point
from mbd_ros.core.state import NANOSECOND, Array, State
from mbd_ros.errors import ModelError
from mbd_ros.files.bag_paths import by_member, joint_state_topic, odometry_topic
from mbd_ros.nodes.shell.contact_topics import contacts_of, topic_of
from mbd_ros.nodes.shell.serialized import joint_state, message_of
from mbd_ros.nodes.shell.shell import Shell
from mbd_ros.scene.built_scene import Scene
from mbd_ros.view.curves import LiveSample
from mbd_ros.view.frames import Frames
from mbd_ros.view.live_robot import Pulled
from msg_adapters.errors import MessageError
from msg_adapters.joint_state import JointSample, JointStateReader
from msg_adapters.joint_state_cdr import JointStateCdrReader, JointStateCdrWriter
from msg_adapters.markers import Shapes, read_shapes
from msg_adapters.multi_array import values_by_label
from msg_adapters.pose import read_odometry
from msg_adapters.wrench import WrenchSample, read_wrench, write_wrench

NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
_LASTS = 0.5  # s, a wrench without a successor
_FARTHEST = 1.0e6  # rad or m, of a joint that can be drawn
_REFERENCE = "/reference"
_DEPTH = 10
_TIMES = 2  # that a reference is sent
_AGAIN = 1.0  # s in between


class RobotTopics:
    """Hears one robot.

    Args:
        node: The hearing node.
        namespace: Of its topics; empty for that of the node.
        frames: What is drawn of it.

    Attributes:
        q: Configuration, as far as it is known, shape (nq,).
        k: Kinematics at the positions of the newest sample.
        loads: Names of the measured loads.
        age: Since a joint state or pose came [s].
        rate: Joint states or poses a second, in the last second [Hz].
    """

    def __init__(
        self, node: Shell, namespace: str, scene: Scene, frames: Frames, values: Any
    ) -> None:
        robot = scene.robot
        self._robot = robot
        self._couplings = scene.couplings
        self.k = Kinematics(robot)

        def newest(kind: type, topic: str) -> Newest:
            return Newest(node, kind, within(namespace, topic))

        every = [joint.name for joint in robot.joints]
        members = by_member(every, robot.members).items()
        self._joints = [
            _Joints(newest(JointState, joint_state_topic(member)), list(own), places(every, own))
            for member, own in members
        ]
        self._poses = []
        if robot.bases:
            from nav_msgs.msg import Odometry  # only where something flies

            self._poses = [newest(Odometry, odometry_topic(base.name)) for base in robot.bases]
        rows = [without_multiplier(row) for row in frames.rows]
        self._forces = _Joints(newest(JointState, values.constraint_forces), rows, [])
        self._torques = _Joints(newest(JointState, values.torques), every, [])
        self._markers = newest(MarkerArray, values.markers)
        self._measured = MeasuredLoads(scene, frames.showing, values.simulator, newest)
        self.loads = self._measured.names
        self.age = math.inf
        self.rate = 0.0
        self._at_q = np.array([joint.q for joint in robot.joints], dtype=np.intp)
        self._at_v = np.array([joint.v for joint in robot.joints], dtype=np.intp)
        nv, self._internals = robot.model.nv, scene.internals.names
        self._outputs = (
            newest(Float64MultiArray, f"{values.simulator}/outputs") if self._internals else None
        )
        self.q = scene.initial.q.copy()
        self._v = np.zeros(nv)
        self._a = np.zeros(nv)
        self._z = np.full(len(self._internals), np.nan)
        self._lam = np.full(len(rows), np.nan)
        self._effort, self._torque = np.full((2, len(every)), np.nan)
        self._shapes = Shapes(np.zeros((0, 3)), np.zeros((0, 2, 3)))
        self._begin: int | None = None
        self._stamp = 0
        self._looked = perf_counter()
        self._heard = -math.inf

    def sample(self) -> LiveSample | None:
        """Return the newest state; None if no message came since the last call."""
        moved = [self._take_joints(topic) for topic in self._joints]
        moved += [self._take_pose(base, topic) for base, topic in self._bodies()]
        others = [self._take_forces(), self._take_torques(), self._take_markers()]
        others.append(self._take_internals())
        if any(moved):
            self._couplings.expand(self.q[:, None], self._v[:, None], self._a[:, None])
        self.k.refresh(self.q, self._v, Reads.POSITION)
        lam = self._lam
        is_known = np.isfinite(lam).all() and np.isfinite(self._z).all()
        loads = self._measured.at(self.k, bool(is_known))
        if not (any(moved) or any(others) or self._measured.names):
            return None
        time = (self._stamp - (self._begin or 0)) * NANOSECOND
        state = State(time, self.q.copy(), self._v.copy(), self._z)
        return LiveSample(time, state, self._effort, self._torque, self._lam, loads, *self._shapes)

    def measure_rate(self) -> None:
        """Bring `age` and `rate` up to date; to be called about once a second."""
        now = perf_counter()
        topics = [topic.newest for topic in self._joints] + self._poses
        most = max((topic.count for topic in topics), default=0)
        self.rate = most / max(now - self._looked, 1.0e-3)
        self._heard = now if most else self._heard
        for topic in topics:
            topic.count = 0
        self._looked = now
        self.age = now - self._heard

    def _bodies(self) -> Any:
        return zip(self._robot.bases, self._poses, strict=True)

    def _take_joints(self, topic: _Joints) -> bool:
        sample = topic.read()
        if sample is None:
            return False
        known = np.abs(sample.position) < _FARTHEST  # NaN is not
        at = topic.at[known]
        self.q[self._at_q[at]] = sample.position[known]
        self._v[self._at_v[at]] = np.nan_to_num(sample.velocity[known], posinf=0.0, neginf=0.0)
        self._effort[at] = np.where(np.isfinite(sample.effort), sample.effort, np.nan)[known]
        self._note(sample.stamp)
        return True

    def _take_pose(self, base: Any, topic: Newest) -> bool:
        sample = topic.message(lambda msg: read_odometry(msg, base.frame))
        if sample is None or not (np.abs(sample.pose) < _FARTHEST).all():
            return False
        self.q[base.q] = configuration_of(self._robot, sample.pose)
        self._v[base.v] = np.nan_to_num(sample.twist)
        self._note(sample.stamp)
        return True

    def _take_forces(self) -> bool:
        sample = self._forces.read()
        if sample is not None:
            self._lam = sample.effort.copy()
        return sample is not None

    def _take_internals(self) -> bool:
        """Internal states, without which forces of parts that have some are unknown."""
        if self._outputs is None:
            return False
        z = self._outputs.message(lambda msg: values_by_label(msg, self._internals))
        if z is not None:
            self._z = z
        return z is not None

    def _take_torques(self) -> bool:
        sample = self._torques.read()
        if sample is not None:
            self._torque = np.where(np.isfinite(sample.effort), sample.effort, np.nan)
        return sample is not None

    def _take_markers(self) -> bool:
        shapes = self._markers.message(read_shapes)
        if shapes is not None:
            origin = self._robot.origin
            self._shapes = Shapes(shapes.points - origin, shapes.lines - origin)
        return shapes is not None

    def _note(self, stamp: int) -> None:
        """Times count from the first stamp; without stamps they are those of arrival."""
        stamp = stamp or round(perf_counter() / NANOSECOND)
        if self._begin is None or stamp < self._begin:
            self._begin = stamp
        self._stamp = stamp


class Newest:
    """Hears a topic, and gives its newest message once: what comes in between is never read.

    Args:
        node: The hearing node.
        topic: Relative or absolute name.

    Attributes:
        count: Messages since it was set to 0.
    """

    def __init__(self, node: Shell, kind: type, topic: str) -> None:
        self._node = node
        self._kind = kind
        self._topic = topic
        self.count = 0
        self._cdr = b""
        node.subscribe(kind, topic, self._take, NEWEST, raw=True)

    def _take(self, cdr: bytes) -> None:
        self._cdr, self.count = cdr, self.count + 1

    def read(self, read: Callable[[bytes], Any]) -> Any:
        """Return what a function reads in the newest bytes; None if they are bad or not new."""
        cdr, self._cdr = self._cdr, b""
        if not cdr:
            return None
        try:
            return read(cdr)
        except MessageError as error:
            where = self._node.resolve_topic_name(self._topic)
            self._node.drop("malformed", f"{where}: {error}")
            return None

    def message(self, read: Callable[[Any], Any]) -> Any:
        """The same of the newest message."""
        return self.read(lambda cdr: read(message_of(cdr, self._kind)))


def within(namespace: str, topic: str) -> str:
    """A topic of a robot: absolute ones as they are."""
    return topic if topic.startswith("/") or not namespace else f"{namespace}/{topic}"


class _Joints:
    """Joint states of one topic: where its joints stand among those of the robot."""

    def __init__(self, newest: Newest, names: list[str], at: list[int]) -> None:
        self.newest = newest
        self.at = np.array(at, dtype=np.intp)
        self._reader = JointStateCdrReader(JointStateReader(names), joint_state)

    def read(self) -> JointSample | None:
        """The newest sample, if it is new."""
        sample: JointSample | None = self.newest.read(self._reader.read)
        return sample


def places(names: Sequence[str], renamed: Mapping[str, str]) -> list[int]:
    """Where the joints of one topic stand among all."""
    return [names.index(name) for name in renamed.values()]


class MeasuredLoads:
    """Hears all loads of a robot: external wrenches of the scene, and forces of contacts.

    Args:
        showing: What parts of it show.
        simulator: Node whose topics `~/..` are.
        newest: Makes what hears a topic.

    Attributes:
        names: Of the loads.
    """

    def __init__(
        self,
        scene: Scene,
        showing: Showing,
        simulator: str,
        newest: Callable[[type, str], Newest],
    ) -> None:
        self._robot = scene.robot
        self._loads = dict[str, _Load]()
        for name, wrench in scene.wrenches.items():
            topic = wrench.heard_on.replace("~/", f"{simulator}/", 1)
            self._loads[name] = _Load(newest(WrenchStamped, topic), wrench.about)
        for name in contacts_of(showing):
            topic = topic_of(name).replace("~/", f"{simulator}/", 1)
            self._loads[name] = _Load(newest(WrenchStamped, topic), None)
        self.names = tuple(self._loads)
        self._latest: dict[str, tuple[float, Point, Array]] = {}

    def at(self, k: Kinematics, contacts_are_drawn: bool) -> Array:
        """Where loads act, and their forces, shape (n, 2, 3); NaN where they are unknown.

        A load has no place of its own: it is drawn on its axis, next to the point that it is
        given about.

        Args:
            k: Kinematics at positions.
            contacts_are_drawn: Whether arrows of contacts come from elsewhere: no places then.
        """
        now, arrows = perf_counter(), np.full((len(self._loads), 2, 3), np.nan)
        for row, (name, load) in zip(arrows, self._loads.items(), strict=True):
            fresh = load.newest.message(lambda msg, load=load: self._read(msg, load))
            if fresh is not None:
                self._latest[name] = (now, *fresh)
            since, about, wrench = self._latest.get(name, (-np.inf, None, None))
            if about is None or wrench is None or now - since > _LASTS:
                continue
            axes, force, torque = k.rotation(about), wrench[:3], wrench[3:]
            square = float(force @ force)
            beside = np.cross(force, torque) / square if square > 0.0 else np.zeros(3)
            row[1] = axes @ force
            if load.about is not None or not contacts_are_drawn:
                row[0] = k.position(about) + axes @ beside
        return arrows

    def _read(self, msg: Any, load: _Load) -> tuple[Point, Array]:
        sample: WrenchSample = read_wrench(msg)
        if load.about is not None:
            return load.about, sample.wrench
        try:
            return self._robot.point(sample.frame_id), sample.wrench
        except ModelError as error:
            raise MessageError(str(error)) from error


class _Load(NamedTuple):
    """A load that is heard.

    Attributes:
        about: The point that it refers to; None where its message names the link.
    """

    newest: Newest
    about: Point | None


class Leading:
    """Pulls links and leads joints of one robot.

    A link that an external load of the scene acts on is pulled by that load; any other one by
    `~/push` of the simulator.

    Args:
        node: The sending node.
        within: Name of a topic in the namespace of the robot.
        tell: Is told why nothing happens.
    """

    def __init__(
        self,
        node: Shell,
        within: Callable[[str], str],
        scene: Scene,
        values: Any,
        tell: Callable[[str], None],
    ) -> None:
        self._node = node
        self._within = within
        self._tell = tell
        self._robot = scene.robot
        self._values = values
        simulator, points = values.simulator, scene.robot.places.points
        self._push = node.publish_to(WrenchStamped, within(f"{simulator}/push"), _DEPTH)
        self._loads: dict[int, tuple[Publisher, Point, str]] = {}
        for wrench in scene.wrenches.values():
            topic = within(wrench.heard_on.replace("~/", f"{simulator}/", 1))
            publisher = node.publish_to(WrenchStamped, topic, _DEPTH)
            joint = points[wrench.carrier.number].joint
            self._loads[joint] = publisher, wrench.about, wrench.expressed_in
        self._joints = _led(scene)
        self._at = [scene.robot.joint(name).q for name in self._joints]
        self._writer = JointStateCdrWriter(self._joints, ("position",))
        self._reference: Publisher | None = None
        self._posture = np.zeros(0)
        self._left = 0
        self._due = 0.0
        self._last: tuple[Publisher, str] | None = None

    def pull(self, pulled: Pulled, k: Kinematics) -> None:
        """Send the force of the mouse.

        Args:
            k: Kinematics at positions.
        """
        push = self._push, self._robot.point(pulled.link), pulled.link
        publisher, about, frame = self._loads.get(pulled.joint, push)
        if not publisher.get_subscription_count():
            topic = self._node.resolve_topic_name(publisher.topic_name)
            asked = ": start the simulator with pushed_links" if publisher is self._push else ""
            self._tell(f"nobody hears {topic}{asked}")
            return
        axes, lever = k.rotation(about).T, pulled.place - k.position(about)
        force = axes @ pulled.force
        wrench = np.concatenate((force, np.cross(axes @ lever, force)))
        self._send(publisher, frame, wrench)
        self._last = publisher, frame

    def let_go(self) -> None:
        """Send that the force ended, once."""
        if self._last is not None:
            self._send(*self._last, np.zeros(6))
            self._last = None

    def lead(self, q: Array) -> None:
        """Send a configuration, shape (nq,), as reference, once its listener is known."""
        topic = self._command_topic()
        if topic is None:
            return
        if self._reference is None or self._reference.topic_name != topic:
            self._reference = self._node.publish_to(JointState, topic, _DEPTH)
        self._posture = q[self._at]
        self._left = _TIMES
        self._due = 0.0

    def tend(self) -> None:
        """Send what is to be sent now.

        A new writer and its reader get to know each other at different times: the last reference
        is sent again.
        """
        reference, now = self._reference, perf_counter()
        if reference is None or not self._left or now < self._due:
            return
        if not reference.get_subscription_count():
            return
        self._left, self._due = self._left - 1, now + _AGAIN
        stamp = self._node.get_clock().now().nanoseconds
        try:
            reference.publish(self._writer.write(stamp, position=self._posture))
        except MessageError as error:
            self._tell(f"target: {error}")

    def _send(self, publisher: Publisher, frame: str, wrench: Array) -> None:
        stamp = self._node.get_clock().now().nanoseconds
        if not np.isfinite(wrench).all():
            return
        try:
            publisher.publish(write_wrench(WrenchStamped(), stamp, frame, wrench))
        except MessageError as error:
            self._tell(f"pull: {error}")

    def _command_topic(self) -> str | None:
        """The topic of references: that of the parameter, or the only one there is."""
        named = self._values.controller
        if named:
            return str(self._node.resolve_topic_name(self._within(named + _REFERENCE)))
        space = self._node.resolve_topic_name(self._within("x"))[:-1]
        kinds = self._node.get_topic_names_and_types()
        topics = [
            name
            for name, types in kinds
            if "sensor_msgs/msg/JointState" in types
            and name.startswith(space)
            and name.count("/") == space.count("/") + 1
            and name.endswith(_REFERENCE)
            and self._node.get_subscriptions_info_by_topic(name)
        ]
        if len(topics) == 1:
            return topics[0]
        several = f"several hear references, choose by parameter controller: {', '.join(topics)}"
        self._tell(f"target: {several if topics else 'no controller hears references'}")
        return None


def _led(scene: Scene) -> list[str]:
    """Joints that a controller leads: the actuated ones, else all that are independent."""
    actuated = [joint for actuator in scene.actuators for joint in actuator.joints]
    return list(dict.fromkeys(actuated)) or list(scene.couplings.independent)
