"""A path through points and over surfaces: its length, what it pulls at, and how that changes.

At contacts a path that is as short as possible may slide without getting longer, so that slopes
are those of straight lines between points that bodies hold: dl = sum e . (dx_end - dx_begin).
`Router` finds the surfaces that it wraps over, `shortest_path` the points of tangency, and
`wrap_surface` has the geodesics between them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.kinematics.paths.paths import Path, Pull
from mbd_ros.core.kinematics.paths.shortest_path import Chain, link, shortest_path
from mbd_ros.core.kinematics.paths.via_point import ViaPoint, slopes_of
from mbd_ros.core.kinematics.paths.wrap_surface import (
    MUST_WRAP,
    NO_WRAP,
    Arc,
    Mask,
    Numbers,
    Placed,
    Reach,
    Touch,
    Wrap,
)
from mbd_ros.core.kinematics.poses import cross, dot
from mbd_ros.core.kinematics.sampled_kinematics import SampledKinematics
from mbd_ros.core.model.points import Point
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array, State
from mbd_ros.errors import SolveError

ActiveWraps = tuple[tuple[int, ...], ...]  # the wraps on every line between points
_ROUNDS = 8
_POINT = 1.0e-200  # m, a line that has no direction
_DRAWN = 9  # points of a geodesic in a picture


class WrappedPath(Path):
    """Straight lines through points, and shortest paths over surfaces between them.

    Which surfaces a path wraps over depends on the configuration alone, so that no mode keeps it.

    Args:
        points: Two or more, whatever their `within` says.
        wraps: In the order in which they are tried.
        reaches: First and last point of every wrap, as indices of `points`.

    Raises:
        SolveError: From every method, where a geodesic is not found; names the wraps.
    """

    reads = Reads.JACOBIAN

    def __init__(
        self,
        robot: Robot,
        points: Sequence[ViaPoint],
        wraps: Sequence[Wrap],
        reaches: Sequence[tuple[int, int]],
    ) -> None:
        self.points = tuple(points)
        self.wraps = tuple(wraps)
        self.reaches = [
            Reach(wrap.surface, *reach) for wrap, reach in zip(wraps, reaches, strict=True)
        ]
        over = ", ".join(f"{wrap.name} ({type(wrap.surface).__name__.lower()})" for wrap in wraps)
        self.over = " - ".join(point.frame for point in points) + f", around {over}"
        self._nv = int(robot.model.nv)
        self._last: tuple[bytes, Any] = (b"", None)

    def length(self, k: Kinematics, x: State) -> float:
        """The l [m]."""
        return k.search_path(self, x).length

    def measured(self, k: Kinematics, x: State) -> tuple[float, Array]:
        """The l [m] and J, shape (nv,)."""
        length, by_points, by_wraps = k.search_path(self, x)
        slope = k.zeros(self._nv)
        for point, change in zip(self.points, by_points, strict=True):
            if point.moves:
                slope = slope + k.dot(change, point.jacobian(k, x))
        for wrap, change in zip(self.wraps, by_wraps, strict=True):
            if wrap.point.moves and k.any(change):
                slope = slope + k.dot(change, k.spatial_jacobian(wrap.point))
        return length, slope

    def search(self, k: Kinematics, x: State) -> Taut:
        """The taut path at a state: its length, shapes (m, 3) and (wraps, 6) of its slopes.

        Parts ask for lengths, then for slopes: the last answer is kept for the same places.

        Raises:
            SolveError: A geodesic is not found.
        """
        places, points = self._where(k, x)
        key = b"".join([points.tobytes(), *(x.tobytes() for place in places for x in place[1:])])
        last, path = self._last
        if key != last:
            whole = self._taut(points, places)
            path = Taut(float(whole.length[0]), whole.by_points[0], whole.by_wraps[0])
            self._last = key, path
        return path

    def drift(self, k: Kinematics, x: State) -> float:
        """J' v: lines turn and contacts slide as their conditions stay met."""
        places, points = self._where(k, x)
        speeds = [point.velocity(k, x) for point in self.points]
        pushes = [point.acceleration(k, x) for point in self.points]
        motions = [surface_motion(k, wrap.point, wrap.axes) for wrap in self.wraps]
        bent = 0.0
        for line, (wraps, chain) in enumerate(self._chains(points, places)):
            nodes = [(speeds[line], pushes[line], np.zeros(3))]
            at, moved = [places[w] for w in wraps], [motions[w] for w in wraps]
            nodes += contact_rates(chain, at, moved, (speeds[line], speeds[line + 1]))
            nodes += [(speeds[line + 1], pushes[line + 1], np.zeros(3))]
            for straight, a, b in zip(chain.lines, nodes[::2], nodes[1::2], strict=True):
                e, past = straight.direction[0], b[0] - a[0]
                swept = past + b[2] - a[2]
                if straight.length[0] > _POINT:
                    bent += (swept @ past - (e @ swept) * (e @ past)) / straight.length[0]
                    bent += e @ (b[1] - a[1])
        return float(bent)

    def pulls(self, k: Kinematics, x: State) -> tuple[Pull, ...]:
        """At every point and at both ends of every contact, along the lines."""
        places, points = self._where(k, x)
        chains = self._chains(points, places)
        forces = np.zeros((len(self.points), 3))
        pulls = []
        for line, (wraps, chain) in enumerate(chains):
            ways = [straight.direction[0] for straight in chain.lines]
            forces[line] += ways[0]
            forces[line + 1] -= ways[-1]
            for i, w in enumerate(wraps):
                first, last = chain.ends[i]
                frame = self.wraps[w].frame
                pulls.append(Pull(frame, first.point[0], -ways[i]))
                pulls.append(Pull(frame, last.point[0], ways[i + 1]))
        at = zip(self.points, points[0], forces, strict=True)
        return (*(Pull(point.frame, place, force) for point, place, force in at), *pulls)

    def lines(self, k: Kinematics, x: State) -> tuple[Array, ...]:
        """All points, and points along the geodesics between."""
        places, points = self._where(k, x)
        corners = [points[0, 0]]
        for line, (wraps, chain) in enumerate(self._chains(points, places)):
            for w, arc in zip(wraps, chain.arcs, strict=True):
                corners += list(_along(places[w], arc))
            corners.append(points[0, line + 1])
        return (np.array(corners),)

    def corners(self) -> Sequence[ViaPoint]:
        """All points."""
        return self.points

    def sampled(self, k: SampledKinematics) -> tuple[Array, Array]:
        """The l [m] and J of n samples."""
        points = np.stack([point.sampled(k) for point in self.points], axis=1)
        places = [
            Placed(wrap.surface, k.rotation(wrap.point), k.position(wrap.point))
            for wrap in self.wraps
        ]
        length, by_points, by_wraps = self._taut(points, places, k.search)
        slopes = slopes_of(k, self.points, points, by_points)
        wrenches: dict[int, Array] = {}
        for i, wrap in enumerate(self.wraps):
            joint, change = k.carrier(wrap.point), by_wraps[:, i]
            if joint and change.any():
                change[:, 3:] += cross(places[i].origin, change[:, :3])
                wrenches[joint] = wrenches[joint] + change if joint in wrenches else change
        return length, slopes + k.slope(wrenches)

    def _where(self, k: Kinematics, x: State) -> tuple[list[Placed], Array]:
        points = np.array([[point.position(k, x) for point in self.points]])
        return [wrap.placed(k) for wrap in self.wraps], points

    def _taut(self, points: Array, places: list[Placed], search: Any = None) -> Taut:
        try:
            if search is not None:
                found: Taut = search(self, points, places)
                return found
            return taut(points, self.reaches, places)
        except SolveError as error:
            raise self._named(error) from error

    def _chains(self, points: Array, places: list[Placed]) -> list[tuple[tuple[int, ...], Chain]]:
        """Wraps and path of every line between points."""
        router = Router(points, self.reaches, places)
        try:
            (route,) = router.routes()
        except SolveError as error:
            raise self._named(error) from error
        chains = []
        for line, wraps in enumerate(route.active):
            arcs, _ = router.corners(route, line)
            over = [places[w] for w in wraps]
            chains.append((wraps, link(points[:, line], points[:, line + 1], over, arcs)[0]))
        return chains

    def _named(self, error: SolveError) -> SolveError:
        names = ", ".join(wrap.name for wrap in self.wraps)
        return SolveError(f"path around {names}: {error}")


