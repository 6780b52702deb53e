"""Where internal states start: as given, or at rest under the position, the velocity and u."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import redundant
from mbd_ros.errors import SolveError

_CORRECTIONS, _SHORTEST = 60, 1.0e-6  # Newton's steps, and their least share
_FIRST, _FOLLOWED = 1.0e-2, 200  # of z in a first implicit step, and how many there are
_STEP = 1.5e-8  # square root of the rounding unit
_AT_REST, _ROUNDING = 1.0e-9, 1.0e-15  # of z: corrections that may be, and that must be the last
_LEFT = 1.0e-6  # of a rate: what a correction may leave of it


def settled(system: System, y: State, u: Array | None) -> State:
    """A state whose internal states are as given, and else at their first values.

    Those whose equilibrium is asked for are where their rates are 0, or at a bound beyond which
    these would take them: where their part says so, else by Newton's method with shorter steps
    where one does not help, and else where they come to rest by themselves.

    Args:
        system: The system.
        y: State of what is integrated; z is NaN where nothing is given, or empty.
        u: Inputs; None asks the sources.

    Raises:
        SolveError: There is no equilibrium; names the internal states.
        ModelError: An internal state starts outside its bounds.
    """
    internals = system.internals
    z = system.at_rest(y._replace(z=internals.completed(y.z)), u)
    free = np.flatnonzero(np.isnan(z))
    z[free] = internals.inside(np.zeros(len(z)))[free]
    if not len(free):
        return y._replace(z=z)

    def all_rates(values: Array) -> Array:
        moved = z.copy()
        moved[free] = values
        found: Array = system.rates(y._replace(z=moved), u)
        return found

    rows = _determining(all_rates, z[free], free, internals.upper[free])

    def rates(values: Array) -> Array:
        found: Array = all_rates(values)[rows]
        return found

    bounds = internals.lower[free], internals.upper[free]
    found = _at_rest(rates, z[free], bounds)
    if found is None:
        found = _at_rest(rates, _followed(rates, z[free], bounds), bounds)
    if found is None:
        names = ", ".join(internals.names[i] for i in free)
        raise SolveError(
            f"no equilibrium of {names} at t = {y.t:.9g} s was found; give values in "
            "initial.internal"
        )
    z[free] = found
    return y._replace(z=z)


def _determining(
    rates: Callable[[Array], Array], z: Array, free: NDArray[np.intp], upper: Array
) -> NDArray[np.intp]:
    """The rate that each state is found from, shape (n,): its own, as a rule.

    A state that none of these rates depends on, such as the angle of a motor whose speed is given,
    is found from the first rate that it changes, such as that of the speed.
    """
    r = rates(z)
    if len(free) == len(r) or not np.isfinite(r).all():
        return free
    J = _slopes(rates, z, r, upper)
    rows = free.copy()
    for i in np.flatnonzero(~J[free].any(axis=0)):
        others = [j for j in np.flatnonzero(J[:, i]) if j not in rows]
        rows[i] = others[0] if others else free[i]
    return rows


def _at_rest(
    rates: Callable[[Array], Array], z: Array, bounds: tuple[Array, Array]
) -> Array | None:
    """Newton's method within bounds, None where it does not converge.

    A step is shortened until it shortens the next one (natural monotonicity test).

    Source: P. Deuflhard, Newton Methods for Nonlinear Problems, 2011, sec. 3.1.4, 3.3.
    """
    lower, upper = bounds
    r, last = rates(z), math.inf
    for _ in range(_CORRECTIONS):
        if not np.isfinite(r).all():
            return None
        J = _slopes(rates, z, r, upper)
        held = ((z <= lower) & (r < 0.0)) | ((z >= upper) & (r > 0.0))
        step, is_solved = _correction(J, r, held)
        size = _size(step, z)
        if size <= _ROUNDING or (size <= _AT_REST and size > 0.5 * last):
            return z if is_solved else None
        last, share = size, 1.0
        while True:
            nearer = np.minimum(np.maximum(z + share * step, lower), upper)
            there = rates(nearer)
            following = _size(_correction(J, there, held)[0], z)
            if following <= (1.0 - 0.5 * share) * size or size <= _AT_REST:
                break
            share *= 0.5
            if share < _SHORTEST:
                return None
        z, r = nearer, there
    return None


def _followed(rates: Callable[[Array], Array], z: Array, bounds: tuple[Array, Array]) -> Array:
    """Where the states go by themselves, in implicit steps of growing length.

    Source: C. T. Kelley, D. E. Keyes, SIAM J. Numer. Anal. 35, 1998, 508-523.
    """
    lower, upper = bounds
    r = rates(z)
    length = _FIRST / max(_size(r, z), _FIRST)
    for _ in range(_FOLLOWED):
        if not np.isfinite(r).all():
            break
        held = ((z <= lower) & (r < 0.0)) | ((z >= upper) & (r > 0.0))
        J = _slopes(rates, z, r, upper) - np.eye(len(z)) / length
        step, _ = _correction(J, r, held)
        if _size(step, z) > 1.0:
            length *= 0.25
            continue
        z = np.minimum(np.maximum(z + step, lower), upper)
        r, length = rates(z), 2.0 * length
    return z


def _slopes(rates: Callable[[Array], Array], z: Array, r: Array, upper: Array) -> Array:
    """Differences of m rates, shape (m, n)."""
    J = np.empty((len(r), len(z)))
    for i in range(len(z)):
        moved = z.copy()
        step = _STEP * max(1.0, abs(float(z[i])))
        moved[i] += step if z[i] + step <= upper[i] else -step
        J[:, i] = (rates(moved) - r) / (moved[i] - z[i])
    return J


def _correction(J: Array, r: Array, held: NDArray[np.bool_]) -> tuple[Array, bool]:
    """The step with r + J step = 0 of what no bound holds, and whether there is one."""
    step, free = np.zeros(len(r)), ~held
    part = J[np.ix_(free, free)]
    size = np.abs(part).max(axis=1, initial=0.0)
    size[size == 0.0] = 1.0
    wanted = -r[free] / size
    step[free] = np.linalg.lstsq(part / size[:, None], wanted, rcond=redundant(len(r)))[0]
    left = np.abs((part / size[:, None]).dot(step[free]) - wanted)
    return step, bool((left <= _LEFT * (_ROUNDING + np.abs(wanted))).all())


def _size(step: Array, z: Array) -> float:
    return float((np.abs(step) / (1.0 + np.abs(z))).max(initial=0.0))
