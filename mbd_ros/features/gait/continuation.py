"""Branches of gaits along a parameter, by pseudo-arclength, and what changes along them.

Folds, period doublings and torus bifurcations are located where their test functions change sign;
from a doubling the branch of twice the period is followed, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array, State
from mbd_ros.errors import FallError, MbdError, SceneError, SolveError
from mbd_ros.features.gait.periodic import (
    Passage,
    PeriodicMotion,
    ReturnMap,
    is_accepted,
    is_closed,
    multipliers,
    newton,
)
from mbd_ros.features.gait.search import Gait, SceneFamily
from mbd_ros.features.gait.task import ContinuationTask
from mbd_ros.jobs.progress import Say
from mbd_ros.methods.events.crossings import sign_change
from mbd_ros.scene.origin import Origin
from mbd_ros.scene.variants import found_place, places_of

DOUBLING, FOLD, TORUS = "period doubling", "fold", "torus bifurcation"
Family = Callable[[float], ReturnMap]
"""The return map at a value of the parameter."""

_FIRST = 0.02  # step, in units of state and range
_LONGEST, _SHORTEST = 0.1, 1.0e-6  # steps
_PROBE = 1.0e-4  # of the range: difference by the parameter
_CORRECTIONS = 16  # of a point, at most
_RENEWALS = 4  # of its derivatives, at most
_GAIN = 0.5  # of a correction, below which derivatives are computed anew
_LOCATED = 1.0e-9  # of a step: where a test function is zero
_TRIES = 6  # steps onto a doubled branch
_ASIDE = 2.0e-3  # of the state: the first of them
_APART = 1.0e-5  # of the state: a motion that repeats after fewer cycles
_ROUNDING = 1.0e-9  # of the range: a value that a scene states by sine and cosine


@dataclass(frozen=True)
class Continuation:
    """Follows periodic motions along a parameter.

    The unknowns are the state before the event of the section and the parameter, in units of its
    range; each point is on a plane across the tangent of the branch, so that folds are passed.

    Source: H. B. Keller, Numerical solution of bifurcation and nonlinear eigenvalue problems,
    in: Applications of Bifurcation Theory, 1977, 359-384.

    Attributes:
        family: The return map at a value of the parameter.
        most: Points of one branch.
        notice: Is called with every new point.
    """

    family: Family
    low: float
    high: float
    most: int = 200
    notice: Callable[[BranchPoint], None] = lambda point: None

    def branch(self, start: PeriodicMotion, parameter: float, way: int, cycles: int = 1) -> Branch:
        """The branch through a motion.

        Args:
            start: Motion to begin with.
            parameter: Its value of the parameter.
            way: 1 to larger values, -1 to smaller ones, at first.
            cycles: After how many it repeats.
        """
        guess = np.zeros(len(start.derivative) + 1)
        guess[-1] = float(way)
        first = self._point(start, parameter, guess, cycles)
        return self._followed(first, cycles)

    def doubled(self, at: BranchPoint, cycles: int) -> Branch:
        """The branch of motions that repeat after twice as many cycles.

        Args:
            at: A doubling on a branch.
            cycles: After how many the motions of that branch repeat.

        Raises:
            SolveError: No motion was found beside it.
        """
        values, vectors = np.linalg.eig(at.motion.derivative)
        aside = vectors[:, np.abs(values + 1.0).argmin()].real
        aside = np.append(aside, 0.0)
        aside -= aside.dot(at.tangent) * at.tangent  # or the plane would meet the old branch, too
        at = at._replace(tangent=aside / np.linalg.norm(aside), mark="")
        step = _ASIDE
        for _ in range(_TRIES):
            found = self._next(at, step, 2 * cycles, is_aside=True)
            if found is not None and not self._repeats(found, cycles):
                return self._followed(found, 2 * cycles, step, cycles)
            step *= 2.0
        raise SolveError(f"no motion of {2 * cycles} cycles found beside the period doubling")

    def _repeats(self, point: BranchPoint, cycles: int) -> bool:
        """Whether a motion repeats after fewer cycles."""
        passage = self._map(point.parameter, cycles).passage(point.motion.passage.begin)
        return bool(np.abs(passage.residual).max() < _APART)

    def _followed(
        self, first: BranchPoint, cycles: int, step: float = _FIRST, fewer: int = 0
    ) -> Branch:
        """The branch from a point on, which is not that of motions that repeat after fewer."""
        points = [first]
        self.notice(first)
        while len(points) < self.most:
            found = self._next(points[-1], step, cycles)
            if found is None or (fewer and self._repeats(found, fewer)):
                step *= 0.5
                if step < _SHORTEST:
                    return Branch(tuple(points), cycles, "no motion was found beyond")
                continue
            point, before, step = found, points[-1], min(_LONGEST, 2.0 * step)
            if not self.low <= point.parameter <= self.high:
                last = self._at_end(before, point, cycles)
                if last is not None:
                    self._add(points, [*self._marked(before, last, cycles), last])
                return Branch(tuple(points), cycles, "end of the range")
            self._add(points, [*self._marked(before, point, cycles), point])
        return Branch(tuple(points), cycles, f"{self.most} points")

    def _add(self, points: list[BranchPoint], more: list[BranchPoint]) -> None:
        for point in more:
            points.append(point)
            self.notice(point)

    def _marked(self, one: BranchPoint, other: BranchPoint, cycles: int) -> list[BranchPoint]:
        """The points between two others at which something happens."""
        found = []
        length = self._length(one, other)
        for mark in changes(one, other):

            def height(step: float, mark: str = mark) -> float:
                point = self._next(one, step, cycles)
                if point is None:
                    raise SolveError(f"a {mark} could not be located")
                return test(mark, point)

            ends = (0.0, test(mark, one)), (length, test(mark, other))
            try:
                step = sign_change(height, *ends, _LOCATED * length)
                at = self._next(one, step, cycles)
            except MbdError:
                at = None
            if at is not None:
                found.append((step, at._replace(mark=mark)))
        return [point for _, point in sorted(found, key=lambda pair: pair[0])]

    def _length(self, one: BranchPoint, other: BranchPoint) -> float:
        """Step from one point whose plane the other one is on."""
        way = self.family(one.parameter)
        apart = way.flow.minus(other.motion.passage.begin, one.motion.passage.begin)
        moved = np.append(apart, (other.parameter - one.parameter) / self._range)
        return float(moved.dot(one.tangent))

    def _at_end(self, one: BranchPoint, beyond: BranchPoint, cycles: int) -> BranchPoint | None:
        """The point at the end of the range, between two others; None where it is not found."""
        value = self.low if beyond.parameter < self.low else self.high
        way = self.family(value).repeated(cycles)
        part = (value - one.parameter) / (beyond.parameter - one.parameter)
        y = _between(way, one.motion.passage.begin, beyond.motion.passage.begin, part)
        try:
            motion = newton(way, way.passage(y))
            return self._point(motion, value, beyond.tangent, cycles)
        except (FallError, SolveError):
            return None

    @property
    def _range(self) -> float:
        return self.high - self.low

    def _next(
        self, at: BranchPoint, step: float, cycles: int, *, is_aside: bool = False
    ) -> BranchPoint | None:
        """The point on the plane across the tangent, a step away; None where there is none.

        Newton's method with the derivatives of the point before it, which Broyden's updates keep
        near those of the guesses: a derivative costs as much as many passages. Where that gains
        nothing they are computed anew, and where the step leads off the branch.
        """
        parameter = at.parameter + step * at.tangent[-1] * self._range
        system, renewed = np.vstack((at.slopes, at.tangent)), 0
        try:
            flow = self._map(parameter, cycles).flow
            y = flow.plus(at.motion.passage.begin, step * at.tangent[:-1])
            passage = self._map(parameter, cycles).passage(y)
            miss = self._miss(at, step, passage, parameter)
            if is_aside:
                slopes, _ = self._slopes(passage, parameter, cycles)
                system = np.vstack((slopes, at.tangent))
            for _ in range(_CORRECTIONS):
                if is_closed(passage) and abs(miss[-1]) < _LOCATED:
                    return self._arrived(at, passage, parameter, cycles)
                change = np.asarray(np.linalg.solve(system, -miss), dtype=np.float64)
                parameter += change[-1] * self._range
                passage = self._map(parameter, cycles).passage(
                    flow.plus(passage.begin, change[:-1])
                )
                miss, last = self._miss(at, step, passage, parameter), miss
                if np.linalg.norm(miss) < _GAIN * np.linalg.norm(last):
                    error = miss - last - system.dot(change)
                    system += np.outer(error, change) / change.dot(change)
                elif is_accepted(passage) and abs(miss[-1]) < _LOCATED:
                    return self._arrived(at, passage, parameter, cycles)
                elif renewed == _RENEWALS:
                    return None
                else:
                    slopes, _ = self._slopes(passage, parameter, cycles)
                    system, renewed = np.vstack((slopes, at.tangent)), renewed + 1
        except (FallError, SolveError, np.linalg.LinAlgError):
            return None
        return None

    def _arrived(
        self, at: BranchPoint, passage: Passage, parameter: float, cycles: int
    ) -> BranchPoint:
        slopes, derivative = self._slopes(passage, parameter, cycles)
        motion = PeriodicMotion(passage, derivative, multipliers(derivative))
        return BranchPoint(parameter, motion, _tangent(slopes, at.tangent), slopes)

    def _map(self, parameter: float, cycles: int) -> ReturnMap:
        return self.family(parameter).repeated(cycles)

    def _miss(self, at: BranchPoint, step: float, passage: Passage, parameter: float) -> Array:
        """What is left of the return map, then of the plane, shape (n + 1,)."""
        flow = self.family(parameter).flow
        apart = flow.minus(passage.begin, at.motion.passage.begin)
        moved = np.append(apart, (parameter - at.parameter) / self._range)
        return np.append(passage.residual, float(moved.dot(at.tangent)) - step)

    def _point(
        self, motion: PeriodicMotion, parameter: float, guess: Array, cycles: int
    ) -> BranchPoint:
        slopes, _ = self._slopes(motion.passage, parameter, cycles, motion.derivative)
        return BranchPoint(parameter, motion, _tangent(slopes, guess), slopes)

    def _slopes(
        self, passage: Passage, parameter: float, cycles: int, derivative: Array | None = None
    ) -> tuple[Array, Array]:
        """Derivative of the residual by state and parameter, (n, n + 1), and that of the map."""
        if derivative is None:
            derivative = self.family(parameter).repeated(cycles).derivative(passage)
        ends = []
        for side in (1.0, -1.0):
            way = self.family(parameter + side * _PROBE * self._range).repeated(cycles)
            ends.append(way.passage(passage.begin).residual)
        by_parameter = (ends[0] - ends[1]) / (2.0 * _PROBE)
        return np.column_stack((derivative - np.eye(len(derivative)), by_parameter)), derivative


class BranchPoint(NamedTuple):
    """A periodic motion at one value of a parameter.

    Attributes:
        tangent: Direction of the branch: of the state before the event of the section, then of
            the parameter in units of its range; of length one, shape (n + 1,).
        slopes: Derivative of the residual by the same, shape (n, n + 1).
        mark: What happens there; empty for an ordinary point.
    """

    parameter: float
    motion: PeriodicMotion
    tangent: Array
    slopes: Array
    mark: str = ""


class Branch(NamedTuple):
    """Periodic motions along a parameter.

    Attributes:
        points: In the order of the branch.
        cycles: Cycles after which they repeat.
        ended: Why it ends.
    """

    points: tuple[BranchPoint, ...]
    cycles: int
    ended: str

    @property
    def marks(self) -> tuple[BranchPoint, ...]:
        """The points at which something happens."""
        return tuple(point for point in self.points if point.mark)


def changes(one: BranchPoint, other: BranchPoint) -> Iterator[str]:
    """What happens between two points of a branch: folds, doublings, tori."""
    for mark in (FOLD, DOUBLING, TORUS):
        if test(mark, one) * test(mark, other) < 0.0:
            yield mark


def test(mark: str, point: BranchPoint) -> float:
    """A number that changes its sign where something happens.

    Args:
        mark: A fold: the direction of the parameter. A doubling: prod (1 + m) of the multipliers
            m. A torus: |m|^2 - 1 of the pair of complex ones that is nearest to the unit circle.

    Source: Y. Kuznetsov, Elements of Applied Bifurcation Theory, 2004, ch. 5 and 10.
    """
    found = point.motion.multipliers
    if mark == FOLD:
        return float(point.tangent[-1])
    if mark == DOUBLING:
        return float(np.prod(1.0 + found).real)
    pairs = np.abs(found[found.imag > 0.0]) ** 2 - 1.0
    return float(pairs[np.abs(pairs).argmin()]) if len(pairs) else 0.0


def _between(way: ReturnMap, one: State, other: State, part: float) -> State:
    return way.flow.plus(one, part * way.flow.minus(other, one))


def _tangent(slopes: Array, like: Array) -> Array:
    """The direction that the slopes leave free, on the side of another one."""
    direction: Array = np.linalg.svd(slopes)[2][-1]
    return direction if direction.dot(like) >= 0.0 else -direction


def branches_of(
    family: SceneFamily, gait: Gait, number: int, asked: ContinuationTask, say: Say
) -> Iterator[NamedBranch]:
    """The branch through a gait, and those of twice the period that leave it.

    Args:
        family: The return maps along the parameter.
        gait: Where it begins.
        number: Of the gait, from 1 on.
        asked: What is asked.
        say: Is told what happens on the way.

    Raises:
        SceneError: The scene's own value of the parameter is outside the range.
    """
    value = own_value(family, asked)
    maps = family.of(gait.section, gait.travel)
    along = Continuation(maps, asked.low, asked.high, asked.points)
    cycles = family.task.cycles
    up = along.branch(gait.motion, value, 1, cycles)
    down = along.branch(gait.motion, value, -1, cycles)
    points = (*reversed(down.points[1:]), *up.points)
    whole = Branch(points, cycles, " and ".join(dict.fromkeys((down.ended, up.ended))))
    waiting = [(NamedBranch(whole, number, f"gait {number}"), 0)]
    while waiting:
        named, level = waiting.pop(0)
        yield named
        for mark in named.branch.marks:
            if mark.mark != DOUBLING or level >= asked.doublings:
                continue
            try:
                doubled = along.doubled(mark, named.branch.cycles)
            except SolveError as error:
                say(f"{named.of}: {error}")
                continue
            of = f"{named.of}, doubled at {mark.parameter:.9g}"
            waiting.append((NamedBranch(doubled, number, of), level + 1))


class NamedBranch(NamedTuple):
    """A branch and its origin.

    Attributes:
        gait: Number of the gait from which it comes, from 1 on.
        of: What it is, for people.
    """

    branch: Branch
    gait: int
    of: str


def own_value(family: SceneFamily, asked: ContinuationTask) -> float:
    """The value of the parameter in the scene as it is.

    Raises:
        SceneError: It is not one number, or outside the range.
    """
    value = family.value()
    where = f"{family.task.source or family.scene.name}: gait.continuation"
    if value is None:
        scene = family.scene
        place, path = found_place(Origin(title=where), places_of(scene), asked.parameter)
        inner = scene.entries[place.section]
        for key in (*([] if place.at is None else [place.at]), *path):
            inner = inner.get(key) if isinstance(inner, dict) else inner[key]
        if type(inner) not in (int, float):
            raise SceneError(
                f"{where}.parameter: {asked.parameter} is {inner!r} in the scene, accepted: a "
                "number that it states"
            )
        value = float(inner)
    slack = _ROUNDING * (asked.high - asked.low)
    if not asked.low - slack <= value <= asked.high + slack:
        raise SceneError(
            f"{where}: {asked.parameter} is {value:.9g} in the scene, outside {asked.low:g} .. "
            f"{asked.high:g}: the branch begins with the scene"
        )
    return min(max(value, asked.low), asked.high)


def branch_lines(named: NamedBranch, parameter: str) -> Iterator[str]:
    """What is said of a branch: its ends, its marks, where it is stable."""
    points = named.branch.points
    first, last = points[0].parameter, points[-1].parameter
    cycles = named.branch.cycles
    yield (
        f"branch of {named.of}: {parameter} {first:.9g} .. {last:.9g}, {len(points)} points, "
        f"repeats after {cycles} cycle{'s' * (cycles > 1)}; {named.branch.ended}"
    )
    for begin, end in stable_stretches(points):
        yield f"  stable for {parameter} {begin:.9g} .. {end:.9g}"
    for mark in named.branch.marks:
        yield f"  {mark.mark} at {parameter} = {mark.parameter:.12g}"


def stable_stretches(points: tuple[BranchPoint, ...]) -> list[tuple[float, float]]:
    """Values of the parameter between which a branch is stable, as far as marks or points say."""
    found: list[tuple[float, float]] = []
    stable = [point.motion.is_stable or bool(point.mark) for point in points]
    begin: int | None = None
    for i, is_stable in enumerate([*stable, False]):
        if is_stable and begin is None:
            begin = i
        elif not is_stable and begin is not None:
            if any(point.motion.is_stable and not point.mark for point in points[begin:i]):
                found.append((points[begin].parameter, points[i - 1].parameter))
            begin = None
    return found
