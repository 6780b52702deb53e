"""The motion of a bag piece by piece, in memory that does not grow with the recording."""

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from mbd_ros.core.state import Motion
from mbd_ros.errors import DataError
from mbd_ros.files.bags.bag_blocks import raw_blocks
from mbd_ros.files.bags.bag_joint_states import JOINT_STATE, JointStates, Samples, joined

_LEAST = 16_384  # messages of a piece, but of the last


class WholeNeededError(DataError):
    """A recording that can be read as a whole only."""


class MotionBlocks:
    """Pieces of the motion of a bag; together they are what `read_motion` gives.

    Args:
        path: The bag.
        topic: JointState topic.
        joints: Names, in the order of the columns.
        needed: Those that must have a finite position.

    Attributes:
        dropped: Messages left out, counted by reason; complete after the last piece.
    """

    def __init__(
        self, path: Path, topic: str, joints: Sequence[str], needed: Sequence[str]
    ) -> None:
        self._path, self._topic = path, topic
        self._joints, self._needed = tuple(joints), tuple(needed)
        self.dropped = Counter[str]()

    def __iter__(self) -> Iterator[Motion]:
        """The pieces.

        Raises:
            DataError: As `read_motion`.
            WholeNeededError: A stamp is 0, so that those of the log count from the beginning on.
        """
        self.dropped.clear()
        states = JointStates(self._path, self._topic, self._joints, self._needed, self.dropped)
        newest, old, used = np.iinfo(np.int64).min, 0, []
        for samples in self._pieces(states):
            if not samples.stamps.all():
                raise WholeNeededError(f"{self._path}: topic {self._topic}: a stamp is 0")
            before = np.maximum.accumulate(np.r_[newest, samples.stamps[:-1]])
            is_new = samples.stamps > before
            old += int((~is_new).sum())
            newest = max(before[-1], samples.stamps[-1])
            if is_new.any():
                used = [newest]
                yield self._motion(samples, slice(None) if is_new.all() else is_new)
        states.check(used)
        if old:
            self.dropped["stamp is not newer than all before"] += old

    def _pieces(self, states: JointStates) -> Iterator[Samples]:
        waiting: list[Samples] = []
        for block in raw_blocks(self._path, self._topic, JOINT_STATE):
            samples = states.of(block)
            if len(samples.stamps):
                waiting.append(samples)
            if sum(len(one.stamps) for one in waiting) >= _LEAST:
                yield joined(waiting)
                waiting = []
        if waiting:
            yield joined(waiting)

    def _motion(self, samples: Samples, rows: slice | np.ndarray) -> Motion:
        fields = (without_infinite(field[rows]) for field in samples.fields)
        position, velocity, effort = fields
        return Motion(self._joints, samples.stamps[rows], position, velocity, effort=effort)


def without_infinite(values: np.ndarray) -> np.ndarray:
    """Values whose infinite ones are absent."""
    if np.isinf(values).any():
        values = np.where(np.isinf(values), np.nan, values)
    return values
