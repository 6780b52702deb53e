"""The inputs of a run: u from jump to jump."""

import math

from mbd_ros.core.dynamics.inputs import Sources
from mbd_ros.core.state import Array


class InputCourse:
    """Holds u until its next jump, where a step must end.

    Args:
        sources: What gives u.
        begin: Start of the run [s].
        last: Its end [s].
        dt: Interval of the outputs [s]: jumps that fall on an output are moved there.
        slack: Times that are as near as this are the same [s].

    Attributes:
        u: Inputs from `now` on; None without sources.
        now: When u jumped last, or the start of the run [s].
        end: Time that the next step must not pass [s]; inf without a jump to come.
    """

    def __init__(
        self, sources: Sources, begin: float, last: float, dt: float, slack: float
    ) -> None:
        self._sources, self._begin, self._dt, self._slack = sources, begin, dt, slack
        self._jumps = sources.jumps(begin, last)
        self._next = next(self._jumps, math.inf)
        self.u: Array | None = None
        self._hold(begin)

    def reach(self, t: float) -> None:
        """Hold what is valid from a time [s] on, where a step ended."""
        if t >= self.end:
            self._hold(self.end)

    def _hold(self, now: float) -> None:
        jump = self.now = now
        while self._next <= now + self._slack:
            jump = max(jump, self._next)
            self._next = next(self._jumps, math.inf)
        self.u = self._sources.held(jump)
        self.end = self._on_output(self._next) if self._next < math.inf else math.inf

    def _on_output(self, jump: float) -> float:
        output = self._begin + round((jump - self._begin) / self._dt) * self._dt
        return output if abs(output - jump) <= self._slack else jump
