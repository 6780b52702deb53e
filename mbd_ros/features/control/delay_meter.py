"""The age of the command that a measured state answers."""

import math

import numpy as np

from mbd_ros.core.state import Array

_CAPACITY = 512  # commands
_HORIZON = 0.2  # [s] that a command may be old
_MEMORY = 0.005  # s, of misfits, within
_KEPT = (0.5, 0.95)  # of them, an update
_SURE = 0.1  # share of the misfits about the best one that this may have
_ASIDE = 3  # so many commands before and after it, and a quarter of its age
_FEWEST = 3  # updates of a misfit that counts


class DelayMeter:
    """Finds the sent command whose echo is the measured effort.

    A drive tells with each state the effort that acted until then, exactly (a simulator) or with
    noise. For every age of a command the squared difference between echo and command is summed
    and forgotten exponentially; the age with the least sum is that of the loop, where that sum is
    far below those of ages about it: efforts that do not change tell no age, and a drive that
    reports no effort, or another one, tells nothing. The transport need not help.

    Args:
        size: Number of joints.

    Attributes:
        delay: Age of the command less one period, for which it acts [s]; None while not known.

    Source: the sum is the average square difference function of time delay estimation;
        G. Jacovitti, G. Scarano, IEEE Trans. Signal Process. 41, 1993, 525-533.
    """

    def __init__(self, size: int) -> None:
        self._sent = np.zeros((2 * _CAPACITY, size))  # from `first` on, newest first
        self._times = np.zeros(2 * _CAPACITY)
        self._misfits = np.zeros(_CAPACITY)
        self.reset()

    def reset(self) -> None:
        """Forget what was sent."""
        self.delay: float | None = None
        self._count, self._first = 0, _CAPACITY

    def send(self, t: float, effort: Array) -> None:
        """Note the command that answers the state of time t [s]; effort of shape (n,)."""
        if self._first == 0:
            self._first = _CAPACITY
            self._sent[_CAPACITY:] = self._sent[:_CAPACITY]
            self._times[_CAPACITY:] = self._times[:_CAPACITY]
        self._first -= 1
        self._sent[self._first], self._times[self._first] = effort, t
        if self._count < _CAPACITY:
            self._misfits[self._count] = 0.0
            self._count += 1

    def measure(self, t: float, effort: Array, period: float, oldest: float = _HORIZON) -> None:
        """Compare the effort that acted until a time with the commands that were sent before.

        Args:
            t: Of the state, later than that of the last command [s].
            effort: [N·m or N], shape (n,); nothing is learned from one that is not finite.
            period: Time for which a command acts [s].
            oldest: Age up to which commands are compared [s].
        """
        total = float(effort.sum())
        if total - total != 0.0:
            return
        reach = int(min(oldest, _HORIZON) / period) + _ASIDE + _FEWEST
        count, first = min(self._count, reach), self._first
        miss = self._sent[first : first + count] - effort
        misfits = self._misfits[:count]
        misfits *= min(max(math.exp(-period / _MEMORY), _KEPT[0]), _KEPT[1])
        misfits += np.einsum("ij,ij->i", miss, miss)
        best = self._best(misfits[: count - _FEWEST]) if count > _FEWEST else None
        if best is not None:
            self.delay = max(t - float(self._times[first + best]) - period, 0.0)

    def _best(self, misfits: Array) -> int | None:
        """Where the least misfit is, if it stands out: far below those of ages about it."""
        best = int(misfits.argmin())
        aside = _ASIDE + best // 4
        if best + aside >= len(misfits):
            return None
        around = min(misfits[best + aside], misfits[best - aside] if best >= aside else np.inf)
        return best if misfits[best] <= _SURE * around and around > 0.0 else None
