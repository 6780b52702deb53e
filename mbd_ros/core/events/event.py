"""What happens at one time of a motion."""

from typing import NamedTuple

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
