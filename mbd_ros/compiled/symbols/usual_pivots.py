"""How large pivots of rows usually are, so that one which vanishes shows."""

from typing import Any

import casadi as ca
import numpy as np

from mbd_ros.core.rows.usual_sizes import configurations
from mbd_ros.core.state import Array, State


def usual_pivots(system: Any, symbols: dict[str, Any], pivots: Any) -> Array:
    """Medians over configurations all over the range of the joints, at rest, shape (m,).

    Args:
        system: The system.
        symbols: Arguments by letter.
        pivots: Expressions of configuration and time.
    """
    asked = ca.Function("pivots", [symbols[key] for key in "tqvzup"], [pivots])
    rest = [np.zeros(symbols[key].shape[0]) for key in "vzup"]
    still = np.zeros(system.model.nv)
    every = (system.reduce(State(0.0, q, still)).q for q in configurations(system.robot))
    found = np.array([np.array(asked(0.0, q, *rest)).ravel() for q in every])
    kept = np.where(np.isfinite(found), found, 0.0)
    return np.asarray(np.median(kept, axis=0))
