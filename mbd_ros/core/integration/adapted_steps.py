"""Steps of any method whose own states have another form than those of the system."""

import math
from typing import Any

from mbd_ros.core.integration.stepping import Stepper
from mbd_ros.core.memory import Memory, copied, recognised
from mbd_ros.core.state import Array, Mode, State


class AdaptedSteps(Stepper):
    """Steps of a method that knows states in a form of its own.

    Args:
        form: What adapts accelerators to the states that the method knows.
        inner: Steps of these.
    """

    def __init__(self, form: Any, inner: Stepper) -> None:
        self._form, self._inner = form, inner
        self.is_fixed = inner.is_fixed
        self._last: tuple[State | None, State | None] = (None, None)  # as given, and adapted

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by one step of the method; x itself at or after `end`."""
        before = self._known(x)
        after = self._inner.step(before, u, end)
        return x if after is before else self._kept(after)

    def settle(self, x: State, u: Array | None) -> State:
        """The first state with the mode in which it goes on."""
        return self._kept(self._inner.settle(self._known(x), u))

    def restart(self) -> None:
        """Forget everything that was kept from earlier steps."""
        self._inner.restart()
        self._last = (None, None)

    def memory(self) -> Memory:
        """What the method remembers, and the last state in both forms."""
        return {"last": copied(self._last), "inner": self._inner.memory()}

    def recall(self, memory: Memory, x: State) -> None:
        """As `Stepper.recall`."""
        self._last = recognised(copied(memory["last"]), x)
        self._inner.recall(memory["inner"], self._known(x))

    def again(self, h: float, t: float) -> State:
        """The last step taken again with another length."""
        return self._kept(self._inner.again(h, t))

    def follow(self, accelerate: Any, mode: Mode = ()) -> None:
        """Follow other accelerations from the next step on."""
        self._inner.follow(self._form.adapted(accelerate), mode)

    def continue_from(self, x: State) -> None:
        """Go on from a state that stabilization has made of the last one, history kept."""
        self._last = x, self._moved(x)
        self._inner.continue_from(self._last[1])

    @property
    def pace(self) -> tuple[float, ...]:
        """As `Stepper.pace`."""
        return self._inner.pace

    @pace.setter
    def pace(self, pace: tuple[float, ...]) -> None:
        self._inner.pace = pace

    def interpolate(self, t: float) -> State:
        """State inside the last step, by the dense output of the method."""
        return self._given(self._inner.interpolate(t))

    def _adapted(self, x: State) -> State:
        """A state in the form of the method."""
        raise NotImplementedError

    def _given(self, after: State) -> State:
        """A state of the method in the form of the system."""
        raise NotImplementedError

    def _moved(self, x: State) -> State:
        """A state in the form of the method, near the last one."""
        return self._adapted(x)

    def _known(self, x: State) -> State:
        last, adapted = self._last
        if x is not last or adapted is None:
            adapted = self._adapted(x)
            self._last = x, adapted
        return adapted

    def _kept(self, after: State) -> State:
        x = self._given(after)
        self._last = x, after
        return x
