"""Starts beyond the end of a gap."""

from collections.abc import Sequence

from mbd_ros.core.contact_modes.event_rows import ExactRows
from mbd_ros.core.contact_modes.row_distances import rounding
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.projection.assembly import assemble
from mbd_ros.core.state import State
from mbd_ros.errors import SolveError

_PASSES = 12


def inside(system: System, rows: ExactRows, gaps: Sequence[int], y: State) -> State:
    """A state near by in which no gap is beyond its end.

    A long way to the end of a gap opens loops by its square. So both are closed in turn; each pass
    squares what is left.

    Args:
        system: The system.
        rows: Its exact rows.
        gaps: Numbers of those that are gaps.
        y: State of what is integrated, on the bilateral rows.

    Raises:
        SolveError: Bilateral rows keep a gap beyond its end, or cannot be closed.
    """
    ended: set[int] = set()
    for _ in range(_PASSES):
        heights = rows.heights(y)
        slack = rounding(y) if ended else 0.0
        beyond = [i for i in gaps if heights[i] < -slack]
        if not beyond and all(heights[i] <= slack for i in ended):
            return y
        ended.update(beyond)
        mode = tuple(0 if i in ended else 1 for i in range(len(rows.names)))
        y = rows.onto(y, mode, moves=False)
        if not system.held.rows:
            return y
        y = assemble(system, y)
    if not beyond:
        return y
    names = ", ".join(rows.names[i] for i in beyond)
    raise SolveError(
        f"t = {y.t:.9g} s: the mechanism cannot be assembled on this side of {names}; start "
        "nearer to it, or look for constraints that contradict one another"
    )
