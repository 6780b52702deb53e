"""Steps of any method with internal states."""

import math
from typing import Any

import numpy as np

from mbd_ros.core.dynamics.extended import Extended
from mbd_ros.core.integration.stepping import Integrator, Stepper
from mbd_ros.core.memory import Memory, copied, recognised
from mbd_ros.core.state import Array, Mode, State


class InternalSteps(Stepper):
    """Steps in which internal states stand beside velocities, see `Extended`.

    They are inside their bounds after every step.

    Args:
        method: The method.
        system: The system, with internal states.
        dt: Length of a step, or first guess [s].
    """

    def __init__(self, method: Integrator, system: Any, dt: float) -> None:
        self._whole, self._nq = Extended(system), int(system.nq)
        self._inner = method.prepare(self._whole, dt)
        self.is_fixed = self._inner.is_fixed
        followed = self._inner.system
        self.system = None if followed is None else followed.system
        self._last: tuple[State | None, State | None] = (None, None)  # as given, and joined

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by one step of the method; x itself at or after `end`."""
        before = self._joined(x)
        after = self._inner.step(before, u, end)
        return x if after is before else self._kept(after)

    def settle(self, x: State, u: Array | None) -> State:
        """The first state with the mode in which it goes on."""
        first = self._inner.settle(self._joined(x), u)
        return self._kept(first)

    def restart(self) -> None:
        """Forget everything that was kept from earlier steps."""
        self._inner.restart()
        self._last = (None, None)

    def memory(self) -> Memory:
        """What the method remembers, and the integrals of internal states."""
        return {"last": copied(self._last), "inner": self._inner.memory()}

    def recall(self, memory: Memory, x: State) -> None:
        """As `Stepper.recall`."""
        self._last = recognised(copied(memory["last"]), x)
        self._inner.recall(memory["inner"], self._joined(x))

    def again(self, h: float, t: float) -> State:
        """The last step taken again with another length."""
        after = self._inner.again(h, t)
        x = self._whole.parted(after)
        self._last = x, after
        if _is_beyond(x, after):
            self._last = x, self._moved(x)
        return x

    def follow(self, accelerate: Any, mode: Mode = ()) -> None:
        """Follow other accelerations and rates from the next step on."""
        self._inner.follow(self._whole.adapted(accelerate), mode)

    def continue_from(self, x: State) -> None:
        """Go on from a state that stabilization has made of the last one, history kept."""
        self._last = x, self._moved(x)
        self._inner.continue_from(self._last[1])

    def interpolate(self, t: float) -> State:
        """State inside the last step, by the dense output of the method."""
        return self._whole.parted(self._inner.interpolate(t))

    def _joined(self, x: State) -> State:
        last, joined = self._last
        if x is not last or joined is None:
            joined = self._whole.joined(x)
            self._last = x, joined
        return joined

    def _kept(self, after: State) -> State:
        """The state after a step; the method goes on from bounds where it went beyond."""
        x = self._whole.parted(after)
        self._last = x, after
        if _is_beyond(x, after):
            self.continue_from(x)
        return x

    def _moved(self, x: State) -> State:
        """A state with the integrals of the last one."""
        joined = self._last[1]
        return self._whole.joined(x, None if joined is None else joined.q[self._nq :])


def _is_beyond(x: State, joined: State) -> bool:
    """Whether a step went beyond bounds of internal states."""
    return not np.array_equal(x.z, joined.v[len(x.v) :], equal_nan=True)
