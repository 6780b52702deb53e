"""A simulator while time stands: it shows its state again, and takes no answer twice."""

from time import perf_counter

REPEAT = 0.2  # [s] without a command until the state that waits for one is shown again, at least
ARRIVAL = 0.5  # [s] for which the state is repeated for a new listener
LATE = 0.5  # [s] without a command that count as a fault
_SLACK = 3.0  # of the slowest answer so far: a slow controller is no loss
_FORGET = 0.9  # of that answer, a command


class Standing:
    """The state that waits: listeners that have not seen it, and commands that answered it.

    A message may be lost, and a listener may come late. While time stands no later state makes up
    for it, so the same state is shown again: for `ARRIVAL` when a listener appears, and in lock
    step whenever no command comes. A controller may then answer one state twice. The second answer
    must not advance time, or the loop would run a tick late for ever. Commands carry the stamp of
    the state that they answer, which separates them.

    Attributes:
        repeats: How often a state was shown again.
        doubled: Commands not taken: the state that they answer was answered before.
    """

    def __init__(self) -> None:
        self.repeats = self.doubled = 0
        self._listeners, self._until = 0, 0.0
        self._slowest = 0.0
        self._stamps: set[int] = set()
        self._answered: set[int] = set()
        self._since = self._shown = perf_counter()

    def show(self, stamp: int) -> None:
        """A new state is shown under a stamp [ns]; answers to the one before come too late."""
        self._answered, self._stamps = self._stamps - {stamp}, {stamp}
        self._since = self._shown = perf_counter()

    def show_again(self, stamp: int) -> None:
        """The same state is shown under a stamp [ns]."""
        self.repeats += 1
        self._stamps.add(stamp)
        self._shown = perf_counter()

    def takes(self, answered: int | None) -> bool:
        """Whether a command counts.

        Args:
            answered: Stamp of the state that it answers [ns]; None where it does not say so.
        """
        if answered in self._answered:
            self.doubled += 1
            return False
        latency = perf_counter() - self._shown
        self._slowest = max(latency, _FORGET * self._slowest)
        return True

    def is_wanted(self, listeners: int, is_lock_step: bool) -> bool:
        """Whether the state should be shown again now.

        Args:
            listeners: How many there are.
            is_lock_step: Whether a command is waited for.
        """
        now = perf_counter()
        if listeners > self._listeners:
            self._until = now + ARRIVAL
        self._listeners = listeners
        is_late = now - self._shown >= max(REPEAT, _SLACK * self._slowest)
        return now < self._until or (is_lock_step and is_late)

    @property
    def waited(self) -> float:
        """For how long the newest state has waited for its command [s]."""
        return perf_counter() - self._since
