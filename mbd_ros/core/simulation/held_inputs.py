"""The inputs of a run: u from jump to jump."""

import math

from mbd_ros.core.loads.inputs import Sources
from mbd_ros.core.simulation.sample_times import SampleTimes
from mbd_ros.core.state import Array


class HeldInputs:
    """Holds u until its next jump, where a step must end.

    Args:
        sources: What gives u.
        times: Samples of the run: jumps that fall on one are moved there.
        now: When u jumped last, or the start of the run [s].

    Attributes:
        u: Inputs from `now` on; None without sources.
        now: When u jumped last, or the start of the run [s].
        end: Time that the next step must not pass [s]; inf without a jump to come.
    """

    def __init__(self, sources: Sources, times: SampleTimes, now: float) -> None:
        self._sources, self._times = sources, times
        self._jumps = sources.jumps(now, times.last)
        self._next = next(self._jumps, math.inf)
        self.u: Array | None = None
        self._hold(now)

    def reach(self, t: float) -> None:
        """Hold what is valid from a time [s] on, where a step ended."""
        if t >= self.end:
            self._hold(self.end)

    def _hold(self, now: float) -> None:
        jump = self.now = now
        while self._next <= now + self._times.slack:
            jump = max(jump, self._next)
            self._next = next(self._jumps, math.inf)
        self.u = self._sources.held(jump)
        self.end = self._on_sample(self._next) if self._next < math.inf else math.inf

    def _on_sample(self, jump: float) -> float:
        origin, dt = self._times.origin, self._times.dt
        sample = origin + round((jump - origin) / dt) * dt
        return sample if abs(sample - jump) <= self._times.slack else jump
