"""Samples whose parts come on several topics: joint states of each robot, odometry of each body.

Parts of one stamp make a sample. A topic keeps its order, so when a sample is whole, parts that
came before it and still wait have lost their partner.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.files.topics import by_member, joint_state_topic, odometry_topic
from msg_adapters.errors import MessageError
from msg_adapters.joint_state import JointSample, JointStateReader
from msg_adapters.joint_state_cdr import JointStateCdrReader
from msg_adapters.odometry import OdometrySample

MOST = 500  # samples that wait, as many as the transport keeps

Part = JointSample | OdometrySample


class WholeSample(NamedTuple):
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
    """Joint states of one robot.

    Args:
        own: Names on the topic -> names in the scene.
        names: All joints.
        deserialize: JointState of its bytes.
    """

    def __init__(
        self, own: Mapping[str, str], names: Sequence[str], deserialize: Callable[[bytes], Any]
    ) -> None:
        self.reader = JointStateReader(list(own), with_effort=False)
        self.read = JointStateCdrReader(self.reader, deserialize).read
        self.at = [names.index(name) for name in own.values()]
        self.names = dict(own)


class WholeSamples:
    """Puts the parts of samples together.

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
            joint_state_topic(member): _Joints(own, names, deserialize)
            for member, own in by_member(names, members).items()
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

    def add(self, topic: str, stamp: int, part: Part) -> tuple[WholeSample | None, int]:
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
        return self._whole(stamp, self._waiting.pop(stamp)), lost

    def _give_up(self, count: int) -> int:
        """Forget the oldest ones."""
        for stamp in list(self._waiting)[: max(count, 0)]:
            del self._waiting[stamp]
        return max(count, 0)

    def _whole(self, stamp: int, parts: Mapping[str, tuple[Part, Any]]) -> WholeSample:
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
        return WholeSample(sample, self.present, (poses, twists))
