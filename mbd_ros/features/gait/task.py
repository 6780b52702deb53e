"""The section `gait` of a task file: which periodic motions are searched."""

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
_START_KEYS = ("position", "velocity", "pose", "twist", "internal", "phase")
_MOST_STARTS = 1_000_000  # starts of a grid


@dataclass(frozen=True)
class Grid:
    """Equally spaced values.

    Attributes:
        name: `<joint>.position` or `<joint>.velocity`.
        low: First value.
        high: Last value.
        count: Number of values, both ends included.
    """

    name: str
    low: float
    high: float
    count: int


@dataclass(frozen=True)
class ContinuationTask:
    """Continuation of gaits along a parameter.

    Attributes:
        parameter: `slope`, or `<name of a part>.<argument>`.
        low: Lower end of the range.
        high: Upper end of the range.
        doublings: Largest number of successive period doublings whose branches are followed.
        points: Largest number of points on a branch.
    """

    parameter: str
    low: float
    high: float
    doublings: int = 1
    points: int = 200


@dataclass(frozen=True)
class BasinTask:
    """Basin of attraction of a gait.

    Attributes:
        grid: Values of the start that differ from those of the gait.
        cycles: Number of cycles after which a start counts as undecided.
        near: Distance at which a motion has reached the gait, in units of the state.
    """

    grid: tuple[Grid, ...]
    cycles: int = 60
    near: float = 1.0e-4


@dataclass(frozen=True)
class GaitTask:
    """Search for the periodic motions of a scene.

    Attributes:
        event: Name of the event that ends a cycle; None for the first event that leads back to
            the first phase.
        travel: Joints and `<body>.position.x` along which the motion travels; None finds them.
        cycles: Cycles after which the motion repeats.
        guesses: Entries of `initial` that replace those of the scene.
        search: Grid of guesses.
        longest: Longest duration of a cycle [s].
        integrator: Entry of the integrator.
        step_between: Two frames whose distance at the end of a cycle is the step length; empty
            for the travel.
        continuation: Parameter along which gaits are followed; None for none.
        basin: Starts that are tested for reaching a gait; None for no scan.
        source: Task file, for messages; empty without one.
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


def build_task(site: Site, entries: Any) -> GaitTask:
    """Build the `gait` section of a task file.

    Raises:
        SceneError: An entry is wrong; the message names file, key and what is accepted.
    """
    return gait_task(entries, site.where, site.origin.name)


def gait_task(entries: Any, where: str, source: str = "") -> GaitTask:
    """Build a task from the entries of its section.

    Args:
        entries: Entries by key, the keyword arguments of `_task`.
        where: File and key, for messages.
        source: Task file; empty without one.

    Raises:
        SceneError: An entry is wrong; the message names the key and what is accepted.
    """
    task: GaitTask = schema.call(_task, entries, where, where, source)
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
            if key not in _START_KEYS:
                raise SceneError(
                    f"{where}.guesses[{i}]: unknown key '{key}', accepted: "
                    f"{', '.join(_START_KEYS)}"
                )
    if len(step_between) not in (0, 2):
        raise SceneError(f"{where}.step_between: expected two frames, got {len(step_between)}")
    continuation_task = None
    if continuation is not None:
        inner = f"{where}.continuation"
        continuation_task = schema.call(_continuation, continuation, inner, where)
    basin_task = None
    if basin is not None:
        basin_task = schema.call(_basin, basin, f"{where}.basin", f"{where}.basin")
    return GaitTask(
        event,
        None if travel is None else tuple(travel),
        cycles,
        tuple(guesses),
        _grids(search or {}, f"{where}.search"),
        longest,
        dict(ACCURATE if integrator is None else integrator),
        tuple(step_between),
        continuation_task,
        basin_task,
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
        raise SceneError(f"{where}.continuation: from and to must differ, but both are {to:g}")
    return ContinuationTask(parameter, min(from_, to), max(from_, to), doublings, points)


def _basin(
    where: str, *, grid: Mapping[str, Any], cycles: Count = 60, near: Positive = 1.0e-4
) -> BasinTask:
    if not grid:
        raise SceneError(
            f"{where}.grid: the grid is empty; give values, such as {{JOINT.velocity: [low, high, "
            "21]}"
        )
    return BasinTask(_grids(grid, f"{where}.grid"), cycles, near)


def _grids(entries: Mapping[str, Any], where: str) -> tuple[Grid, ...]:
    grids, size = [], 1
    for name, values in entries.items():
        numbers = schema.value(values, Sequence[float], f"{where}.{name}")
        if len(numbers) != 3 or numbers[2] != int(numbers[2]) or numbers[2] < 1:
            raise SceneError(
                f"{where}.{name}: expected [low, high, number of values], a number > 0"
            )
        if not str(name).endswith((".position", ".velocity")):
            raise SceneError(f"{where}: {name}: expected <joint>.position or <joint>.velocity")
        grids.append(Grid(str(name), numbers[0], numbers[1], int(numbers[2])))
        size *= grids[-1].count
    if size > _MOST_STARTS:
        raise SceneError(
            f"{where}: the grid has {size} starts, but at most {_MOST_STARTS} are accepted"
        )
    return tuple(grids)
