"""From mode to mode: resets, impacts and the mode in which a motion goes on."""

from collections.abc import Collection

import numpy as np

from mbd_ros.core.events.accumulation import Pace
from mbd_ros.core.events.event import Event
from mbd_ros.core.events.event_log import EventLog
from mbd_ros.core.events.impact_events import Impacts, Rest
from mbd_ros.core.events.mode_decision import decided
from mbd_ros.core.events.mode_field import Margin, ModeField
from mbd_ros.core.impacts.impact_map import Impact
from mbd_ros.core.state import Array, State
from mbd_ros.errors import JammedError, SolveError

_MOST_AT_ONCE = 100  # impacts that may follow one another at one time
_SHORT = 1.0e-3  # of dt: events this close to one another are counted

Known = tuple[frozenset[int], tuple[Rest, ...], Pace, EventLog]


class Transitions:
    """What happens at events, in the mode of a field; it is written down.

    Args:
        field: The system in its modes.
        dt: Step of a fixed-step method, and interval of the output [s].

    Attributes:
        left: Switches that the motion is just leaving, and guards that were zero just now.
        rests: Bounces that have not ended.
        events: What happened so far.
        ended: Names of the guards that end the phase, at the end of the last step.
    """

    def __init__(self, field: ModeField, dt: float) -> None:
        self._field, self._system, self._short = field, field.system, _SHORT * dt
        self._impacts: Impacts | None = None
        if field.rows is not None and field.gaps:
            self._impacts = Impacts(field.system, field.rows, field.gaps)
        self.forget()

    def forget(self) -> None:
        """Start anew."""
        self.ended: tuple[str, ...] = ()
        self.known = frozenset(), (), Pace(), EventLog()

    @property
    def known(self) -> Known:
        """What later events depend on, and those so far."""
        return self.left, self.rests, self._pace, self.events

    @known.setter
    def known(self, known: Known) -> None:
        self.left, self.rests, self._pace, self.events = known

    def happened(self, x: State, u: Array | None, margin: Margin | None) -> State:
        """The state after an event: impacts, then the mode that begins."""
        field, before = self._field, x
        if margin and (ways := field.renamed(x, u, margin)):
            self.change(ways)
            return field.onto_rows(x)._replace(mode=field.mode)
        switch, way = margin or (-1, 0)
        fired, impact = field.fired(x, u, switch), None
        if idle := field.idle(x, fired):
            self.left |= frozenset(idle)
            fired = [i for i in fired if i not in idle]
            if switch in idle and not fired:
                return x
        if ending := field.ending(fired):
            self.ended = tuple(field.names[i] for i in ending)
            return x
        if fired:
            x = self.begun(field.inside(field.reset(x, u, fired)), u)
            self.left |= frozenset(fired)
        hits = self.hits(x)
        if hits:
            x, impact = self._struck(x, u)
            self.left |= frozenset(fired)
        elif way and not fired:
            self.change(field.leaving(x, u, (switch, way)))
        elif margin and not fired:
            x = self.decide(x, u, {*field.on, switch, *field.near(x)})
        x = field.onto_rows(x)._replace(mode=field.mode)
        names = tuple(field.names[i] for i in sorted({switch, *hits, *fired} - {-1}))
        if not self.rests:
            given = (x.t, self._short, len(field.names), names)
            self._pace = self._pace.after(*given, hits=bool(hits))
        self._log(names, before, x, impact)
        return x

    def hits(self, x: State) -> list[int]:
        """Gaps that are closed and close further."""
        return [] if self._impacts is None else self._impacts.hits(x)

    def _struck(self, x: State, u: Array | None) -> tuple[State, Impact]:
        """The state after impacts, in its mode, and what they are together."""
        impacts, field = self._impacts, self._field
        assert impacts is not None
        x, impact = impacts.after(x)
        for _ in range(_MOST_AT_ONCE):
            if not impacts.hits(x):
                break
            x, more = impacts.after(x)  # a gap that was open by hardly more than rounding
            impact = Impact(more.v, impact.p + more.p, min(impact.share, more.share))
        x = self.begun(x, u)
        rests = impacts.rests(x, u, field.mode)
        if rests:
            self.rests = (*self.rests, *rests)
            self.change({rest.row: 0 for rest in rests})
            x = self.begun(field.onto_rows(x), u)
        return x, impact

    def rested(self, x: State) -> State:
        """The state in which gaps are at rest whose bounces have ended."""
        over = sorted({rest.row for rest in self.rests if rest.t <= x.t})
        self.rests = tuple(rest for rest in self.rests if rest.t > x.t)
        self._log(tuple(self._field.names[i] for i in over), x, x, None)
        return x

    def _log(
        self, names: tuple[str, ...], before: State, after: State, impact: Impact | None
    ) -> None:
        impulse, share = np.zeros(len(self._system.multiplier_rows)), 1.0
        if impact is not None:
            impulse, share = impact.p, impact.share
        expand = self._system.expand
        event = Event(after.t, names, expand(before), expand(after), impulse, share)
        self.events = self.events.after(event)

    def begun(self, x: State, u: Array | None) -> State:
        """The state with the mode that heights and accelerations say."""
        field = self._field
        field.begin(x)
        self.left = frozenset(field.close(x, u))
        return self.decide(x, u, field.near(x))

    def decide(self, x: State, u: Array | None, on: Collection[int]) -> State:
        """The state in the modes in which switches go on, after impulses where friction jams."""
        try:
            ways = self.decided(x, u, on)
        except JammedError:
            x = self._jammed(x, u)
            ways = self.decided(x, u, self._field.near(x))
        self.change(ways)
        return x._replace(mode=self._field.mode)

    def _jammed(self, x: State, u: Array | None) -> State:
        """The state after an impulse without collision, at its heights."""
        field, impacts = self._field, self._impacts
        assert impacts is not None
        slipping = impacts.slipping(x)
        after, impact = impacts.without_collision(x, u, slipping)
        field.begin(after)
        self.left = frozenset(field.close(after, u))
        self._log(tuple(field.names[i] for i in slipping), x, after, impact)
        return after

    def decided(self, x: State, u: Array | None, on: Collection[int]) -> dict[int, int]:
        """Modes in which switches go on."""
        try:
            return decided(self._field, x, u, on)
        except SolveError as error:
            raise type(error)(f"t = {x.t:.9g} s: {error}") from error

    def change(self, ways: dict[int, int]) -> None:
        """Switch to another mode; switches that are off are being left."""
        field = self._field
        field.mode = tuple(ways.get(i, way) for i, way in enumerate(field.mode))
        self.left |= frozenset(i for i, way in ways.items() if way)
        self.left -= frozenset(i for i, way in ways.items() if not way)

    def switched(self, x: State) -> State:
        """The state in another mode, which inputs that jump have begun."""
        pairs = zip(self._field.names, x.mode, self._field.mode, strict=True)
        names = tuple(name for name, one, other in pairs if one != other)
        after = x._replace(mode=self._field.mode)
        if names:
            self._log(names, x, after, None)
        return after
