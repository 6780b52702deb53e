"""Steps that meet the times of a comparison, and times that leave room for a step."""

import math

from mbd_ros.applications.report.stability.cases import longest_step
from mbd_ros.applications.report.stability.motion import Grid
from mbd_ros.applications.report.stability.reference_motion import FINE

FITTING = 2  # steps that a motion lasts at least
LATEST = 10.0  # [s]: later a mechanism that falls is too far off for differences of places
_MOST = 48  # intervals of a motion that is made longer for its step
_OFF = 1.2  # ratio of two steps from which on they are different ones
_ROUNDING = 1.0e-9


def room(grid: Grid, dt: float) -> Grid:
    """The times themselves, or later ones if a few steps would not fit.

    Args:
        grid: Times of a comparison.
        dt: Longest step of all runs [s]; 0 if none is recommended.
    """
    span = min(FITTING * dt, LATEST)
    if span <= grid.span:
        return grid
    count = max(grid.count, min(_MOST, math.ceil(span / grid.interval)))
    return Grid(span / count, count)


def asked_step(method: str, rate: float, factor: float, dt: float = 0.0) -> float:
    """What a run is asked for [s]; 0 for a method that chooses its steps.

    Args:
        method: Key of `METHODS`.
        rate: Fastest rate at the start [1/s].
        factor: Multiple of the longest step that `check` does not warn of.
        dt: Step instead of the factor [s], if > 0.
    """
    longest = longest_step(method, rate)
    if longest == math.inf:
        return 0.0
    return dt if dt > 0.0 else factor * longest


def fitted(grid: Grid, dt: float, is_longest: bool = True) -> float:
    """The nearest step that meets the times of a comparison [s].

    That is a whole fraction of an interval, or a whole number of quarters of it from three on.

    Args:
        grid: Times of the comparison.
        dt: Step that is asked for [s]; 0 for a method that chooses its steps.
        is_longest: Whether a longer one will not do.
    """
    if dt <= 0.0:
        return grid.interval
    quarter = grid.interval / FINE
    dt = min(dt, grid.span)
    below, parts = math.floor(dt / quarter + _ROUNDING), math.ceil(grid.interval / dt - _ROUNDING)
    steps = [grid.interval / k for k in (parts - 1, parts) if k > 0]
    steps += [m * quarter for m in (below, below + 1) if FINE - 1 <= m <= FINE * grid.count]
    if is_longest:
        steps = [step for step in steps if step <= dt * (1.0 + _ROUNDING)]
    return min(steps, key=lambda step: abs(math.log(step / dt)))


def is_another(factor: float, ran: float) -> bool:
    """Whether a run was not at the multiple of the recommended step that its label names."""
    return 0.0 < ran < math.inf and not factor / _OFF <= ran <= factor * _OFF
