"""What the topics of one robot tell of it, as a sample to draw."""

import math
from collections.abc import Mapping, Sequence
from time import perf_counter
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from visualization_msgs.msg import MarkerArray

from mbd_ros.core.kinematics.free_bases import configuration_of
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.names import without_multiplier
from mbd_ros.core.state import NANOSECOND, State
from mbd_ros.files.topics import by_member, joint_state_topic, odometry_topic
from mbd_ros.nodes.shell.serialized import joint_state
from mbd_ros.nodes.shell.shell import Shell
from mbd_ros.nodes.web_view.measured_loads import MeasuredLoads
from mbd_ros.nodes.web_view.newest import Newest
from mbd_ros.scene.built_scene import Scene
from mbd_ros.view.frames import Frames
from mbd_ros.view.live_curves import LiveSample
from msg_adapters.joint_state import JointSample, JointStateReader
from msg_adapters.joint_state_cdr import JointStateCdrReader
from msg_adapters.labelled import read_labelled
from msg_adapters.marker_shapes import Shapes, read_shapes
from msg_adapters.odometry import read_odometry

_FARTHEST = 1.0e6  # rad or m, of a joint that can be drawn


class _Joints:
    """Joint states of one topic: where its joints stand among those of the robot."""

    def __init__(self, newest: Newest, names: list[str], at: list[int]) -> None:
        self.newest, self.at = newest, np.array(at, dtype=np.intp)
        self._reader = JointStateCdrReader(JointStateReader(names), joint_state)

    def read(self) -> JointSample | None:
        """The newest sample, if it is new."""
        sample: JointSample | None = self.newest.read(self._reader.read)
        return sample


class RobotTopics:
    """Hears one robot.

    Args:
        node: The hearing node.
        namespace: Of its topics; empty for that of the node.
        scene: Its scene.
        frames: What is drawn of it.
        values: Parameters of the node.

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
        self._robot, self._couplings, self.k = robot, scene.couplings, Kinematics(robot)

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
        self.loads, self.age, self.rate = self._measured.names, math.inf, 0.0
        self._at_q = np.array([joint.q for joint in robot.joints], dtype=np.intp)
        self._at_v = np.array([joint.v for joint in robot.joints], dtype=np.intp)
        nv, self._internals = robot.model.nv, scene.internals.names
        self._outputs = (
            newest(Float64MultiArray, f"{values.simulator}/outputs") if self._internals else None
        )
        self.q, self._v, self._a = scene.initial.q.copy(), np.zeros(nv), np.zeros(nv)
        self._z, self._lam = np.full(len(self._internals), np.nan), np.full(len(rows), np.nan)
        self._effort, self._torque = np.full((2, len(every)), np.nan)
        self._shapes = Shapes(np.zeros((0, 3)), np.zeros((0, 2, 3)))
        self._begin: int | None = None
        self._stamp, self._looked, self._heard = 0, perf_counter(), -math.inf

    def sample(self) -> LiveSample | None:
        """What is known now; None if no message came since it was asked last."""
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
        self._looked, self.age = now, now - self._heard

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
        z = self._outputs.message(lambda msg: read_labelled(msg, self._internals))
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


def places(names: Sequence[str], own: Mapping[str, str]) -> list[int]:
    """Where the joints of one topic stand among all."""
    return [names.index(name) for name in own.values()]


def within(namespace: str, topic: str) -> str:
    """A topic of a robot: absolute ones as they are."""
    return topic if topic.startswith("/") or not namespace else f"{namespace}/{topic}"
