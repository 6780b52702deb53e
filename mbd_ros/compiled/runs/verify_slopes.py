"""Compiled derivatives beside differences of the plain tier."""

from collections.abc import Callable, Sequence

import numpy as np

from mbd_ros.compiled.build.compiler import BuildError
from mbd_ros.compiled.build.verify import plain_rates, some_inputs, some_state
from mbd_ros.compiled.runs.compiled_system import CompiledSystem
from mbd_ros.core.dynamics.extended import Extended
from mbd_ros.core.dynamics.residual_force import Balance
from mbd_ros.core.state import Array, State
from mbd_ros.errors import MbdError

_SEED = 22
_STEP = 1.0e-4  # along a direction of length 1: differences are good to 1e-6
_CLOSE = 1.0e-4  # of the largest; wrong code is wrong by more
_SMOOTH = 1.0e-5  # of the largest: where steps of two lengths agree, there is a slope

Field = Callable[[State], Array]


def verify_slopes(system: CompiledSystem, names: Sequence[str]) -> None:
    """Compares slopes along one direction at a random state.

    States at which the plain tier has no solution, or no slope, say nothing.

    Args:
        system: The compiled system.
        names: The functions that it was compiled to.

    Raises:
        BuildError: They differ.
    """
    plain, rng = system.system, np.random.default_rng(_SEED)
    y = some_state(plain, rng)
    u, _ = some_inputs(plain, y.t, rng)
    along = rng.normal(size=2 * plain.nv + len(y.z))
    along /= np.linalg.norm(along)
    try:
        if "derivatives" in names:
            by_q, by_v = system.derivatives(y, u, inputs=False).of_velocities
            _compare(system, lambda x: plain_rates(plain, x, u), y, along, (by_q, by_v))
        if "balance" in names:
            whole = Extended(plain) if len(y.z) else plain
            a, lam = rng.normal(size=whole.nv), rng.normal(size=len(plain.held.rows))
            forces, given = Balance(whole), (u, a, lam)

            def force(x: State) -> Array:
                at = whole.joined(x) if isinstance(whole, Extended) else x
                return forces.force(at.t, at.q, at.v, *given)

            own, at = system.balance(whole), whole.joined(y) if isinstance(whole, Extended) else y
            _compare(system, force, y, along, own.slopes(at.t, at.q, at.v, *given))
    except MbdError as error:
        if isinstance(error, BuildError):
            raise


def _compare(
    system: CompiledSystem, field: Field, y: State, along: Array, slopes: tuple[Array, Array]
) -> None:
    """Slopes along a direction beside differences of a field.

    Raises:
        BuildError: They differ.
    """
    n, chart = system.system.nv, system.system.chart
    found = slopes[0][:, :n].dot(along[:n]) + slopes[1].dot(along[n:])

    def difference(h: float) -> Array:
        after, before = (field(chart.plus(y, sign * h * along)) for sign in (1.0, -1.0))
        return (after - before) / (2.0 * h)

    wanted, again = difference(_STEP), difference(0.5 * _STEP)
    size = 1.0 + float(np.abs(wanted).max(initial=0.0))
    if not np.abs(wanted - again).max(initial=0.0) <= _SMOOTH * size:
        return
    apart = float(np.abs(found - wanted).max(initial=0.0))
    if not apart <= _CLOSE * size:
        raise BuildError(
            f"compiled derivatives differ by {apart:.3g} from those of the plain tier"
        )
