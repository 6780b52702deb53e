"""Branches of gaits along a parameter."""

from collections.abc import Iterator
from typing import NamedTuple

from mbd_ros.errors import SceneError, SolveError
from mbd_ros.features.gait.branch import DOUBLING, Branch, BranchPoint
from mbd_ros.features.gait.continuation import Continuation
from mbd_ros.features.gait.flows import SceneFamily
from mbd_ros.features.gait.search import Gait
from mbd_ros.features.gait.task import ContinuationTask
from mbd_ros.jobs.lines import Say
from mbd_ros.scene.numbers import found_place, places_of
from mbd_ros.scene.reading.building import Origin

_ROUNDING = 1.0e-9  # of the range: a value that a scene states by sine and cosine


class NamedBranch(NamedTuple):
    """A branch and its origin.

    Attributes:
        branch: The branch.
        gait: Number of the gait from which it comes, from 1 on.
        of: What it is, for people.
    """

    branch: Branch
    gait: int
    of: str


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
