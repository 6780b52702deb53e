"""The `gait` section of a task file: which periodic motion is asked of a scene."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

from mbd_ros.core.ranges import Positive, Unit, Unlimited, Within
from mbd_ros.errors import SceneError
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.reading.part_entries import build_part
from mbd_ros.scene.schema import schema

Count = Annotated[int, Within(1, 1_000_000)]
Longest = Annotated[Positive, Unit("s")]
ACCURATE: Mapping[str, Any] = {"type": "dop853", "tolerance": 1.0e-12}
_OF_START = ("position", "velocity", "pose", "twist", "internal", "phase")
_MOST = 1_000_000  # starts of one grid


@dataclass(frozen=True)
class Grid:
    """Values between two others.

    Attributes:
        name: `<joint>.position` or `<joint>.velocity`.
        count: How many, both ends included.
    """

    name: str
    low: float
    high: float
    count: int


@dataclass(frozen=True)
class ContinuationTask:
    """Gaits along a parameter.

    Attributes:
        parameter: `slope`, or `<name of a part>.<argument>`.
        doublings: How many times a branch is left for that of twice the period.
        points: Largest number of points on a branch.
    """

    parameter: str
    low: float
    high: float
    doublings: int = 1
    points: int = 200


@dataclass(frozen=True)
class BasinTask:
    """Which starts lead to the gait.

    Attributes:
        grid: Values of the start that are not those of the gait.
        cycles: After so many a start has come to a gait or has not.
        near: How near a motion has to come, in units of the state.
    """

    grid: tuple[Grid, ...]
    cycles: int = 60
    near: float = 1.0e-4


@dataclass(frozen=True)
class GaitTask:
    """Periodic motions, asked of a scene.

    Attributes:
        event: Name of the event that ends a cycle; None for the first one that leads back into
            the first phase.
        cycles: Cycles after which the motion repeats.
        travel: Joints and `<body>.position.x` along which it moves on; None finds them.
        guesses: Entries of `initial` to begin with, in place of those of the scene.
        search: Grid of guesses.
        longest: Time within which a cycle ends [s].
        integrator: Entry of the method.
        step_between: Two frames whose distance at the end of a cycle is the length of a step;
            empty for the travel.
        continuation: Along which parameter gaits are followed; None for none.
        basin: From which starts a gait is reached; None for no scan.
        source: The file, for messages; empty without one.
    """

    event: str | None = None
    travel: tuple[str, ...] | None = None
    cycles: int = 1
    guesses: tuple[Mapping[str, Any], ...] = ()
    search: tuple[Grid, ...] = ()
    longest: float = 30.0
    integrator: Mapping[str, Any] = field(default_factory=lambda: dict(ACCURATE))
    step_between: tuple[str, ...] = ()
    continuation: ContinuationTask | None = None
    basin: BasinTask | None = None
    source: str = ""


def build_task(site: Site, given: Any) -> GaitTask:
    """The `gait` section of a task file.

    Raises:
        SceneError: Names file, key, what is wrong and what is accepted.
    """
    return gait_task(given, site.where, site.origin.name)


def gait_task(given: Any, where: str, source: str = "") -> GaitTask:
    """The task of some entries.

    Args:
        given: Entries by key, see `_task`.
        where: File and key, for the messages.
        source: The file; empty without one.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    task: GaitTask = schema.call(_task, given, where, where, source)
    return task


def _task(
    where: str,
    source: str,
    *,
    event: str | None = None,
    travel: Sequence[str] | None = None,
    cycles: Count = 1,
    guesses: Sequence[Mapping[str, Any]] = (),
    search: Mapping[str, Any] | None = None,
    longest: Longest = 30.0,
    integrator: Mapping[str, Any] | None = None,
    step_between: Sequence[str] = (),
    continuation: Mapping[str, Any] | None = None,
    basin: Mapping[str, Any] | None = None,
) -> GaitTask:
    if integrator is not None:
        build_part("integrators", integrator, f"{where}.integrator")
    for i, guess in enumerate(guesses):
        for key in guess:
            if key not in _OF_START:
                raise SceneError(
                    f"{where}.guesses[{i}]: unknown key '{key}', accepted: {', '.join(_OF_START)}"
                )
    if len(step_between) not in (0, 2):
        raise SceneError(f"{where}.step_between: expected two frames, got {len(step_between)}")
    along = None
    if continuation is not None:
        along = schema.call(_continuation, continuation, f"{where}.continuation", where)
    scan = None
    if basin is not None:
        scan = schema.call(_basin, basin, f"{where}.basin", f"{where}.basin")
    return GaitTask(
        event,
        None if travel is None else tuple(travel),
        cycles,
        tuple(guesses),
        _grids(search or {}, f"{where}.search"),
        longest,
        dict(ACCURATE if integrator is None else integrator),
        tuple(step_between),
        along,
        scan,
        source,
    )


def _continuation(
    where: str,
    *,
    parameter: str,
    from_: Unlimited,
    to: Unlimited,
    doublings: Annotated[int, Within(0, 5)] = 1,
    points: Count = 200,
) -> ContinuationTask:
    if from_ == to:
        raise SceneError(f"{where}.continuation: from and to are both {to:g}")
    return ContinuationTask(parameter, min(from_, to), max(from_, to), doublings, points)


def _basin(
    where: str, *, grid: Mapping[str, Any], cycles: Count = 60, near: Positive = 1.0e-4
) -> BasinTask:
    if not grid:
        raise SceneError(f"{where}.grid: is empty, expected {{JOINT.velocity: [low, high, 21]}}")
    return BasinTask(_grids(grid, f"{where}.grid"), cycles, near)


def _grids(given: Mapping[str, Any], where: str) -> tuple[Grid, ...]:
    found, size = [], 1
    for name, values in given.items():
        numbers = schema.value(values, Sequence[float], f"{where}.{name}")
        if len(numbers) != 3 or numbers[2] != int(numbers[2]) or numbers[2] < 1:
            raise SceneError(f"{where}.{name}: expected [low, high, number of values]")
        if not str(name).endswith((".position", ".velocity")):
            raise SceneError(f"{where}: {name}: expected <joint>.position or <joint>.velocity")
        found.append(Grid(str(name), numbers[0], numbers[1], int(numbers[2])))
        size *= found[-1].count
    if size > _MOST:
        raise SceneError(f"{where}: {size} starts, accepted: at most {_MOST}")
    return tuple(found)
