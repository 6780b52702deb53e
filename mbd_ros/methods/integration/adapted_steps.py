"""Steps of any method whose own states have another form than those of the system."""

from __future__ import annotations

import math
from typing import Any

from mbd_ros.core.dynamics.internal_dynamics import Extended
from mbd_ros.core.dynamics.world_axes import InWorldAxes
from mbd_ros.core.state import Array, Memory, Mode, State, copied, recognised
from mbd_ros.methods.integration.stepping import Integrator, Stepper


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
        return x if after is before else self._store(after)

    def settle(self, x: State, u: Array | None) -> State:
        """Return the first state with the mode in which it goes on."""
        return self._store(self._inner.settle(self._known(x), u))

    def restart(self) -> None:
        """Forget everything that was kept from earlier steps."""
        self._inner.restart()
        self._last = (None, None)

    def checkpoint(self) -> Memory:
        """Return what the method remembers, and the last state in both forms."""
        return {"last": copied(self._last), "inner": self._inner.checkpoint()}

    def restore(self, checkpoint: Memory, x: State) -> None:
        """Go on as after the step at which a checkpoint was taken."""
        self._last = recognised(copied(checkpoint["last"]), x)
        self._inner.restore(checkpoint["inner"], self._known(x))

    def again(self, h: float, t: float) -> State:
        """Return the last step taken again with another length."""
        return self._store(self._inner.again(h, t))

    def follow(self, accelerate: Any, mode: Mode = ()) -> None:
        """Follow other accelerations from the next step on."""
        self._inner.follow(self._form.adapted(accelerate), mode)

    def continue_from(self, x: State) -> None:
        """Go on from a state that stabilization has made of the last one, history kept."""
        self._last = x, self._moved(x)
        self._inner.continue_from(self._last[1])

    @property
    def pace(self) -> tuple[float, ...]:
        """Length of the next step [s] and last error, where the method chooses its steps."""
        return self._inner.pace

    @pace.setter
    def pace(self, pace: tuple[float, ...]) -> None:
        self._inner.pace = pace

    def interpolate(self, t: float) -> State:
        """Return the state inside the last step, by the dense output of the method."""
        return self._to_system_form(self._inner.interpolate(t))

    def _to_method_form(self, x: State) -> State:
        """Return a state in the form of the method."""
        raise NotImplementedError

    def _to_system_form(self, after: State) -> State:
        """Return a state of the method in the form of the system."""
        raise NotImplementedError

    def _moved(self, x: State) -> State:
        """Return a state in the form of the method, near the last one."""
        return self._to_method_form(x)

    def _known(self, x: State) -> State:
        last, adapted = self._last
        if x is not last or adapted is None:
            adapted = self._to_method_form(x)
            self._last = x, adapted
        return adapted

    def _store(self, after: State) -> State:
        x = self._to_system_form(after)
        self._last = x, after
        return x


class TurnedSteps(AdaptedSteps):
    """Steps whose states have velocities in the axes of the bodies, as all others.

    Args:
        world: The system in the axes of the world.
        inner: Steps of that.
    """

    def __init__(self, world: InWorldAxes, inner: Stepper) -> None:
        super().__init__(world, inner)
        self._world = world

    def _to_method_form(self, x: State) -> State:
        return self._world.to_world(x)

    def _to_system_form(self, after: State) -> State:
        return self._world.from_world(after)


class InternalSteps(AdaptedSteps):
    """Steps in which internal states stand beside velocities, see `Extended`.

    They are inside their bounds after every step.

    Args:
        system: The system, with internal states.
        dt: Length of a step, or first guess [s].
    """

    def __init__(self, method: Integrator, system: Any, dt: float) -> None:
        self._extended, self._nq = Extended(system), int(system.nq)
        super().__init__(self._extended, method.prepare(self._extended, dt))
        followed = self._inner.system
        self.system = None if followed is None else followed.system

    def again(self, h: float, t: float) -> State:
        """Return the last step taken again with another length."""
        after = self._inner.again(h, t)
        x = self._extended.parted(after)
        self._last = x, after
        if _is_beyond(x, after):
            self._last = x, self._moved(x)
        return x

    def _to_method_form(self, x: State) -> State:
        return self._extended.joined(x)

    def _to_system_form(self, after: State) -> State:
        return self._extended.parted(after)

    def _store(self, after: State) -> State:
        """Return the state after a step; the method goes on from bounds where it went beyond."""
        x = super()._store(after)
        if _is_beyond(x, after):
            self.continue_from(x)
        return x

    def _moved(self, x: State) -> State:
        """Return a state with the integrals of the last one."""
        joined = self._last[1]
        return self._extended.joined(x, None if joined is None else joined.q[self._nq :])


def _is_beyond(x: State, joined: State) -> bool:
    """Whether a step went beyond bounds of internal states."""
    z = joined.v[len(x.v) :]
    return bool(((x.z != z) & (z == z)).any())
