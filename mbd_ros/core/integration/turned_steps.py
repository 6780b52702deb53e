"""Steps of any method with velocities of free bodies in the axes of the world."""

import math
from typing import Any

from mbd_ros.core.dynamics.world_axes import InWorldAxes
from mbd_ros.core.integration.stepping import Stepper
from mbd_ros.core.memory import Memory, copied, recognised
from mbd_ros.core.state import Array, Mode, State


class TurnedSteps(Stepper):
    """Steps whose states have velocities in the axes of the bodies, as all others.

    Args:
        world: The system in the axes of the world.
        inner: Steps of that.
    """

    def __init__(self, world: InWorldAxes, inner: Stepper) -> None:
        self._world, self._inner = world, inner
        self.is_fixed = inner.is_fixed
        self._last: tuple[State | None, State | None] = (None, None)  # as given, and turned

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by one step of the method; x itself at or after `end`."""
        before = self._turned(x)
        after = self._inner.step(before, u, end)
        return x if after is before else self._kept(after)

    def settle(self, x: State, u: Array | None) -> State:
        """The first state with the mode in which it goes on."""
        return self._kept(self._inner.settle(self._turned(x), u))

    def restart(self) -> None:
        """Forget everything that was kept from earlier steps."""
        self._inner.restart()
        self._last = (None, None)

    def memory(self) -> Memory:
        """What the method remembers, and the last state."""
        return {"last": copied(self._last), "inner": self._inner.memory()}

    def recall(self, memory: Memory, x: State) -> None:
        """As `Stepper.recall`."""
        self._last = recognised(copied(memory["last"]), x)
        self._inner.recall(memory["inner"], self._turned(x))

    def again(self, h: float, t: float) -> State:
        """The last step taken again with another length."""
        return self._kept(self._inner.again(h, t))

    def follow(self, accelerate: Any, mode: Mode = ()) -> None:
        """Follow other accelerations from the next step on."""
        self._inner.follow(self._world.adapted(accelerate), mode)

    def continue_from(self, x: State) -> None:
        """Go on from a state that stabilization has made of the last one, history kept."""
        self._last = x, self._world.turned(x)
        self._inner.continue_from(self._last[1])

    def interpolate(self, t: float) -> State:
        """State inside the last step, by the dense output of the method."""
        return self._world.turned_back(self._inner.interpolate(t))

    def _turned(self, x: State) -> State:
        last, turned = self._last
        if x is not last or turned is None:
            turned = self._world.turned(x)
            self._last = x, turned
        return turned

    def _kept(self, after: State) -> State:
        x = self._world.turned_back(after)
        self._last = x, after
        return x
