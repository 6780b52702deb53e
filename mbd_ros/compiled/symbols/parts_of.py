"""Parts with symbols for some of their numbers."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from mbd_ros.compiled.symbols.scalar import numbers
from mbd_ros.compiled.symbols.untraceable import tracing
from mbd_ros.core.rows.row_layout import RowBlock

Made = Callable[[Mapping[str, Any]], Mapping[str, Any]]


def parts_of(made: Made, parameters: Sequence[str], p: Any) -> Mapping[str, Any]:
    """Parts of symbols by name; none without parameters."""
    if not parameters:
        return {}
    given = dict(zip(parameters, numbers(p), strict=True))
    with tracing(", ".join(parameters)):
        return made(given)


def with_part(block: RowBlock, part: Any) -> RowBlock:
    """A block of rows of another part of the same form."""
    if part is block.part:
        return block
    given: Any = (np.asarray(one, dtype=object) for one in part.gains)
    gains = tuple(np.broadcast_to(one, len(block.rows)) for one in given)
    if not any(map(np.any, block.gains)):  # rows that are on exactly
        gains = block.gains
    return block._replace(part=part, law=part.law, gains=gains)
