"""Ways to impulses of contacts with friction, from the fastest to the one that finds most.

Newton's method begins with the impulses of an earlier step, or none. Where it does not end, it
follows the answers of A + s I from s = 1 to 0. Then sweeps over the contacts, each solved exactly
by itself, and then random impulses give it a start. Source: V. Acary, M. Brémond, O. Huber, On
solving contact problems with Coulomb friction: formulations and numerical comparisons, 2017.
"""

import math
from collections.abc import Iterator

import numpy as np

from mbd_ros.core.complementarity.cone_contact import cone_contact
from mbd_ros.core.complementarity.cone_newton import Bounds, ConeNewton
from mbd_ros.core.state import Array
from mbd_ros.errors import SolveError

_STEPS, _HALVINGS = 20, 4
_MANY = 200  # steps from the best impulses
_FALLS, _LEAST = 0.5, 1.0e-11  # the damping of A, and where it ends
_NEAR = (
    1.0e-13  # what may be left of the map on the way: less than what rows contradict one another
)
_SWEEPS = 5, 50
_STARTS, _PATHS = 40, 20  # random ones
_SIZES = -1.0, 2.0  # of random impulses, as powers of ten
_LARGE = 1.0e4  # impulses in units of the rates that they end
_USUAL = 4  # starts, before those that find answers to hard problems alone
_SEED = 0  # the same problem has the same answer


def searched(
    newton: ConeNewton, b: Array, bounds: Bounds, start: Array, enough: tuple[float, float]
) -> tuple[Array, float]:
    """The best impulses of all ways, and what they leave of the natural map.

    What is left counts per size of the impulses, which round it, but impulses without bound, as
    those of contacts that contradict one another, excuse nothing.

    Args:
        newton: The problem.
        b: Rates without impulses, shape (m,), of the order of 1.
        bounds: What impulses may be.
        start: Impulses to begin with, shape (m,).
        enough: What may be left, and what may where neither Newton's method nor sweeps end.
    """
    best, smallest = start, np.inf
    for tried, (near, steps) in enumerate(_starts(newton, b, bounds, start)):
        for halvings in (0, _HALVINGS):
            p, left = newton.solve(b, bounds, best if near is None else near, steps, halvings)
            left /= 1.0 + min(float(np.abs(p).max()), _LARGE)
            if left < smallest:
                best, smallest = p, left
            if smallest <= (max(enough) if tried > _USUAL else enough[0]):
                return best, smallest
    return best, smallest


def _starts(
    newton: ConeNewton, b: Array, bounds: Bounds, start: Array
) -> Iterator[tuple[Array | None, int]]:
    """Where to begin, None for the best impulses so far, and how many steps there may be."""
    none = np.zeros(len(b))
    yield start, _STEPS
    if start.any():
        yield none, _STEPS
    yield _followed(newton, b, bounds, none, 1.0), _STEPS
    swept = none
    for sweeps in _SWEEPS:
        swept = _swept(newton, b, bounds, swept, sweeps)
        yield swept, _STEPS
    yield None, _MANY
    random = np.random.default_rng(_SEED)
    for _ in range(_STARTS):
        yield _random(newton, random), _STEPS
    yield None, _MANY
    for _ in range(_PATHS):
        near = _random(newton, random)
        yield _followed(newton, b, bounds, near, 10.0 ** random.uniform(-3.0, 0.0)), _STEPS
    yield None, _MANY


def _random(newton: ConeNewton, random: np.random.Generator) -> Array:
    """Impulses of any size, friction within its cones."""
    _, normal, first, second, mu = newton.contacts
    p = np.asarray(random.normal(size=len(newton.A)) * 10.0 ** random.uniform(*_SIZES))
    p[normal] = np.abs(p[normal])
    turn, share = random.uniform(0.0, 2.0 * math.pi, len(mu)), random.uniform(size=len(mu))
    p[first] = share * mu * p[normal] * np.cos(turn)
    p[second] = share * mu * p[normal] * np.sin(turn)
    return p


def _followed(newton: ConeNewton, b: Array, bounds: Bounds, p: Array, damping: float) -> Array:
    """Impulses at the end of the answers of A + s I, s from a damping to 0."""
    while damping > _LEAST:
        p, _ = newton.damped(damping).solve(b, bounds, p, _STEPS, _HALVINGS, _NEAR)
        damping *= _FALLS
    return p


def _swept(newton: ConeNewton, b: Array, bounds: Bounds, p: Array, sweeps: int) -> Array:
    """Impulses after some sweeps over the rows, each contact solved by itself."""
    A, contacts, p = newton.A, newton.contacts, p.copy()
    rows = list(zip(contacts.others.tolist(), bounds.lower, bounds.upper, strict=True))
    places = zip(contacts.normal.tolist(), contacts.mu.tolist(), bounds.least, strict=True)
    cones = [(slice(i, i + 3), mu, float(least)) for i, mu, least in places]
    for _ in range(sweeps):
        for i, low, high in rows:
            p[i] = min(max(p[i] - (A[i].dot(p) + b[i]) / A[i, i], low), high)
        for at, mu, least in cones:
            own = A[at, at]
            rate = A[at].dot(p) + b[at] - own.dot(p[at])
            try:
                p[at] = cone_contact(own, rate, mu, least)
            except SolveError:  # it stays, and the others move it out of where it has no answer
                continue
    return p
