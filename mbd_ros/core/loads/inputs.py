"""u: the numbers that the parts of a scene take from outside, where each stands, what gives it."""

import heapq
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from typing import NamedTuple

import numpy as np

from mbd_ros.core.contracts.parts import Actuator, Channel, Part, Slots
from mbd_ros.core.loads.input_sources import Source
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError


class Sources:
    """The u of a scene over time.

    What is smooth is added at every stage: until then its places in u hold the time of its last
    jump, which says on which side of a jump a stage is, and by which steppers see that u changed.

    Args:
        idle: The u that no source gives, shape (nu,).
        given: Where in u the values of each source stand.

    Attributes:
        idle: As given, not to be written to.
        given: As given.
        smooth: The sources that are asked at every stage.
    """

    def __init__(self, idle: Array, given: Sequence[tuple[slice, Source]] = ()) -> None:
        self.idle, self.given = idle, tuple(given)
        self.smooth = tuple((at, source) for at, source in given if source.is_smooth)

    def at(self, t: float) -> Array:
        """The whole u at a time [s], fresh, shape (nu,)."""
        u = self.idle.copy()
        for at, source in self.given:
            u[at] = source.at(t)
        return u

    def held(self, jump: float) -> Array | None:
        """What steps from a jump [s] on hold, fresh; None where there is no source."""
        if not self.given:
            return None
        u = self.idle.copy()
        for at, source in self.given:
            u[at] = jump if source.is_smooth else source.at(jump)
        return u

    def complete(self, u: Array, t: float) -> Array:
        """The whole u at a time [s], fresh, shape (nu,), from what `held` gave."""
        whole = u.copy()
        for at, source in self.smooth:
            whole[at] = source.since(float(u[at.start]), t)
        return whole

    def jumps(self, begin: float, end: float) -> Iterator[float]:
        """Times between two others at which u jumps [s], increasing."""
        return heapq.merge(*(source.jumps(begin, end) for _, source in self.given))


class Inputs(NamedTuple):
    """The channels of u.

    Attributes:
        names: `<part>`, or `<part>.<channel>` where a part has several, in the order of u.
        channels: As the parts declare them, in the same order.
        slots: Name of a part -> where its inputs stand.
    """

    names: tuple[str, ...]
    channels: tuple[Channel, ...]
    slots: Mapping[str, slice]

    @property
    def safe(self) -> Array:
        """The u that no source gives, fresh, shape (nu,)."""
        return np.array([channel.safe for channel in self.channels], dtype=np.float64)

    def sources(self, given: Mapping[str, Source]) -> Sources:
        """What gives u, from the sources of parts by name; the others have safe values.

        Raises:
            ModelError: A part that is not there or has no inputs.
        """
        unknown = [name for name in given if name not in self.slots]
        if unknown:
            accepted = ", ".join(self.slots) or "none"
            raise ModelError(f"no part '{unknown[0]}' has inputs; accepted: {accepted}")
        return Sources(self.safe, [(self.slots[name], one) for name, one in given.items()])


def input_names(part: Part) -> tuple[str, ...]:
    """`<part>`, or `<part>.<channel>` where a part has several inputs."""
    return tuple(".".join(filter(None, (part.name, one.name))) for one in part.inputs)


def command_names(actuators: Sequence[Actuator]) -> list[tuple[str, ...]]:
    """What files and topics call the inputs of each actuator.

    A joint stands for its only actuator, where that has one input a joint; all other inputs go by
    their own names.

    Args:
        actuators: All actuators of a scene.
    """
    driven = Counter(joint for part in actuators for joint in part.joints)
    found = []
    for part in actuators:
        names = input_names(part)
        if len(names) == len(part.joints):
            pairs = zip(part.joints, names, strict=True)
            names = tuple(joint if driven[joint] == 1 else name for joint, name in pairs)
        found.append(names)
    return found


def bound(parts: Sequence[Part]) -> tuple[tuple[Part, ...], Inputs]:
    """Parts that know where their inputs and internal states stand, and all inputs.

    A part that another scene has bound to other places is copied: parts hold constants.

    Args:
        parts: Parts with inputs or internal states.

    Returns:
        The parts in the order given, and the inputs.
    """
    found: list[Part] = []
    names: list[str] = []
    channels: list[Channel] = []
    states = 0
    for part in parts:
        begin, first = len(channels), states
        channels += part.inputs
        names += input_names(part)
        states += len(part.internal)
        z = slice(first, states) if part.internal else part.z
        found.append(_at(part, Slots(slice(begin, len(channels)), z)))
    slots = {part.name: part.u for part in found if part.inputs}
    return tuple(found), Inputs(tuple(names), tuple(channels), slots)


def _at(part: Part, slots: Slots) -> Part:
    if (part.u, part.z) == slots:
        return part
    if (part.u, part.z) != (Part.u, Part.z):
        part = copy(part)
    part.bind(slots)
    return part
