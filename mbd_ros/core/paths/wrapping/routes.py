"""Which surfaces a path wraps over, and where: a function of the points and poses of now.

Every wrap is taken off the path and tried again on each straight line of its range, until nothing
changes: a line that meets the surface must wrap, the first one; else the line that gets longer by
the least may. Samples that go different ways are parted. Nothing is remembered from state to
state, so that a path has one length in a configuration.

Source: the order of trials is that of OpenSim (A. Seth et al., PLoS Comput. Biol. 14, 2018,
e1006223); lengths are those of shortest paths.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.paths.wrapping.arcs import Arc, Placed
from mbd_ros.core.paths.wrapping.chain import shortest
from mbd_ros.core.paths.wrapping.ellipsoid import Ellipsoid
from mbd_ros.core.paths.wrapping.surface import (
    MUST_WRAP,
    NO_WRAP,
    Mask,
    Numbers,
    Surface,
    Touch,
    dot,
    unit,
)
from mbd_ros.core.state import Array
from mbd_ros.errors import SolveError

# Which geodesic a search ends at: on the side that is asked for, and a shortest one.

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


Held = tuple[tuple[int, ...], ...]  # the wraps on every line between points
_ROUNDS = 8


class Reach(NamedTuple):
    """A surface, and the points between which it acts.

    Attributes:
        surface: The surface.
        first: Index of the first point.
        last: Index of the last one.
    """

    surface: Surface
    first: int
    last: int


class Route(NamedTuple):
    """Samples whose path goes over the same surfaces.

    Attributes:
        samples: Their indices.
        held: Wraps in order, for every line between points.
    """

    samples: Numbers
    held: Held


class _Solved(NamedTuple):
    """Geodesics of one line between points, for all samples; `known` says for which."""

    known: Mask
    arcs: tuple[Arc, ...]
    ends: tuple[tuple[Array, Array], ...]


class Router:
    """Finds the routes of a path in n samples.

    Args:
        points: Points of the path in common axes [m], shape (n, m, 3).
        reaches: Its wraps.
        places: Where they are, one a wrap.
    """

    def __init__(self, points: Array, reaches: Sequence[Reach], places: Sequence[Placed]) -> None:
        self._points, self._reaches, self._places = points, reaches, places
        self._solved: dict[tuple[int, tuple[int, ...]], _Solved] = {}

    def routes(self) -> list[Route]:
        """All of them; every sample is in one."""
        n, count, _ = self._points.shape
        free: Held = ((),) * (count - 1)
        return list(self._settled(np.arange(n), free, ()))

    def corners(self, route: Route, line: int) -> tuple[tuple[Arc, ...], list[Array]]:
        """Geodesics of a route between two points; begins and ends of the straight lines."""
        arcs, ends = self._geodesics(route.samples, line, route.held[line])
        points = self._points[route.samples]
        return arcs, [points[:, line], *(x for pair in ends for x in pair), points[:, line + 1]]

    def _settled(self, samples: Numbers, held: Held, past: tuple[Held, ...]) -> Iterator[Route]:
        """Try wraps in turn until a whole round changes nothing, or has been there before."""
        count, trial = len(self._reaches), len(past)
        past = (*past, held)
        calm = trial >= count and len(set(past[-count - 1 :])) == 1
        again = trial > count and held in past[trial % count : -1 : count]
        if calm or (count == 1 and trial):
            yield Route(samples, held)
        elif again or trial == _ROUNDS * count:
            yield Route(samples, max(past[-count:], key=lambda one: sum(map(len, one))))
        else:
            for part, ways in self._tried(samples, held, trial % count):
                yield from self._settled(part, ways, past)

    def _tried(self, samples: Numbers, held: Held, which: int) -> Iterator[tuple[Numbers, Held]]:
        """Take a wrap off, leave the others where they are, and put it where it belongs."""
        others = tuple(tuple(w for w in line if w != which) for line in held)
        choice, starts = self._choice(samples, held, which)
        for one in np.unique(choice):
            here = choice == one
            part = samples[here]
            line, place = divmod(int(one), len(self._reaches) + 1) if one >= 0 else (-1, 0)
            ways = _inserted(others, line, place, which)
            changed = [i for i, (a, b) in enumerate(zip(held, ways, strict=True)) if a != b]
            for i in changed:
                guess = starts[int(one)].of(here) if i == line else None
                self._press(part, i, held[i], ways[i], which, guess)
            yield from self._lifted(part, ways, changed)

    def _lifted(
        self, samples: Numbers, held: Held, lines: Sequence[int]
    ) -> Iterator[tuple[Numbers, Held]]:
        """Leave out wraps that the path would leave: their geodesics have negative lengths."""
        rest = [line for line in lines if held[line]]
        if not rest:
            yield samples, held
            return
        line, *following = rest
        arcs, _ = self._geodesics(samples, line, held[line])
        off = np.stack([arc.length < 0.0 for arc in arcs], axis=-1)
        for pattern in np.unique(off, axis=0):
            here = (off == pattern).all(axis=-1)
            part = samples[here]
            left = tuple(w for w, gone in zip(held[line], pattern, strict=True) if not gone)
            if left and pattern.any():
                kept = [arc.of(here) for arc, gone in zip(arcs, pattern, strict=True) if not gone]
                self._store(part, line, left, tuple(kept))
            ways = (*held[:line], left, *held[line + 1 :])
            yield from self._lifted(part, ways, rest if pattern.any() else following)

    def _choice(self, samples: Numbers, held: Held, which: int) -> tuple[Numbers, dict[int, Arc]]:
        """Line and place in it of every sample as one number, -1 without a wrap; guesses."""
        reach, place, n = self._reaches[which], self._places[which].of(samples), len(samples)
        choice, least = np.full(n, -1), np.full(n, np.inf)
        starts: dict[int, Arc] = {}
        ways = [
            (line * (len(self._reaches) + 1) + i, place.inwards(begin), place.inwards(end))
            for line in range(reach.first, reach.last)
            for i, (begin, end) in enumerate(self._straight(samples, held, line, which))
        ]
        if not ways:
            return choice, starts
        numbers, *ends = zip(*ways, strict=True)
        codes = reach.surface.meets(*(np.concatenate(end) for end in ends)).reshape(-1, n)
        for number, a, b, code in zip(numbers, *ends, codes, strict=True):
            here = np.flatnonzero((code != NO_WRAP) & (least >= 0.0))
            if not here.size:
                continue
            touch = reach.surface.touch(a[here], b[here], code[here])
            cost = np.where(touch.code == MUST_WRAP, -1.0, _longer(touch, a[here], b[here]))
            cost = np.where(touch.code == NO_WRAP, np.inf, cost)
            start = Arc.along(reach.surface, *touch[1:])
            starts[number] = Arc(*(_spread(value, here, n) for value in start))
            nearer = here[cost < least[here]]
            choice[nearer] = number
            least[here] = np.minimum(cost, least[here])
        return choice, starts

    def _straight(
        self, samples: Numbers, held: Held, line: int, which: int
    ) -> list[tuple[Array, Array]]:
        """Ends of the straight lines between two points, less those at one wrap."""
        _, ends = self._geodesics(samples, line, held[line])
        ends = tuple(end for end, w in zip(ends, held[line], strict=True) if w != which)
        begins = [self._points[samples, line], *(last for _, last in ends)]
        finishes = [*(first for first, _ in ends), self._points[samples, line + 1]]
        return list(zip(begins, finishes, strict=True))

    def _press(
        self,
        samples: Numbers,
        line: int,
        before: tuple[int, ...],
        wraps: tuple[int, ...],
        which: int,
        guess: Arc | None,
    ) -> None:
        """Solve a line with a wrap more or less."""
        if (line, wraps) in self._solved:
            new = ~self._solved[line, wraps].known[samples]
            samples, guess = samples[new], None if guess is None else guess.of(new)
        if not wraps or not samples.size:
            return
        arcs = dict(zip(before, self._geodesics(samples, line, before)[0], strict=True))
        if guess is not None:
            arcs[which] = guess
        alone = (
            guess is not None and len(wraps) == 1 and self._places[which].surface.is_closed_form
        )
        self._store(samples, line, wraps, tuple(arcs[w] for w in wraps), alone)

    def _geodesics(
        self, samples: Numbers, line: int, wraps: tuple[int, ...]
    ) -> tuple[tuple[Arc, ...], tuple[tuple[Array, Array], ...]]:
        """Geodesics of a line and their ends in common axes, for some samples."""
        if not wraps:
            return (), ()
        solved = self._solved[line, wraps]
        arcs = tuple(arc.of(samples) for arc in solved.arcs)
        return arcs, tuple((first[samples], last[samples]) for first, last in solved.ends)

    def _store(
        self,
        samples: Numbers,
        line: int,
        wraps: tuple[int, ...],
        guess: tuple[Arc, ...],
        is_solved: bool = False,
    ) -> None:
        a, b = self._points[samples, line], self._points[samples, line + 1]
        over = [self._places[w].of(samples) for w in wraps]
        arcs = guess if is_solved else solved(a, b, over, guess)
        ends = [
            (one.outwards(arc.start), one.outwards(arc.end))
            for one, arc in zip(over, arcs, strict=True)
        ]
        n = len(self._points)
        if (line, wraps) not in self._solved:
            empty = tuple(Arc(*(np.zeros((n, *x.shape[1:])) for x in arc)) for arc in arcs)
            none = tuple((np.zeros((n, 3)), np.zeros((n, 3))) for _ in wraps)
            self._solved[line, wraps] = _Solved(np.zeros(n, dtype=bool), empty, none)
        store = self._solved[line, wraps]
        store.known[samples] = True
        for whole, part in zip((*store.arcs, *store.ends), (*arcs, *ends), strict=True):
            for to, value in zip(whole, part, strict=True):
                to[samples] = value


def _inserted(held: Held, line: int, place: int, which: int) -> Held:
    if line < 0:
        return held
    here = held[line]
    return (*held[:line], (*here[:place], which, *here[place:]), *held[line + 1 :])


def _spread(values: Array, here: Numbers, n: int) -> Array:
    """Values of some samples among zeros for the others."""
    if len(here) == n:
        return values
    whole = np.zeros((n, *values.shape[1:]))
    whole[here] = values
    return whole


def _longer(touch: Touch, a: Array, b: Array) -> Array:
    """By how much a path gets longer, as near as the guess is, shape (n,)."""
    straight, first = b - a, touch.start - a
    return np.asarray(touch.arc + np.sqrt(dot(first, first)) - np.sqrt(dot(straight, straight)))
