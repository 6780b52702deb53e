"""A motion as it was recorded."""

from collections import Counter
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from mbd_ros.core.state import Motion

NO_BODIES: Mapping[str, str] = MappingProxyType({})


class Recording(NamedTuple):
    """A motion and what was left out of it.

    Attributes:
        motion: The samples that can be used.
        dropped: Messages left out, counted by reason.
        by_log_time: Header stamps were zero, so stamps are the log times of the bag.
        assumed: Required joints that a storage of a laboratory lacks, at the position assumed.
        unused: Labels of such a storage that are of no joint asked for; None of other sources.
        remarks: What is odd about such a storage, for people.
        of_laboratory: Whether it is such a storage, or a motion found from markers: a motion of
            these may have positions alone.
    """

    motion: Motion
    dropped: Counter[str]
    by_log_time: bool = False
    assumed: tuple[str, ...] = ()
    unused: tuple[str, ...] | None = None
    remarks: tuple[str, ...] = ()
    of_laboratory: bool = False
