"""Continuation of gaits along a parameter by pseudo-arclength, with their bifurcations.

Folds, period doublings and torus bifurcations are located where their test functions change sign.
From a doubling, the branch of twice the period is followed as well.
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

_FIRST = 0.02  # first step, in units of state and range
_LONGEST, _SHORTEST = 0.1, 1.0e-6  # steps
_PROBE = 1.0e-4  # of the range: step of the difference quotient by the parameter
_CORRECTIONS = 16  # of a point, at most
_MOST_DERIVATIVES = 4  # evaluations of the derivatives of a point, at most
_GAIN = 0.5  # of a correction; with less gain, derivatives are evaluated again
_LOCATED = 1.0e-9  # of a step: accuracy of a zero of a test function
_TRIES = 6  # steps onto a doubled branch
_FIRST_DOUBLED = 2.0e-3  # of the state: the first of them
_APART = 1.0e-5  # of the state: a smaller residual is a motion that repeats after fewer cycles
_ROUNDING = 1.0e-9  # of the range: rounding of a value that sine and cosine define


@dataclass(frozen=True)
class Continuation:
    """Pseudo-arclength continuation of periodic motions along a parameter.

    The unknowns are the state before the event of the section and the parameter, in units of its
    range. Each point is on a plane across the tangent of the branch, so that folds are passed.

    Source: H. B. Keller, Numerical solution of bifurcation and nonlinear eigenvalue problems,
    in: Applications of Bifurcation Theory, 1977, 359-384.

    Attributes:
        family: Return map for a value of the parameter.
        low: Lower end of the range.
        high: Upper end of the range.
        most: Largest number of points of a branch.
        notice: Callback that receives every new point.
    """

    family: Family
    low: float
    high: float
    most: int = 200
    notice: Callable[[BranchPoint], None] = lambda point: None

    def branch(
        self, start: PeriodicMotion, parameter: float, direction: int, cycles: int = 1
    ) -> Branch:
        """Follow the branch through a motion.

        Args:
            start: Initial motion.
            parameter: Its value of the parameter.
            direction: 1 towards larger values at first, -1 towards smaller ones.
            cycles: Cycles after which the motion repeats.
        """
        guess = np.zeros(len(start.derivative) + 1)
        guess[-1] = float(direction)
        first = self._first_point(start, parameter, guess, cycles)
        return self._follow(first, cycles)

    def follow_doubling(self, at: BranchPoint, cycles: int) -> Branch:
        """Follow the branch of motions that repeat after twice as many cycles.

        Args:
            at: A period doubling on a branch.
            cycles: Cycles after which the motions of that branch repeat.

        Raises:
            SolveError: No such motion was found.
        """
        values, vectors = np.linalg.eig(at.motion.derivative)
        direction = vectors[:, np.abs(values + 1.0).argmin()].real
        direction = np.append(direction, 0.0)
        direction -= direction.dot(at.tangent) * at.tangent  # so that the plane misses this branch
        at = at._replace(tangent=direction / np.linalg.norm(direction), mark="")
        step = _FIRST_DOUBLED
        for _ in range(_TRIES):
            point = self._next(at, step, 2 * cycles, is_aside=True)
            if point is not None and not self._repeats(point, cycles):
                return self._follow(point, 2 * cycles, step, cycles)
            step *= 2.0
        raise SolveError(f"no motion of {2 * cycles} cycles found beside the period doubling")

    def _repeats(self, point: BranchPoint, cycles: int) -> bool:
        """Return whether a motion repeats after fewer cycles."""
        passage = self._map(point.parameter, cycles).passage(point.motion.passage.begin)
        return bool(np.abs(passage.residual).max() < _APART)

    def _follow(
        self, first: BranchPoint, cycles: int, step: float = _FIRST, fewer: int = 0
    ) -> Branch:
        """Follow a branch from a point, until its motions repeat after `fewer` cycles."""
        points = [first]
        self.notice(first)
        while len(points) < self.most:
            point = self._next(points[-1], step, cycles)
            if point is None or (fewer and self._repeats(point, fewer)):
                step *= 0.5
                if step < _SHORTEST:
                    return Branch(tuple(points), cycles, "no motion was found beyond")
                continue
            before, step = points[-1], min(_LONGEST, 2.0 * step)
            if not self.low <= point.parameter <= self.high:
                last = self._at_end(before, point, cycles)
                if last is not None:
                    self._add(points, [*self._marked_points(before, last, cycles), last])
                return Branch(tuple(points), cycles, "end of the range")
            self._add(points, [*self._marked_points(before, point, cycles), point])
        return Branch(tuple(points), cycles, f"{self.most} points")

    def _add(self, points: list[BranchPoint], more: list[BranchPoint]) -> None:
        for point in more:
            points.append(point)
            self.notice(point)

    def _marked_points(
        self, first: BranchPoint, second: BranchPoint, cycles: int
    ) -> list[BranchPoint]:
        """Return the bifurcations between two points."""
        bifurcations = []
        length = self._length(first, second)
        for mark in bifurcations_between(first, second):

            def height(step: float, mark: str = mark) -> float:
                point = self._next(first, step, cycles)
                if point is None:
                    raise SolveError(f"a {mark} could not be located")
                return test_function(mark, point)

            ends = (0.0, test_function(mark, first)), (length, test_function(mark, second))
            try:
                step = sign_change(height, *ends, _LOCATED * length)
                at = self._next(first, step, cycles)
            except MbdError:
                at = None
            if at is not None:
                bifurcations.append((step, at._replace(mark=mark)))
        return [point for _, point in sorted(bifurcations, key=lambda pair: pair[0])]

    def _length(self, first: BranchPoint, second: BranchPoint) -> float:
        """Return the step from a point to the plane of another one."""
        map_ = self.family(first.parameter)
        difference = map_.flow.minus(second.motion.passage.begin, first.motion.passage.begin)
        displacement = np.append(difference, (second.parameter - first.parameter) / self._range)
        return float(displacement.dot(first.tangent))

    def _at_end(self, last: BranchPoint, beyond: BranchPoint, cycles: int) -> BranchPoint | None:
        """Return the point at the end of the range, between two others; None if there is none."""
        value = self.low if beyond.parameter < self.low else self.high
        map_ = self.family(value).repeated(cycles)
        part = (value - last.parameter) / (beyond.parameter - last.parameter)
        y = _between(map_, last.motion.passage.begin, beyond.motion.passage.begin, part)
        try:
            motion = newton(map_, map_.passage(y))
            return self._first_point(motion, value, beyond.tangent, cycles)
        except (FallError, SolveError):
            return None

    @property
    def _range(self) -> float:
        return self.high - self.low

    def _next(
        self, at: BranchPoint, step: float, cycles: int, *, is_aside: bool = False
    ) -> BranchPoint | None:
        """Return the next point on the plane across the tangent; None where there is none.

        Newton's method uses the derivatives of the point before, with Broyden's updates, because a
        derivative costs as much as many passages. Derivatives are evaluated again where a
        correction gains little, and where the step leads off the branch.
        """
        parameter = at.parameter + step * at.tangent[-1] * self._range
        system, renewals = np.vstack((at.slopes, at.tangent)), 0
        try:
            flow = self._map(parameter, cycles).flow
            y = flow.plus(at.motion.passage.begin, step * at.tangent[:-1])
            passage = self._map(parameter, cycles).passage(y)
            residual = self._equation_residual(at, step, passage, parameter)
            if is_aside:
                slopes, _ = self._slopes(passage, parameter, cycles)
                system = np.vstack((slopes, at.tangent))
            for _ in range(_CORRECTIONS):
                if is_closed(passage) and abs(residual[-1]) < _LOCATED:
                    return self._branch_point(at, passage, parameter, cycles)
                change = np.asarray(np.linalg.solve(system, -residual), dtype=np.float64)
                parameter += change[-1] * self._range
                passage = self._map(parameter, cycles).passage(
                    flow.plus(passage.begin, change[:-1])
                )
                last = residual
                residual = self._equation_residual(at, step, passage, parameter)
                if np.linalg.norm(residual) < _GAIN * np.linalg.norm(last):
                    error = residual - last - system.dot(change)
                    system += np.outer(error, change) / change.dot(change)
                elif is_accepted(passage) and abs(residual[-1]) < _LOCATED:
                    return self._branch_point(at, passage, parameter, cycles)
                elif renewals == _MOST_DERIVATIVES:
                    return None
                else:
                    slopes, _ = self._slopes(passage, parameter, cycles)
                    system, renewals = np.vstack((slopes, at.tangent)), renewals + 1
        except (FallError, SolveError, np.linalg.LinAlgError):
            return None
        return None

    def _branch_point(
        self, at: BranchPoint, passage: Passage, parameter: float, cycles: int
    ) -> BranchPoint:
        """Return the point of a passage, with new derivatives."""
        slopes, derivative = self._slopes(passage, parameter, cycles)
        motion = PeriodicMotion(passage, derivative, multipliers(derivative))
        return BranchPoint(parameter, motion, _tangent(slopes, at.tangent), slopes)

    def _map(self, parameter: float, cycles: int) -> ReturnMap:
        return self.family(parameter).repeated(cycles)

    def _equation_residual(
        self, at: BranchPoint, step: float, passage: Passage, parameter: float
    ) -> Array:
        """Return the residuals of the return map and of the plane, shape (n + 1,)."""
        flow = self.family(parameter).flow
        difference = flow.minus(passage.begin, at.motion.passage.begin)
        displacement = np.append(difference, (parameter - at.parameter) / self._range)
        return np.append(passage.residual, float(displacement.dot(at.tangent)) - step)

    def _first_point(
        self, motion: PeriodicMotion, parameter: float, guess: Array, cycles: int
    ) -> BranchPoint:
        slopes, _ = self._slopes(motion.passage, parameter, cycles, motion.derivative)
        return BranchPoint(parameter, motion, _tangent(slopes, guess), slopes)

    def _slopes(
        self, passage: Passage, parameter: float, cycles: int, derivative: Array | None = None
    ) -> tuple[Array, Array]:
        """Return the derivatives of the residual, shape (n, n + 1), and of the map, (n, n)."""
        if derivative is None:
            derivative = self.family(parameter).repeated(cycles).derivative(passage)
        ends = []
        for side in (1.0, -1.0):
            map_ = self.family(parameter + side * _PROBE * self._range).repeated(cycles)
            ends.append(map_.passage(passage.begin).residual)
        by_parameter = (ends[0] - ends[1]) / (2.0 * _PROBE)
        return np.column_stack((derivative - np.eye(len(derivative)), by_parameter)), derivative


class BranchPoint(NamedTuple):
    """A periodic motion at one value of a parameter.

    Attributes:
        parameter: Value of the parameter.
        motion: The motion.
        tangent: Direction of the branch, of length 1, shape (n + 1,): in the state before the
            event of the section, then in the parameter in units of its range.
        slopes: Derivative of the residual by the same, shape (n, n + 1).
        mark: Kind of bifurcation; empty for an ordinary point.
    """

    parameter: float
    motion: PeriodicMotion
    tangent: Array
    slopes: Array
    mark: str = ""


class Branch(NamedTuple):
    """Periodic motions along a parameter.

    Attributes:
        points: Points in the order of the branch.
        cycles: Cycles after which the motions repeat.
        ended: Reason why the branch ends.
    """

    points: tuple[BranchPoint, ...]
    cycles: int
    ended: str

    @property
    def bifurcations(self) -> tuple[BranchPoint, ...]:
        """Bifurcations on the branch."""
        return tuple(point for point in self.points if point.mark)


def bifurcations_between(first: BranchPoint, second: BranchPoint) -> Iterator[str]:
    """Yield the kinds of bifurcations between two points: folds, doublings, tori."""
    for mark in (FOLD, DOUBLING, TORUS):
        if test_function(mark, first) * test_function(mark, second) < 0.0:
            yield mark


def test_function(mark: str, point: BranchPoint) -> float:
    """Return the test function of a kind of bifurcation, which changes its sign there.

    Args:
        mark: For a fold, the function is the direction of the parameter. For a doubling, it is
            prod (1 + m) over the multipliers m. For a torus, it is |m|^2 - 1 of the pair of
            complex multipliers that is nearest to the unit circle.

    Source: Y. Kuznetsov, Elements of Applied Bifurcation Theory, 2004, ch. 5 and 10.
    """
    m = point.motion.multipliers
    if mark == FOLD:
        return float(point.tangent[-1])
    if mark == DOUBLING:
        return float(np.prod(1.0 + m).real)
    pairs = np.abs(m[m.imag > 0.0]) ** 2 - 1.0
    return float(pairs[np.abs(pairs).argmin()]) if len(pairs) else 0.0


def _between(map_: ReturnMap, first: State, second: State, part: float) -> State:
    """Interpolate between two states."""
    return map_.flow.plus(first, part * map_.flow.minus(second, first))


def _tangent(slopes: Array, reference: Array) -> Array:
    """Return the null direction of the slopes, on the side of a reference."""
    direction: Array = np.linalg.svd(slopes)[2][-1]
    return direction if direction.dot(reference) >= 0.0 else -direction


def follow_branches(
    family: SceneFamily, gait: Gait, number: int, options: ContinuationTask, say: Say
) -> Iterator[NamedBranch]:
    """Follow the branch through a gait, and the branches of twice the period that leave it.

    Args:
        family: Return maps along the parameter.
        gait: The gait.
        number: Number of the gait, from 1 on.
        options: Options of the continuation.
        say: Receives a line for each doubled branch that is not found.

    Raises:
        SceneError: The value of the parameter in the scene is outside the range.
    """
    value = scene_value(family, options)
    maps = family.of(gait.section, gait.travel)
    continuation = Continuation(maps, options.low, options.high, options.points)
    cycles = family.task.cycles
    up = continuation.branch(gait.motion, value, 1, cycles)
    down = continuation.branch(gait.motion, value, -1, cycles)
    points = (*reversed(down.points[1:]), *up.points)
    joined = Branch(points, cycles, " and ".join(dict.fromkeys((down.ended, up.ended))))
    waiting = [(NamedBranch(joined, number, f"gait {number}"), 0)]
    while waiting:
        named, level = waiting.pop(0)
        yield named
        for bifurcation in named.branch.bifurcations:
            if bifurcation.mark != DOUBLING or level >= options.doublings:
                continue
            try:
                branch = continuation.follow_doubling(bifurcation, named.branch.cycles)
            except SolveError as error:
                say(f"{named.label}: {error}")
                continue
            label = f"{named.label}, doubled at {bifurcation.parameter:.9g}"
            waiting.append((NamedBranch(branch, number, label), level + 1))


class NamedBranch(NamedTuple):
    """A branch and its origin.

    Attributes:
        branch: The branch.
        gait: Number of the gait from which it comes, from 1 on.
        label: Description of its origin, for people.
    """

    branch: Branch
    gait: int
    label: str


def scene_value(family: SceneFamily, options: ContinuationTask) -> float:
    """Return the value of the parameter in the given scene.

    Raises:
        SceneError: It is not a number in the scene, or outside the range.
    """
    value = family.value()
    where = f"{family.task.source or family.scene.name}: gait.continuation"
    if value is None:
        scene = family.scene
        place, path = found_place(Origin(title=where), places_of(scene), options.parameter)
        inner = scene.entries[place.section]
        for key in (*([] if place.at is None else [place.at]), *path):
            inner = inner.get(key) if isinstance(inner, dict) else inner[key]
        if type(inner) not in (int, float):
            raise SceneError(
                f"{where}.parameter: {options.parameter} is {inner!r} in the scene; give a "
                "parameter that is a number there"
            )
        value = float(inner)
    slack = _ROUNDING * (options.high - options.low)
    if not options.low - slack <= value <= options.high + slack:
        raise SceneError(
            f"{where}: {options.parameter} is {value:.9g} in the scene, outside "
            f"{options.low:g} .. {options.high:g}; extend the range to include it"
        )
    return min(max(value, options.low), options.high)


def branch_lines(named: NamedBranch, parameter: str) -> Iterator[str]:
    """Yield lines about a branch: its ends, its bifurcations, and where it is stable."""
    points = named.branch.points
    first, last = points[0].parameter, points[-1].parameter
    cycles = named.branch.cycles
    yield (
        f"branch of {named.label}: {parameter} {first:.9g} .. {last:.9g}, {len(points)} points, "
        f"repeats after {cycles} cycle{'s' * (cycles > 1)}; {named.branch.ended}"
    )
    for begin, end in stable_stretches(points):
        yield f"  stable for {parameter} {begin:.9g} .. {end:.9g}"
    for bifurcation in named.branch.bifurcations:
        yield f"  {bifurcation.mark} at {parameter} = {bifurcation.parameter:.12g}"


def stable_stretches(points: tuple[BranchPoint, ...]) -> list[tuple[float, float]]:
    """Return the ranges of the parameter in which a branch is stable, as far as points tell."""
    stretches: list[tuple[float, float]] = []
    stable = [point.motion.is_stable or bool(point.mark) for point in points]
    begin: int | None = None
    for i, is_stable in enumerate([*stable, False]):
        if is_stable and begin is None:
            begin = i
        elif not is_stable and begin is not None:
            if any(point.motion.is_stable and not point.mark for point in points[begin:i]):
                stretches.append((points[begin].parameter, points[i - 1].parameter))
            begin = None
    return stretches
