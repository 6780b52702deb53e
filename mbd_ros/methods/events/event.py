"""What happens at one time of a motion, and the list of it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple, overload

from mbd_ros.core.state import Array, State


class Event(NamedTuple):
    """Everything that falls together at one time, to rounding.

    Attributes:
        t: Time [s].
        guards: Names of the guards that were zero, in the order of the scene.
        before: State of all joints before it, with the mode that ends.
        after: State of all joints after resets and impacts, with the mode that begins.
        impulse: One a multiplier of the scene, in the order of `System.multiplier_rows` [N·s,
            N·m·s], shape (m,); 0 where nothing hits.
        share: Of the restitution of contacts that was given back: less than 1 where the whole
            would have gained energy.
        ends_phase: Whether a phase ended, and the next one began.
    """

    t: float
    guards: tuple[str, ...]
    before: State
    after: State
    impulse: Array
    share: float = 1.0
    ends_phase: bool = False


class EventLog(Sequence[Event]):
    """Events in the order of time, a value: one more event makes another log.

    Logs that follow one another share one list, and each knows how far its own part of it goes. So
    one more event, and a log that is kept as part of a checkpoint, cost the same however many
    there are.

    Args:
        events: The first ones.
    """

    def __init__(self, events: Iterable[Event] = ()) -> None:
        self._shared = list(events)
        self._count = len(self._shared)

    def after(self, event: Event) -> EventLog:
        """The log with one more event."""
        longer = EventLog.__new__(EventLog)
        is_newest = len(self._shared) == self._count
        longer._shared = self._shared if is_newest else self._shared[: self._count]
        longer._shared.append(_locked(event))
        longer._count = self._count + 1
        return longer

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[Event]:
        return (self._shared[i] for i in range(self._count))

    @overload
    def __getitem__(self, at: int) -> Event: ...
    @overload
    def __getitem__(self, at: slice) -> list[Event]: ...
    def __getitem__(self, at: int | slice) -> Event | list[Event]:
        numbers = range(self._count)[at]
        if isinstance(numbers, range):
            return [self._shared[i] for i in numbers]
        return self._shared[numbers]

    def __reduce__(self) -> tuple[Any, ...]:
        return EventLog, (list(self),)


def _locked(event: Event) -> Event:
    """The event with arrays of its own that nobody can change, since several logs hold them."""
    return event._replace(
        before=_kept(event.before), after=_kept(event.after), impulse=_own(event.impulse)
    )


def _kept(x: State) -> State:
    return State(x.t, _own(x.q), _own(x.v), _own(x.z), x.mode)


def _own(array: Array) -> Array:
    array = array.copy()
    array.flags.writeable = False
    return array
