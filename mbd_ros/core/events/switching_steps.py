"""Steps of a smooth method from switching event to switching event."""

import math

import numpy as np

from mbd_ros.core.events.sliding_field import SlidingField
from mbd_ros.core.events.step_events import Event, StepEvents
from mbd_ros.core.events.surface_modes import mode_on
from mbd_ros.core.integration.runge_kutta import RungeKutta
from mbd_ros.core.integration.stepping import Stepper
from mbd_ros.core.memory import Memory
from mbd_ros.core.state import Array, State
from mbd_ros.errors import SolveError

_SHORT, _MOST = 1.0e-3, 16  # events this close, in dt, and how many of them may follow one another


class SwitchingSteps(Stepper):
    """Runge-Kutta steps that end where a switching surface is reached or left.

    Each step is taken in one mode. After an event the mode is decided when the next step begins,
    so that the dense output of the finished step keeps its own mode.

    Args:
        field: The system in its modes.
        inner: Runge-Kutta steps of that field.
        dt: Step of a fixed-step method, and interval of the output [s].

    Attributes:
        field: As given.
    """

    kept = ("_last", "_u", "_event", "_left", "_event_time", "_quick")

    def __init__(self, field: SlidingField, inner: RungeKutta, dt: float) -> None:
        self.field, self._inner, self._short = field, inner, _SHORT * dt
        self.system = field.system
        self.is_fixed = inner.is_fixed
        self._events = StepEvents(field, inner)
        self._last: State | None = None
        self._u: Array | None = None
        self._event: Event | None = None
        self._left: frozenset[int] = frozenset()
        self._event_time, self._quick = -math.inf, 0

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by one step of the inner method, or to the next event.

        Raises:
            SolveError: The solution is not unique or ends, or events accumulate.
            DivergedError: As the inner method.
        """
        if not x.t < end:
            return x
        while True:
            self._settle(x, u)
            after = self._inner.step(x, u, end)
            if after is x:
                return x
            after, self._event = self._events.first(x, u, after, self._left)
            if after is not x:
                break
        stepped, after = after, self.field.onto(after, u)
        is_inner = after is stepped
        self._last = after = after._replace(mode=self.field.mode)
        if is_inner:
            self._inner.stages.rename(after)
        self._left &= self._events.near(after)
        return after

    def settle(self, x: State, u: Array | None) -> State:
        """The state with the mode in which it goes on."""
        self._settle(x, u)
        self._last = x = x._replace(mode=self.field.mode)
        return x

    def restart(self) -> None:
        """Forget mode, events and earlier steps."""
        self._inner.restart()
        self._last = self._u = self._event = None
        self._left = frozenset()
        self._event_time, self._quick = -math.inf, 0
        self.field.times.clear()
        self.field.modes.clear()

    def memory(self) -> Memory:
        """Mode, events and the last step."""
        field = self.field
        modes = field.mode, tuple(field.times), tuple(field.modes)
        return {**super().memory(), "modes": modes, "inner": self._inner.memory()}

    def recall(self, memory: Memory, x: State) -> None:
        """As `Stepper.recall`."""
        super().recall({name: memory[name] for name in self.kept}, x)
        self._inner.recall(memory["inner"], x)
        self.field.mode, times, modes = memory["modes"]
        self.field.times[:], self.field.modes[:] = times, modes

    def continue_from(self, x: State) -> None:
        """Continue in the same mode from a corrected state."""
        self._last = x

    def interpolate(self, t: float) -> State:
        """State at a time inside the last step, on the surfaces that it slides on."""
        if self._last is not None and t == self._last.t:
            return self._last
        x = self.field.onto(self._inner.interpolate(t), self._u)
        return x._replace(mode=self.field.mode)

    def _settle(self, x: State, u: Array | None) -> None:
        """Decide the mode of the next step where anything has happened."""
        field, event = self.field, self._event
        is_new = self._last is None or x.t != self._last.t  # otherwise the last one, corrected
        is_changed = not _same(u, self._u)
        if is_changed:
            self._u = None if u is None else u.copy()
        self._event, self._last = None, x
        if is_new:
            field.mode = tuple(np.where(field.heights(x) < 0.0, -1, 1).tolist())
            self._decide(x, u, self._events.near(x))
            return
        if event is not None:
            self._count(x.t)
        if event is not None and event.way and not is_changed:
            self._change(x, {event.surface: event.way})
        elif event is not None:
            self._decide(x, u, {*field.sliding, event.surface, *self._events.near(x)})
        elif is_changed and field.sliding:
            self._decide(x, u, set(field.sliding))

    def _decide(self, x: State, u: Array | None, on: set[int]) -> None:
        """Continue from surfaces that the state is on."""
        if not on:
            self._change(x, {})
            return
        chosen = sorted(on)
        answer = self.field.answer(x, u, chosen)
        names = [self.field.names[i] for i in chosen]
        try:
            ways = mode_on(answer.r[chosen], answer.D[chosen], names)
        except SolveError as error:
            raise SolveError(f"t = {x.t:.9g} s: {error}") from error
        self._change(x, dict(zip(chosen, ways, strict=True)))

    def _change(self, x: State, ways: dict[int, int]) -> None:
        """Switch to another mode."""
        field = self.field
        field.mode = tuple(ways.get(i, way) for i, way in enumerate(field.mode))
        if not field.modes or field.mode != field.modes[-1]:
            field.times.append(x.t)
            field.modes.append(field.mode)
        self._left = frozenset(i for i, way in ways.items() if way)
        self._inner.stages.forget()

    def _count(self, t: float) -> None:
        """Refuse events that accumulate."""
        self._quick = self._quick + 1 if t - self._event_time < self._short else 0
        self._event_time = t
        if self._quick > _MOST + 2 * len(self.field.names):
            names = ", ".join(self.field.names)
            raise SolveError(
                f"t = {t:.9g} s: {self._quick} switching events, each within {self._short:.2g} s "
                f"of the last one, accumulate (Zeno) at {names}"
            )


def _same(one: Array | None, other: Array | None) -> bool:
    """Whether commands are the same bits."""
    if one is None or other is None:
        return one is other
    return one.tobytes() == other.tobytes()
