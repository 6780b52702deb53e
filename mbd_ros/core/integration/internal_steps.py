"""Steps of any method with internal states."""

from typing import Any

from mbd_ros.core.dynamics.extended import Extended
from mbd_ros.core.integration.adapted_steps import AdaptedSteps
from mbd_ros.core.integration.stepping import Integrator
from mbd_ros.core.state import State


class InternalSteps(AdaptedSteps):
    """Steps in which internal states stand beside velocities, see `Extended`.

    They are inside their bounds after every step.

    Args:
        method: The method.
        system: The system, with internal states.
        dt: Length of a step, or first guess [s].
    """

    def __init__(self, method: Integrator, system: Any, dt: float) -> None:
        self._whole, self._nq = Extended(system), int(system.nq)
        super().__init__(self._whole, method.prepare(self._whole, dt))
        followed = self._inner.system
        self.system = None if followed is None else followed.system

    def again(self, h: float, t: float) -> State:
        """The last step taken again with another length."""
        after = self._inner.again(h, t)
        x = self._whole.parted(after)
        self._last = x, after
        if _is_beyond(x, after):
            self._last = x, self._moved(x)
        return x

    def _adapted(self, x: State) -> State:
        return self._whole.joined(x)

    def _given(self, after: State) -> State:
        return self._whole.parted(after)

    def _kept(self, after: State) -> State:
        """The state after a step; the method goes on from bounds where it went beyond."""
        x = super()._kept(after)
        if _is_beyond(x, after):
            self.continue_from(x)
        return x

    def _moved(self, x: State) -> State:
        """A state with the integrals of the last one."""
        joined = self._last[1]
        return self._whole.joined(x, None if joined is None else joined.q[self._nq :])


def _is_beyond(x: State, joined: State) -> bool:
    """Whether a step went beyond bounds of internal states."""
    z = joined.v[len(x.v) :]
    return bool(((x.z != z) & (z == z)).any())
