"""When an iterating integrator stops correcting, and the rows that it refuses."""

import math
from collections.abc import Callable

from mbd_ros.core.dynamics.system import System
from mbd_ros.errors import ModelError

FAILED = math.inf
SLOW = 0.1  # contraction from which fresh derivatives pay
_DEEPER = 1.0e-5  # of the tolerance: where the iteration aims while it still gains
_LIMIT = 30
_GAINS_NOTHING = 0.5  # contraction that means rounding once the tolerance is met
_GROWS = 10.0


def converge(correct: Callable[[], float], tolerance: float) -> float:
    """Repeat a correction until the remaining error is rounding.

    With contraction r, corrections that remain sum to r / (1 - r) of the last one.

    Args:
        correct: Corrects once and returns the size of the correction.
        tolerance: Size below which a correction may stop shrinking.

    Returns:
        Slowest contraction above the tolerance, 0 after a single correction; `FAILED` without
        convergence, also for NaN.
    """
    last, slowest = correct(), 0.0
    if last == 0.0:
        return slowest
    for _ in range(_LIMIT):
        size = correct()
        rate = size / last
        if last > tolerance:
            slowest = max(slowest, rate)
        if rate < 1.0 and size * rate <= _DEEPER * tolerance * (1.0 - rate):
            return slowest
        if size <= tolerance and rate > _GAINS_NOTHING:
            return slowest
        if not rate < _GROWS:
            return FAILED
        last = size
    return FAILED


def refuse_bounded_rows(system: System, name: str) -> None:
    """Refuse rows with bounded multipliers, which these methods do not see.

    Raises:
        ModelError: They do; names them.
    """
    bounded = getattr(system, "bounded", None)
    if bounded is not None:
        rows = ", ".join(row.name for row in bounded.rows)
        raise ModelError(
            f"integrator {name} keeps bilateral rows only, the scene bounds {rows}; accepted: "
            "any integrator that does not keep constraints itself, such as rk4"
        )


def refuse_rows_of_velocities(system: System, name: str) -> None:
    """Refuse rows that state velocities alone, which a method for positions does not keep.

    Raises:
        ModelError: There are some; names them.
    """
    bilateral = system.bilateral
    if len(bilateral.rows) > len(system.rows):
        known = {row.name for row in system.rows}
        rows = ", ".join(row.name for row in bilateral.rows if row.name not in known)
        raise ModelError(
            f"integrator {name} keeps rows of positions, the scene has rows of velocities {rows}; "
            "accepted: generalized_alpha, or any integrator that does not keep constraints itself"
        )
