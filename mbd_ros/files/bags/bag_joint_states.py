"""Joint states out of bags, as arrays: whole blocks of one layout, else message by message."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.files.bags.bag_blocks import RawBlock, raw_blocks
from mbd_ros.files.bags.bag_types import from_cdr
from mbd_ros.files.bags.bags import CORRUPT
from msg_adapters.errors import MessageError
from msg_adapters.joint_state import JointSample, JointStateReader
from msg_adapters.joint_state_rows import JointStateRowsReader
from msg_adapters.odometry import OdometrySample
from msg_adapters.wrench import WrenchSample

JOINT_STATE = "sensor_msgs/msg/JointState"

Timed = tuple[int, JointSample | WrenchSample | OdometrySample]  # log time [ns] and sample


class Samples(NamedTuple):
    """Messages of a topic that can be used.

    Attributes:
        log_times: [ns], shape (n,).
        stamps: Those of the headers [ns], shape (n,).
        fields: What the messages carry, one a row each.
    """

    log_times: NDArray[np.int64]
    stamps: NDArray[np.int64]
    fields: tuple[Array, ...]


def joint_samples(
    path: Path, joints: Sequence[str], topic: str, needed: Sequence[str], dropped: Counter[str]
) -> Samples:
    """Position, velocity and effort of each JointState that can be used."""
    joint_states = JointStates(path, topic, joints, needed, dropped)
    parts = [joint_states.of(block) for block in raw_blocks(path, topic, JOINT_STATE)]
    joint_states.check([part for part in parts if len(part.stamps)])
    return joined(parts)


def joined(parts: Sequence[Samples]) -> Samples:
    """Samples after each other."""
    if len(parts) == 1:
        return parts[0]
    fields = tuple(np.concatenate(each) for each in zip(*(p.fields for p in parts), strict=True))
    log_times, stamps = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
    return Samples(log_times, stamps, fields)


class JointStates:
    """Samples out of blocks of JointStates: whole blocks of one layout, else message by message.

    Args:
        path: The bag, for messages.
        topic: The topic.
        joints: In the order of the fields.
        needed: Those that must have a finite position.
        dropped: Counts the messages that cannot be used, by reason.

    Attributes:
        seen: Joints of all messages.
    """

    def __init__(
        self,
        path: Path,
        topic: str,
        joints: Sequence[str],
        needed: Sequence[str],
        dropped: Counter[str],
    ) -> None:
        self._where, self._dropped, self._joints = f"{path}: topic {topic}", dropped, joints
        self._needed = needed
        self._reader = JointStateReader(joints)
        self._rows = JointStateRowsReader(self._reader, self._message)
        self._used = [self._reader.names.index(name) for name in needed]
        self.seen = set[str]()

    def of(self, block: RawBlock) -> Samples:
        """Samples of a block."""
        rows = block.rows()
        found = None if rows is None else self._rows.read(rows)
        if found is None or not np.isfinite(found.position[:, self._used]).all():
            return self._one_by_one(block)
        self.seen.update(self._reader.carried)
        return Samples(block.log_times, found[0], found[1:])

    def check(self, used: Sequence[object]) -> None:
        """Raise DataError where a needed joint is in no message, or none can be used."""
        lacking = [name for name in self._needed if name not in self.seen]
        if lacking:
            there = ", ".join(sorted(self.seen)) or "none"
            raise DataError(f"{self._where}: no joint {', '.join(lacking)}; there are: {there}")
        check_any(self._where, used, self._dropped)

    def _message(self, cdr: bytes) -> Any:
        try:
            return from_cdr(cdr, JOINT_STATE)
        except (DataError, *CORRUPT) as error:
            raise DataError(f"{self._where}: unreadable message ({error})") from error

    def _one_by_one(self, block: RawBlock) -> Samples:
        samples: list[tuple[int, JointSample]] = []
        for log_time, cdr in block.messages():
            message = self._message(cdr)
            self.seen.update(message.name)
            try:
                sample = self._reader.read(message)
            except MessageError as error:
                self._dropped[str(error)] += 1
                continue
            bad = [self._joints[i] for i in self._used if not np.isfinite(sample.position[i])]
            if bad:
                self._dropped[f"position of {', '.join(bad)} is missing or not finite"] += 1
            else:
                samples.append((log_time, sample))
        shape = len(samples), len(self._joints)
        fields = (np.array([s[1 + i] for _, s in samples]).reshape(shape) for i in range(3))
        return Samples(*times_of(samples), tuple(fields))


def times_of(samples: Sequence[Timed]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Log times and stamps of samples [ns]."""
    pairs = [(log_time, sample.stamp) for log_time, sample in samples]
    log_times, stamps = np.array(pairs, np.int64).reshape(-1, 2).T
    return log_times, stamps


def check_any(where: str, samples: Sequence[object], dropped: Counter[str]) -> None:
    """Raise DataError where no message of a topic can be used."""
    if not samples:
        raise DataError(f"{where}: no usable message, dropped: {dict(dropped)}")
