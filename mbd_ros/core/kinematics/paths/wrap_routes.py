"""Which surfaces a path wraps over, and where: a function of the points and poses of now.

Every wrap is taken off the path and tried again on each straight line of its range, until nothing
changes: a line that meets the surface must wrap, the first one; else the line that gets longer by
the least may. Samples that go different ways are parted. Nothing is remembered from state to
state, so that a path has one length in a configuration.

Source: the order of trials is that of OpenSim (A. Seth et al., PLoS Comput. Biol. 14, 2018,
e1006223); lengths are those of shortest paths.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.kinematics.paths.shortest_path import shortest_path
from mbd_ros.core.kinematics.paths.wrap_surface import (
    MUST_WRAP,
    NO_WRAP,
    Arc,
    Mask,
    Numbers,
    Placed,
    Reach,
    Touch,
)
from mbd_ros.core.kinematics.vectors import dot
from mbd_ros.core.state import Array

Held = tuple[tuple[int, ...], ...]  # the wraps on every line between points
_ROUNDS = 8


class Router:
    """Finds the routes of a path in n samples.

    Args:
        points: Points of the path in common axes [m], shape (n, m, 3).
        places: Where they are, one a wrap.
    """

    def __init__(self, points: Array, reaches: Sequence[Reach], places: Sequence[Placed]) -> None:
        self._points = points
        self._reaches = reaches
        self._places = places
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
        arcs = guess if is_solved else shortest_path(a, b, over, guess)
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


class _Solved(NamedTuple):
    """Geodesics of one line between points, for all samples; `known` says for which."""

    known: Mask
    arcs: tuple[Arc, ...]
    ends: tuple[tuple[Array, Array], ...]


def _inserted(held: Held, line: int, place: int, which: int) -> Held:
    if line < 0:
        return held
    here = held[line]
    return (*held[:line], (*here[:place], which, *here[place:]), *held[line + 1 :])


def _longer(touch: Touch, a: Array, b: Array) -> Array:
    """By how much a path gets longer, as near as the guess is, shape (n,)."""
    straight, first = b - a, touch.start - a
    return np.asarray(touch.arc + np.sqrt(dot(first, first)) - np.sqrt(dot(straight, straight)))


def _spread(values: Array, here: Numbers, n: int) -> Array:
    """Values of some samples among zeros for the others."""
    if len(here) == n:
        return values
    whole = np.zeros((n, *values.shape[1:]))
    whole[here] = values
    return whole


class Route(NamedTuple):
    """Samples whose path goes over the same surfaces.

    Attributes:
        samples: Their indices.
        held: Wraps in order, for every line between points.
    """

    samples: Numbers
    held: Held
