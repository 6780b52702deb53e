"""Joint states that wait for the wrenches of their stamp."""

from collections import deque
from collections.abc import Iterator, Mapping
from time import monotonic

from mbd_ros.core.inverse_dynamics.torque_estimator import Observation
from mbd_ros.core.model.wrenches import WrenchBuffer
from mbd_ros.core.state import Array


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
        self._rewind, self._newest = rewind, 0
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
