"""u: the numbers that the parts of a scene take from outside, and where each stands."""

from collections.abc import Sequence
from copy import copy
from typing import NamedTuple

import numpy as np

from mbd_ros.core.parts import Channel, Part, Slots
from mbd_ros.core.state import Array


class Inputs(NamedTuple):
    """The channels of u.

    Attributes:
        names: `<part>`, or `<part>.<channel>` where a part has several, in the order of u.
        channels: As the parts declare them, in the same order.
    """

    names: tuple[str, ...] = ()
    channels: tuple[Channel, ...] = ()

    @property
    def safe(self) -> Array:
        """The u that no source gives, fresh, shape (nu,)."""
        return np.array([channel.safe for channel in self.channels], dtype=np.float64)


def bound(parts: Sequence[Part]) -> tuple[tuple[Part, ...], Inputs]:
    """Parts that know where their inputs stand, in the order given, and all inputs.

    A part that another scene has bound to other places is copied: parts hold constants.

    Args:
        parts: Parts with inputs.
    """
    found: list[Part] = []
    names: list[str] = []
    channels: list[Channel] = []
    for part in parts:
        begin = len(channels)
        channels += part.inputs
        names += [".".join(filter(None, (part.name, one.name))) for one in part.inputs]
        found.append(_at(part, Slots(slice(begin, len(channels)), part.z)))
    return tuple(found), Inputs(tuple(names), tuple(channels))


def _at(part: Part, slots: Slots) -> Part:
    if (part.u, part.z) == slots:
        return part
    if part.u != Part.u:
        part = copy(part)
    part.bind(slots)
    return part
