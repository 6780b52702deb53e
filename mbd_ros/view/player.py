"""Which sample is shown: the slider, or a clock while it plays."""

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.view.controls import Controls


class Player:
    """Time of a motion.

    Args:
        controls: Slider, play, speed and loop.
    """

    def __init__(self, controls: Controls) -> None:
        self._controls = controls
        self._before: float | None = None

    def row(self, clock: float, times: Array) -> int:
        """The sample to show.

        Args:
            clock: A time that only grows [s].
            times: Of the samples [s], shape (n,).
        """
        controls = self._controls
        passed = 0.0 if self._before is None else clock - self._before
        self._before = clock
        now = controls.now
        if controls.plays and passed > 0.0:
            now = advanced(now, passed * controls.speed, float(times[-1]), controls.loops)
            controls.now = now
            if now >= times[-1] and not controls.loops:
                controls.plays = False
        return nearest_row(times, now)


def advanced(now: float, step: float, end: float, loops: bool) -> float:
    """The time after a step [s]: at the end it stays, or begins again at 0."""
    after = now + step
    if after <= end:
        return after
    return after % end if loops and end > 0.0 else end


def nearest_row(times: Array, now: float) -> int:
    """The last sample that is not after a time, to a nanosecond."""
    row = int(np.searchsorted(times, now + 1.0e-9, side="right")) - 1
    return min(max(row, 0), len(times) - 1)