def _along(place: Placed, arc: Arc) -> Array:
    """Points along a geodesic, both ends included, shape (_DRAWN, 3)."""
    starts, ways = np.repeat(arc.start, _DRAWN, axis=0), np.repeat(arc.direction, _DRAWN, axis=0)
    flow = place.surface.flow(starts, ways, np.linspace(0.0, 1.0, _DRAWN) * arc.length)
    return flow.end @ place.rotation[0].T + place.origin[0]


class Route(NamedTuple):
    """Samples whose path goes over the same surfaces.

    Attributes:
        active: Wraps in order, for every line between points.
    """

    samples: Numbers
    active: ActiveWraps


class Router:
    """Which surfaces a path wraps over, and where, in n samples.

    Every wrap is taken off the path and tried again on each straight line of its range, until
    nothing changes: a line that meets the surface must wrap, the first one; else the line that
    gets longer by the least may. Samples that go different ways are parted. Nothing is remembered
    from state to state, so that a path has one length in a configuration. Source: the order of
    trials is that of OpenSim (A. Seth et al., PLoS Comput. Biol. 14 (2018) e1006223); lengths are
    those of shortest paths.

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
        free: ActiveWraps = ((),) * (count - 1)
        return list(self._settled(np.arange(n), free, ()))

    def corners(self, route: Route, line: int) -> tuple[tuple[Arc, ...], list[Array]]:
        """Geodesics of a route between two points; begins and ends of the straight lines."""
        arcs, ends = self._geodesics(route.samples, line, route.active[line])
        points = self._points[route.samples]
        return arcs, [points[:, line], *(x for pair in ends for x in pair), points[:, line + 1]]

    def _settled(
        self, samples: Numbers, active: ActiveWraps, past: tuple[ActiveWraps, ...]
    ) -> Iterator[Route]:
        """Try wraps in turn until a whole round changes nothing, or has been there before."""
        count, trial = len(self._reaches), len(past)
        past = (*past, active)
        calm = trial >= count and len(set(past[-count - 1 :])) == 1
        again = trial > count and active in past[trial % count : -1 : count]
        if calm or (count == 1 and trial):
            yield Route(samples, active)
        elif again or trial == _ROUNDS * count:
            yield Route(
                samples, max(past[-count:], key=lambda candidate: sum(map(len, candidate)))
            )
        else:
            for part, ways in self._tried(samples, active, trial % count):
                yield from self._settled(part, ways, past)

    def _tried(
        self, samples: Numbers, active: ActiveWraps, which: int
    ) -> Iterator[tuple[Numbers, ActiveWraps]]:
        """Take a wrap off, leave the others where they are, and put it where it belongs."""
        others = tuple(tuple(w for w in line if w != which) for line in active)
        choice, starts = self._choice(samples, active, which)
        for place_number in np.unique(choice):
            here = choice == place_number
            part = samples[here]
            line, place = (
                divmod(int(place_number), len(self._reaches) + 1) if place_number >= 0 else (-1, 0)
            )
            ways = _inserted(others, line, place, which)
            changed = [i for i, (a, b) in enumerate(zip(active, ways, strict=True)) if a != b]
            for i in changed:
                guess = starts[int(place_number)].of(here) if i == line else None
                self._press(part, i, active[i], ways[i], which, guess)
            yield from self._lifted(part, ways, changed)

    def _lifted(
        self, samples: Numbers, active: ActiveWraps, lines: Sequence[int]
    ) -> Iterator[tuple[Numbers, ActiveWraps]]:
        """Leave out wraps that the path would leave: their geodesics have negative lengths."""
        rest = [line for line in lines if active[line]]
        if not rest:
            yield samples, active
            return
        line, *following = rest
        arcs, _ = self._geodesics(samples, line, active[line])
        off = np.stack([arc.length < 0.0 for arc in arcs], axis=-1)
        for pattern in np.unique(off, axis=0):
            here = (off == pattern).all(axis=-1)
            part = samples[here]
            left = tuple(w for w, gone in zip(active[line], pattern, strict=True) if not gone)
            if left and pattern.any():
                kept = [arc.of(here) for arc, gone in zip(arcs, pattern, strict=True) if not gone]
                self._store(part, line, left, tuple(kept))
            ways = (*active[:line], left, *active[line + 1 :])
            yield from self._lifted(part, ways, rest if pattern.any() else following)

    def _choice(
        self, samples: Numbers, active: ActiveWraps, which: int
    ) -> tuple[Numbers, dict[int, Arc]]:
        """Line and place in it of every sample as one number, -1 without a wrap; guesses."""
        reach, place, n = self._reaches[which], self._places[which].of(samples), len(samples)
        choice, least = np.full(n, -1), np.full(n, np.inf)
        starts: dict[int, Arc] = {}
        ways = [
            (line * (len(self._reaches) + 1) + i, place.inwards(begin), place.inwards(end))
            for line in range(reach.first, reach.last)
            for i, (begin, end) in enumerate(self._straight(samples, active, line, which))
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
        self, samples: Numbers, active: ActiveWraps, line: int, which: int
    ) -> list[tuple[Array, Array]]:
        """Ends of the straight lines between two points, less those at one wrap."""
        _, ends = self._geodesics(samples, line, active[line])
        ends = tuple(end for end, w in zip(ends, active[line], strict=True) if w != which)
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


def _inserted(active: ActiveWraps, line: int, place: int, which: int) -> ActiveWraps:
    if line < 0:
        return active
    here = active[line]
    return (*active[:line], (*here[:place], which, *here[place:]), *active[line + 1 :])


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


class Taut(NamedTuple):
    """A path of n samples, or of one without their axis.

    Attributes:
        length: [m], shape (n,).
        by_points: Change of the length with every point [-], shape (n, m, 3).
        by_wraps: With the place of every surface: with its origin [-] and with a turn about its
            origin [m], shape (n, wraps, 6).
    """

    length: Any
    by_points: Array
    by_wraps: Array


def taut(points: Array, reaches: Sequence[Reach], places: Sequence[Placed]) -> Taut:
    """The path through points and over surfaces.

    Args:
        points: In common axes [m], shape (n, m, 3).

    Raises:
        SolveError: A geodesic is not found.
    """
    way = points[:, 1:] - points[:, :-1]
    lengths = np.sqrt((way * way).sum(axis=-1))
    e = way / np.where(lengths > 0.0, lengths, 1.0)[..., None]
    by_begin, by_end = -e, e.copy()
    by_wraps = np.zeros((len(points), len(reaches), 6))
    if reaches:
        router = Router(points, reaches, places)
        for route in router.routes():
            for line, wraps in enumerate(route.active):
                if wraps:
                    found = _bent(router, route, line, places, by_wraps)
                    lengths[route.samples, line] = found[0]
                    by_begin[route.samples, line], by_end[route.samples, line] = found[1:]
    by_points = np.zeros(points.shape)
    by_points[:, :-1] = by_begin
    by_points[:, 1:] += by_end
    return Taut(lengths.sum(axis=-1), by_points, by_wraps)


def _bent(
    router: Router, route: Route, line: int, places: Sequence[Placed], by_wraps: Array
) -> tuple[Array, Array, Array]:
    """Length of a line over surfaces and its slopes at both points; adds those at surfaces."""
    samples, wraps = route.samples, route.active[line]
    arcs, corners = router.corners(route, line)
    length = sum(arc.length for arc in arcs)
    ends = []
    for i, (begin, end) in enumerate(zip(corners[::2], corners[1::2], strict=True)):
        way = end - begin
        distance = np.sqrt(dot(way, way))
        e = way / np.where(distance > 0.0, distance, 1.0)[:, None]
        length = length + distance
        ends.append(e)
        for j, corner, sign in ((i - 1, begin, -1.0), (i, end, 1.0)):
            if 0 <= j < len(wraps):
                w = wraps[j]
                arm = corner - places[w].origin[samples]
                by_wraps[samples, w] += sign * np.concatenate((e, cross(arm, e)), axis=-1)
    return np.asarray(length), -ends[0], ends[-1]


def contact_rates(
    chain: Chain,
    places: Sequence[Placed],
    motions: Sequence[SurfaceMotion],
    speeds: tuple[Array, Array],
) -> list[tuple[Array, Array, Array]]:
    """Return for every contact the velocity of the body there, its rate, and the sliding."""
    if not places:
        return []
    fixed_rates, turned = [speeds[0]], []
    for place, motion, ends in zip(places, motions, chain.ends, strict=True):
        rotation = place.rotation[0]
        for contact in ends:
            fixed_rates.append(
                motion.linear[0] + motion.turning[0] @ place.inwards(contact.point)[0]
            )
            turned.append(contact.frame[0] @ (rotation @ motion.turning[0].T))
    fixed_rates.append(speeds[1])
    rates = []
    for i, contact in enumerate(contact for ends in chain.ends for contact in ends):
        straight = chain.lines[(i + 1) // 2]
        e, (a, b) = straight.direction[0], (2 * ((i + 1) // 2), 2 * ((i + 1) // 2) + 1)
        past = fixed_rates[b] - fixed_rates[a]
        turn = (past - e * (e @ past)) / straight.length[0]
        rates.append(contact.frame[0] @ turn + turned[i] @ e)
    unknowns = -np.linalg.solve(chain.slopes[0], np.concatenate(rates))
    contacts = []
    for i, contact in enumerate(contact for ends in chain.ends for contact in ends):
        place, motion = places[i // 2], motions[i // 2]
        slide = contact.moves[0] @ unknowns[4 * (i // 2) : 4 * (i // 2) + 4]
        inside = place.rotation[0].T @ slide
        push = motion.linear[1] + motion.turning[1] @ place.inwards(contact.point)[0]
        contacts.append((fixed_rates[i + 1], push + motion.turning[0] @ inside, slide))
    return contacts


def surface_motion(k: Kinematics, origin: Point, ends: Sequence[Point]) -> SurfaceMotion:
    """How a surface moves at zero joint acceleration, from its origin and ends of its axes."""
    v, a = k.velocity(origin), k.acceleration(origin)
    rates = np.array([k.velocity(axis) - v for axis in ends]).T
    bends = np.array([k.acceleration(axis) - a for axis in ends]).T
    return SurfaceMotion((v, a), (rates, bends))


# How contacts move and slide while the conditions of a shortest path stay met.
class SurfaceMotion(NamedTuple):
    """Velocity and acceleration of a body about a point: those of p are first + second (p)."""

    linear: tuple[Array, Array]
    turning: tuple[Array, Array]
