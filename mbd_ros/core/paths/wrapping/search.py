"""Which geodesic a search ends at: on the side that is asked for, and a shortest one."""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.paths.wrapping.arcs import Arc, Placed
from mbd_ros.core.paths.wrapping.chain import shortest
from mbd_ros.core.paths.wrapping.ellipsoid import Ellipsoid
from mbd_ros.core.paths.wrapping.surface import Mask, Numbers, dot, unit
from mbd_ros.core.state import Array
from mbd_ros.errors import SolveError

_STEPS = 24  # from a sphere to an ellipsoid
_ROUNDING = 1.0e-9  # of a length


def solved(a: Array, b: Array, over: Sequence[Placed], guess: tuple[Arc, ...]) -> tuple[Arc, ...]:
    """Geodesics between two points.

    Where the guess leads to none, or off the side that is asked for, the guess on the nearer side
    is tried, and at last an ellipsoid that grows from a sphere.

    Args:
        a: Begin in common axes [m], shape (n, 3).
        b: End [m], shape (n, 3).
        over: Surfaces in order.
        guess: Their geodesics, about.

    Raises:
        SolveError: A geodesic is not found.
    """
    arcs = shortest(a, b, over, guess)
    for retry in (_plain, _grown):
        again = np.flatnonzero(_astray(a, b, over, (arcs, guess), retry is _plain))
        if again.size:
            there = [one.of(again) for one in over]
            before = tuple(arc.of(again) for arc in guess)
            _replace(arcs, again, retry(a[again], b[again], there, before))
    lost = int(np.isnan(arcs[0].length).sum())
    if lost:
        raise SolveError(f"no shortest path over the surface in {lost} of {len(a)} samples")
    return arcs


def _replace(arcs: tuple[Arc, ...], again: Numbers, better: tuple[Arc, ...]) -> None:
    """Put what is found in place of what was."""
    found = np.isfinite(better[0].length)
    for to, arc in zip(arcs, better, strict=True):
        for whole, part in zip(to, arc, strict=True):
            whole[again[found]] = part[found]


def _astray(
    a: Array,
    b: Array,
    over: Sequence[Placed],
    found: tuple[Sequence[Arc], Sequence[Arc]],
    checks_side: bool,
) -> Mask:
    """Samples without a path, off its side, or with a longer one than the guess, shape (n,)."""
    arcs, guess = found
    away: Mask = np.isnan(arcs[0].length)
    for one, arc in zip(over, arcs, strict=True):
        if one.surface.sign and not one.surface.is_closed_form and checks_side:
            away |= ~one.surface.on_side(arc.middle)
    if len(over) == 1 and isinstance(over[0].surface, Ellipsoid) and not over[0].surface.sign:
        longer = _length(a, b, over[0], arcs[0]) - _length(a, b, over[0], guess[0])
        away |= longer > _ROUNDING * over[0].surface.size
    return away


def _length(a: Array, b: Array, place: Placed, arc: Arc) -> Array:
    """Whole length of a path over one surface [m], shape (n,)."""
    first, last = place.outwards(arc.start) - a, b - place.outwards(arc.end)
    return np.asarray(np.sqrt(dot(first, first)) + arc.length + np.sqrt(dot(last, last)))


def _plain(a: Array, b: Array, over: Sequence[Placed], arcs: tuple[Arc, ...]) -> tuple[Arc, ...]:
    """From guesses on the nearer side, between what is on either side of a surface."""
    lasts = [one.outwards(arc.end) for one, arc in zip(over, arcs, strict=True)]
    firsts = [one.outwards(arc.start) for one, arc in zip(over, arcs, strict=True)]
    ends = zip(over, (a, *lasts[:-1]), (*firsts[1:], b), strict=True)
    starts = tuple(
        Arc.along(one.surface, *one.surface.plain(one.inwards(begin), one.inwards(end))[1:])
        for one, begin, end in ends
    )
    return shortest(a, b, over, starts)


def _grown(a: Array, b: Array, over: Sequence[Placed], arcs: tuple[Arc, ...]) -> tuple[Arc, ...]:
    """From the great circle of a sphere that becomes the ellipsoid, ends stretched along."""
    if len(over) > 1 or not isinstance(over[0].surface, Ellipsoid):
        return tuple(Arc(*arc[:2], arc.length * np.nan, *arc[3:]) for arc in arcs)
    goal, n = over[0].surface, len(a)
    begin, end = (over[0].inwards(x) / goal.half_axes for x in (a, b))
    turn, origin = np.broadcast_to(np.eye(3), (n, 3, 3)), np.zeros((n, 3))
    size = float(np.prod(goal.half_axes)) ** (1.0 / 3.0)
    before = np.full(3, size)
    guess = Arc(*Ellipsoid(before.tolist()).plain(begin * size, end * size)[1:], begin, end)
    for share in np.linspace(1.0 / _STEPS, 1.0, _STEPS):
        axes = size * (goal.half_axes / size) ** share
        start, along = (value * (axes / before) for value in guess[:2])
        length = guess.length * np.sqrt(dot(along, along))
        place = Placed(Ellipsoid(axes.tolist()), turn, origin)
        stretched = Arc(start, unit(along), length, start, start)
        (guess,) = shortest(begin * axes, end * axes, [place], [stretched])
        before = axes
    return (guess,)
