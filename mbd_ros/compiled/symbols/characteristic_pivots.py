"""How large pivots of rows usually are, so that one which vanishes shows."""

from typing import Any

import casadi as ca
import numpy as np

from mbd_ros.core.rows.characteristic_sizes import configurations
from mbd_ros.core.state import Array, State


def usual_pivots(system: Any, symbols: dict[str, Any], pivots: Any, switches: int = 0) -> Array:
    """Medians over configurations all over the range of the joints, at rest, shape (m,).

    Args:
        system: The system.
        symbols: Arguments by letter.
        pivots: Expressions of configuration and time.
        switches: How many of the rows, the last ones, have an entry of a mode behind the
            parameters: each is measured while the others of these are off.
    """
    asked = ca.Function("pivots", [symbols[key] for key in "tqvzup"], [pivots])
    rest = [np.zeros(symbols[key].shape[0]) for key in "vzup"]
    still, first = np.zeros(system.model.nv), len(rest[3]) - switches
    every = [system.reduce(State(0.0, q, still)).q for q in configurations(system.robot)]

    def medians() -> Array:
        found = np.array([np.array(asked(0.0, q, *rest)).ravel() for q in every])
        kept = np.where(np.isfinite(found), found, 0.0)
        return np.asarray(np.median(kept, axis=0))

    if switches:
        rest[3][first:] = 1.0
    usual = medians()
    for i in range(switches):
        rest[3][first:] = np.arange(switches) != i
        usual[i - switches] = medians()[i - switches]
    return usual
