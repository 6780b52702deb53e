"""sensor_msgs/JointState <-> arrays in a fixed joint order."""

from array import array
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_adapters.errors import MessageError, listed
from msg_adapters.time import read_time, write_time


class JointSample(NamedTuple):
    """One JointState in the order of the reader's names; NaN stands for absent.

    Attributes:
        stamp: Header stamp [ns]; 0 where the publisher set none.
        position: [rad or m], shape (n,).
        velocity: [rad/s or m/s], shape (n,).
        effort: [N·m or N], shape (n,).
    """

    stamp: int
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    effort: NDArray[np.float64]


class JointStateReader:
    """Reads messages whose joints may be reordered, missing or additional.

    Args:
        names: The joints asked for.
        with_effort: False leaves the effort unread, as absent.

    Attributes:
        names: The joints asked for, in the order of the arrays.
        present: Which of them the newest message carried, shape (n,) of bool.
        missing: Those that it did not carry.
        extra: Joints of the newest message that were not asked for.
        absent: NaN for every joint, read-only.
    """

    def __init__(self, names: Sequence[str], *, with_effort: bool = True) -> None:
        self.names = tuple(names)
        self.with_effort = with_effort
        self.present = np.zeros(len(names), dtype=np.bool_)
        self.missing: tuple[str, ...] = ()
        self.extra: tuple[str, ...] = ()
        self.absent = np.full(len(names), np.nan)
        self.absent.flags.writeable = False
        self._message_names: list[str] | None = None
        self._in_order = False
        self._columns = np.empty(0, dtype=np.intp)
        self._rows = np.empty(0, dtype=np.intp)

    @property
    def carried(self) -> tuple[str, ...]:
        """Joints of the newest message, in its order."""
        return tuple(self._message_names or ())

    def read(self, msg: Any) -> JointSample:
        """Arrays of one message.

        Args:
            msg: JointState of rclpy, rosbags, or anything with the same fields.

        Returns:
            Arrays in the order of `names`: fresh, read-only, or views of the message, which
            must not be refilled while they are used.

        Raises:
            MessageError: Names empty or repeated, an array neither empty nor as long as them, or
                a stamp that no message can carry back.
        """
        if msg.name != self._message_names:
            self._learn(list(msg.name))
        stamp = read_time(msg.header.stamp)
        return self.arrange(stamp, msg.position, msg.velocity, msg.effort)

    def is_arranged(self, positions: int, velocities: int, efforts: int) -> bool:
        """Whether arrays of these lengths, in the order of the last message, need no arranging.

        Effort is present where it is asked for, else `absent`.
        """
        n = len(self.names)
        read = self._in_order and positions == velocities == n
        return read and efforts in ((n,) if self.with_effort else (0, n))

    def arrange(self, stamp: int, position: Any, velocity: Any, effort: Any) -> JointSample:
        """Arrays in the order of `names`, of a message with the names of the last `read`.

        Args:
            stamp: Header stamp [ns].
            position: Doubles in the order of the message, or nothing.

        Raises:
            MessageError: An array neither empty nor as long as the names.
        """
        return JointSample(
            stamp,
            self.picked(position, "position"),
            self.picked(velocity, "velocity"),
            self.picked(effort, "effort"),
        )

    def _learn(self, names: list[str]) -> None:
        if not names:
            raise MessageError("name is empty")
        index = {name: i for i, name in enumerate(names)}
        if len(index) != len(names):
            repeated = sorted(name for name, count in Counter(names).items() if count > 1)
            raise MessageError(f"name repeats {listed(repeated)}")
        found = [(row, index[name]) for row, name in enumerate(self.names) if name in index]
        self._rows = np.array([row for row, _ in found], dtype=np.intp)
        self._columns = np.array([column for _, column in found], dtype=np.intp)
        self.present = np.array([name in index for name in self.names], dtype=np.bool_)
        self.missing = tuple(name for name in self.names if name not in index)
        self.extra = tuple(name for name in names if name not in self.names)
        self._in_order = tuple(names) == self.names
        self._message_names = names

    def picked(self, values: Any, field: str) -> NDArray[np.float64]:
        """A field in the order of `names`, of messages with the names of the last `read`.

        Args:
            values: Doubles of one message in its order, or nothing; or of many, one a row.
            field: Which it is.

        Raises:
            MessageError: Neither empty nor as long as the names.
        """
        assert self._message_names is not None
        rows, width = np.shape(values)[:-1], np.shape(values)[-1]
        if width not in (0, len(self._message_names)):
            raise MessageError(f"{field} has {width} values for {len(self._message_names)} names")
        if width == 0 or (field == "effort" and not self.with_effort):
            return np.broadcast_to(self.absent, (*rows, len(self.names))) if rows else self.absent
        message_values: NDArray[np.float64] = (
            values if isinstance(values, np.ndarray) else np.frombuffer(values, np.float64)
        )
        if self._in_order:
            return message_values
        picked = np.full((*message_values.shape[:-1], len(self.names)), np.nan)
        picked[..., self._rows] = message_values[..., self._columns]
        return picked


def read_joint_state(msg: Any) -> JointSample:
    """Arrays of one message in its own joint order."""
    return JointStateReader(msg.name).read(msg)


class JointStateWriter:
    """Refills one kept message, so that publishing allocates nothing.

    Args:
        msg: A fresh JointState; it belongs to the writer from now on.
        names: Joint or constraint names, in the order of the arrays.
        fields: Which of position, velocity and effort the message carries.
    """

    def __init__(
        self,
        msg: Any,
        names: Sequence[str],
        fields: Sequence[str] = ("position", "velocity", "effort"),
    ) -> None:
        self.msg = msg
        msg.name = list(names)
        self._views = {}
        for field in fields:
            setattr(msg, field, array("d", bytes(8 * len(names))))
            self._views[field] = np.frombuffer(getattr(msg, field), dtype=np.float64)

    def write(self, stamp: int, **values: Any) -> Any:
        """The kept message with new contents.

        Args:
            stamp: Header stamp [ns].
            **values: One array a field, in the order of the names.

        Returns:
            The same message object at every call.

        Raises:
            MessageError: No message can carry the stamp.
        """
        write_time(self.msg.header.stamp, stamp)
        for field, value in values.items():
            self._views[field][:] = value
        return self.msg


def write_joint_state(msg: Any, stamp: int, names: Sequence[str], **values: Any) -> Any:
    """Fill a fresh JointState; see `JointStateWriter` for a stream of them."""
    return JointStateWriter(msg, names, tuple(values)).write(stamp, **values)
