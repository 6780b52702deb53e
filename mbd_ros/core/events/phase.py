"""A phase of a motion: what holds in it, what ends it, and what is reset then."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.contracts.outputs import Now
from mbd_ros.core.contracts.parts import Guard, Part
from mbd_ros.core.events.crossings import Condition, Crossing
from mbd_ros.core.events.phase_reset import PhaseReset
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.state import Array, State


class Exit(NamedTuple):
    """A way out of a phase.

    Attributes:
        name: Of its guard, unique in the phase.
        crossing: The number whose zero ends the phase; None where a time does.
        direction: 1 where it acts on the way up, -1 on the way down, 0 both ways.
        condition: Where it acts; None for everywhere.
        after: Time in the phase after which it acts [s]; None where a crossing does.
        then: Number of the next phase.
        reset: What happens at once.
    """

    name: str
    crossing: Crossing | None
    direction: int
    condition: Condition | None
    after: float | None
    then: int
    reset: PhaseReset


class Check(NamedTuple):
    """A number that stays positive in a phase, or the motion ends with an error.

    Attributes:
        name: Of its guard.
        contact: Whose number it is.
        crossing: The number.
        failure: What it means that it does not.
    """

    name: str
    contact: str
    crossing: Crossing
    failure: str


class Phase(NamedTuple):
    """What goes on between two events.

    Attributes:
        name: Unique in the scene.
        exits: What ends it, in the order of the scene: the first one that fires decides.
        checks: What may not happen in it.
        demands: What holds where it begins: the checks, and what exits wait for instead.
        limit: Longest time in it [s], beyond which no guard is waited for; inf without one.
    """

    name: str
    exits: tuple[Exit, ...]
    checks: tuple[Check, ...]
    demands: tuple[Check, ...]
    limit: float


class PhaseGuards(Part):
    """The guards of a phase, for the events of its steps: exits first, then checks.

    Args:
        name: Of the phase.
        exits: Its exits; those by time are none of its guards.
        checks: Its checks.
    """

    def __init__(self, name: str, exits: Sequence[Exit], checks: Sequence[Check]) -> None:
        self.name = name
        crossed = [(one.crossing, one) for one in exits if one.crossing is not None]
        self._crossings: list[Crossing] = [crossing for crossing, _ in crossed]
        self._crossings += [check.crossing for check in checks]
        self.guards = (
            *(_guard(one) for _, one in crossed),
            *(Guard(check.name, -1, ends=True) for check in checks),
        )
        self.reads = max((one.reads for one in self._crossings), default=Reads.NOTHING)

    def guard_values(self, k: Kinematics, x: State, u: Array, now: Now) -> Array:
        """The numbers of exits and checks, shape (n,)."""
        return np.array([one.value(k, x, now.lam) for one in self._crossings])


def _guard(one: Exit) -> Guard:
    condition = None if one.condition is None else one.condition.holds
    return Guard(one.name, one.direction, condition=condition, ends=True)
