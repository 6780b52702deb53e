"""Whether rows are independent enough to be solved for, and what lets some of them depend."""

from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols.link_rotations import ZERO
from mbd_ros.compiled.symbols.motion import SOFT, Held, Solution

if TYPE_CHECKING:
    from mbd_ros.compiled.symbols.equations import Equations


from mbd_ros.core.rows.characteristic_sizes import configurations
from mbd_ros.core.state import Array, State

# How large pivots of rows usually are, so that one which vanishes shows.


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


def health(equations: "Equations", solution: Solution, *, switches: bool = False) -> Any:
    """The smallest pivot of the rows over its usual size; 0 where a solution is not sound.

    Args:
        equations: Of the system.
        solution: Beside rows, those that give way last.
        switches: Whether there are any of these whose mode is an argument.
    """
    e, found = equations, ca.SX(1.0)
    count = e.switches if switches else 0
    off = e.slack if count else [ZERO] * len(solution.pivots)
    if solution.sound is not None:
        found = ca.fmin(solution.sound, e.yielding.directed)
    if solution.pivots:
        pivots = ca.vertcat(*solution.pivots)
        usual = usual_pivots(e.system, e.symbols, pivots, count)
        is_soft = [False] * len(off) if solution.sound is None else [one > 0.0 for one in e.soft]
        each = zip(solution.pivots, off, np.asarray(usual).tolist(), is_soft, strict=True)
        for pivot, slack, size in (one[:3] for one in each if not one[3]):
            share = pivot * (1.0 / size if size else 0.0)
            found = ca.fmin(found, share + slack * (1.0 - share))
    return found


def softness(equations: "Equations") -> list[float]:
    """What is added to the s of contacts, which may depend on one another; as `Held` takes it.

    Args:
        equations: Of the system.
    """
    e, chosen = equations, equations.yielding.touching
    if not chosen:
        return []
    mass = e.coordinates.reduced_matrix(e.dynamics[0].mass)
    pivots = ca.vertcat(*Held(mass, e.acting, e.nv, e.slack).pivots)
    sizes = np.abs(usual_pivots(e.system, e.symbols, pivots, e.switches)[e.mh :]).tolist()
    found = [0.0] * len(e.slack)
    for i in chosen:
        most = max(sizes[i : i + 3]) or 1.0
        found[e.mh + i : e.mh + i + 3] = [SOFT * most] * 3
    return found
