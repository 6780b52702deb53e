"""The `predict` section of a task file: which motion is asked of a scene, and what is best."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from mbd_ros.core.ranges import LARGEST, SMALLEST, Positive, Unit, Unlimited, Within
from mbd_ros.errors import SceneError
from mbd_ros.features.prediction.smooth_scene import SMOOTH
from mbd_ros.optimal_control.mesh import LARGEST_DEGREE, MOST_INTERVALS
from mbd_ros.optimal_control.problem import Goal, Range
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.locate import find_file

Power = Annotated[int, Within(1, 10)]
Seen = Any  # a name, a list of names, or names with weights


def _powers(of: Seen = None, power: Power = 2) -> dict[str, Any]:
    return {"of": of, "power": power}


def _power(of: Seen = None, smoothing: Annotated[Positive, Unit("W")] = 0.1) -> dict[str, Any]:
    return {"of": of, "smoothing": smoothing}


def _metabolic(
    of: Seen = None,
    basal: bool = True,
    slow_twitch: Annotated[float, Within(0.0, 1.0), Unit("-")] = 0.5,
    specific_tension: Annotated[Positive, Unit("N/m^2")] = 2.5e5,
    smoothing: Annotated[Positive, Unit("-")] = 10.0,
) -> dict[str, Any]:
    return {
        "of": of,
        "basal": basal,
        "slow_twitch": slow_twitch,
        "specific_tension": specific_tension,
        "smoothing": smoothing,
    }


def _time() -> dict[str, Any]:
    return {}


def _speed(of: str, target: Unlimited) -> dict[str, Any]:
    return {"of": of, "target": target}


def _smoothness(of: Seen = None) -> dict[str, Any]:
    return {"of": of}


def _tracking(of: Seen, file: str = "") -> dict[str, Any]:
    return {"of": of, "file": file}


def _integral(of: Seen, power: Power = 1, target: Unlimited = 0.0) -> dict[str, Any]:
    return {"of": of, "power": power, "target": target}


def _value(of: Seen, power: Power = 2, target: Unlimited = 0.0) -> dict[str, Any]:
    return {"of": of, "power": power, "target": target}


def _function(function: Any, at: Literal["integral", "final"] = "integral") -> dict[str, Any]:
    return {"function": function, "at": at}


_KINDS: Mapping[str, Callable[..., dict[str, Any]]] = {
    "effort": _powers,
    "torque": _powers,
    "power": _power,
    "activation": _powers,
    "metabolic": _metabolic,
    "time": _time,
    "speed": _speed,
    "smoothness": _smoothness,
    "tracking": _tracking,
    "integral": _integral,
    "final": _value,
    "function": _function,
}
FREE = "free"
_LASTS = "a number above 0, or [shortest, longest]"
DrivenBy = Literal["scene", "joints", "muscles"]
Scheme = Literal["gauss", "radau", "hermite_simpson"]
Count = Annotated[int, Within(1, 10_000)]
TOLERANCE = 1.0e-7  # of the error between nodes
_OF_RECORDING = 1.0e-5  # which is measured less well than that


@dataclass(frozen=True)
class MeshTask:
    """The first mesh.

    Attributes:
        degree: Points of an interval.
        intervals: Of each phase; None for 10, or 25 a second of a recording.
        refinements: How many times intervals are split at most.
    """

    scheme: Scheme = "gauss"
    degree: Annotated[int, Within(1, LARGEST_DEGREE)] = 5
    intervals: Annotated[int | None, Within(1, MOST_INTERVALS)] = None
    refinements: Annotated[int, Within(0, 30)] = 10


@dataclass(frozen=True)
class PredictTask:
    """A motion that is asked of a scene.

    Attributes:
        phases: What is asked of each phase, in the order of the motion.
        start_free: Whether a state that `start` does not name is free, in place of that of the
            scene.
        periodic: Quantities that end as they begin; empty for none.
        symmetric: Quantity at the end -> quantity at the beginning that has its value.
        travel: Joints that go on where a motion repeats.
        parameters: Unknown numbers of the scene and their ranges.
        mesh: The first mesh.
        tolerance: Of the error between nodes, relative.
        accuracy: Of the conditions of optimality.
        grip: Share of the friction of contacts that phases hold which the motion may use.
        iterations: Largest number of iterations on a mesh.
        guess: Quantity -> values at equal times; straight lines between them.
        guess_file: Motion to begin with; None for straight lines.
        starts: How many guesses are tried, the first one as given, the others at random.
        continuation: Number of the scene -> values, the last one that of the motion.
        muscles: Arguments of the smooth muscles in place of those of the scene; None where these
            stay.
        source: The file, for messages; empty without one.
        recording: Of the motion; None without one.
        driven_by: What drives the scene: what it has, ideal drives in all independent joints, or
            these and its muscles.
    """

    phases: tuple[PhaseTask, ...]
    start_free: bool = False
    periodic: tuple[str, ...] = ()
    symmetric: Mapping[str, str] = field(default_factory=dict)
    travel: tuple[str, ...] = ()
    parameters: Mapping[str, Range] = field(default_factory=dict)
    mesh: MeshTask = field(default_factory=MeshTask)
    tolerance: float = TOLERANCE
    accuracy: float = 1.0e-10
    grip: float = 1.0
    iterations: int = 1000
    guess: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    guess_file: Path | None = None
    starts: int = 1
    continuation: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    muscles: Mapping[str, Any] | None = None
    source: str = ""
    recording: RecordingTask | None = None
    driven_by: DrivenBy = "scene"


@dataclass(frozen=True)
class PhaseTask:
    """What is asked of a phase.

    Attributes:
        phase: Name of a phase of the scene; empty where it has none.
        duration: Shortest and longest [s]; None for that of the recording.
        bounds: Quantity -> range, all the time.
        start: The same at the beginning.
        end: The same at the end.
        goals: Terms of the cost.
    """

    phase: str
    duration: Range | None
    bounds: Mapping[str, Range]
    start: Mapping[str, Range]
    end: Mapping[str, Range]
    goals: tuple[Goal, ...]


@dataclass(frozen=True)
class RecordingTask:
    """A recorded motion, and the loads that were measured with it.

    Attributes:
        motion: File of the motion: what goals track where they name no file, and the guess.
        external: External loads of OpenSim, an .xml.
        wrenches: Table of the external wrenches of the scene.
        times: First and last time that count [s]; None for all of the motion.
        cutoff: Of the low-pass that the motion goes through [Hz]; None for none.
    """

    motion: Path
    external: Path | None = None
    wrenches: Path | None = None
    times: Range | None = None
    cutoff: float | None = None


def build_task(site: Site, given: Any) -> PredictTask:
    """The `predict` section of a task file.

    Raises:
        SceneError: Names file, key, what is wrong and what is accepted.
    """
    return predict_task(given, site.where, site.origin.name, site.origin.folder)


def predict_task(
    given: Any, where: str, source: str = "", folder: Path | None = None
) -> PredictTask:
    """The task of some entries.

    Args:
        given: Entries by key, see `_task`.
        where: File and key, for the messages.
        source: The file; empty without one.
        folder: From which files are looked for.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    task: PredictTask = schema.call(_task, given, where, where, source, folder or Path())
    return task


def _task(
    where: str,
    source: str,
    folder: Path,
    *,
    duration: Any = None,
    start: Any = None,
    end: Mapping[str, Any] | None = None,
    bounds: Mapping[str, Any] | None = None,
    goals: Sequence[Any] = (),
    phases: Sequence[Mapping[str, Any]] = (),
    periodic: Any = False,
    symmetric: Mapping[str, str] | None = None,
    travel: Sequence[str] = (),
    parameters: Mapping[str, Any] | None = None,
    mesh: Mapping[str, Any] | None = None,
    tolerance: Annotated[float | None, Within(1.0e-13, 1.0)] = None,
    accuracy: Annotated[float, Within(1.0e-13, 1.0e-2)] = 1.0e-10,
    grip: Annotated[float, Within(0.0, 1.0)] = 1.0,
    iterations: Count = 1000,
    guess: Any = None,
    starts: Annotated[int, Within(1, 1000)] = 1,
    continuation: Mapping[str, Any] | None = None,
    recording: Any = None,
    driven_by: DrivenBy = "scene",
    muscles: Any = None,
) -> PredictTask:
    track = recording_of(recording, f"{where}.recording", folder)
    if duration is None and not phases and track is None:
        raise SceneError(f"{where}: key 'duration' is missing")
    if duration is not None and phases:
        raise SceneError(f"{where}.duration: phases have their own; accepted: in each phase")
    is_free = start == FREE or bool(periodic) or bool(symmetric) or track is not None
    whole = PhaseTask(
        "",
        None if duration is None else duration_of(duration, f"{where}.duration"),
        ranges(bounds or {}, f"{where}.bounds"),
        {} if start is None or start == FREE else ranges(start, f"{where}.start"),
        ranges(end or {}, f"{where}.end"),
        goals_of(goals, f"{where}.goals", folder),
    )
    some = phases_of(phases, whole, f"{where}.phases", folder) if phases else (whole,)
    if not any(one.goals for one in some):
        raise SceneError(f"{where}: key 'goals' is missing, such as [{{type: effort}}]")
    lines, file = guess_of(guess, f"{where}.guess", folder)
    return PredictTask(
        some,
        is_free,
        _names(periodic, f"{where}.periodic"),
        dict(symmetric or {}),
        tuple(travel),
        {
            key: open_range(one, f"{where}.parameters.{key}")
            for key, one in (parameters or {}).items()
        },
        schema.call(MeshTask, dict(mesh or {}), f"{where}.mesh"),
        (TOLERANCE if track is None else _OF_RECORDING) if tolerance is None else tolerance,
        accuracy,
        grip,
        iterations,
        lines,
        file,
        starts,
        {
            key: _values(one, f"{where}.continuation.{key}")
            for key, one in (continuation or {}).items()
        },
        muscles_of(muscles, f"{where}.muscles"),
        source,
        track,
        driven_by,
    )


def recording_of(given: Any, where: str, folder: Path) -> RecordingTask | None:
    """The recording of an entry.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    if given is None:
        return None
    if isinstance(given, str):
        given = {"motion": given}
    if not isinstance(given, dict):
        raise SceneError(f"{where}: expected a file, or motion with external and times")
    found: RecordingTask = schema.call(_recording, given, where, where, folder)
    return found


def _recording(
    where: str,
    folder: Path,
    *,
    motion: str,
    external: str | None = None,
    wrenches: str | None = None,
    times: Any = None,
    cutoff: Annotated[float | None, Within(1.0e-3, 1.0e6), Unit("Hz")] = None,
) -> RecordingTask:
    if external is not None and wrenches is not None:
        raise SceneError(f"{where}: external and wrenches say the same; accepted: one of them")
    names = {"motion": motion, "external": external, "wrenches": wrenches}
    files = {
        key: None if name is None else find_file(folder, name, f"{where}.{key}")
        for key, name in names.items()
    }
    assert files["motion"] is not None
    span = None if times is None else open_range(times, f"{where}.times")
    return RecordingTask(files["motion"], files["external"], files["wrenches"], span, cutoff)


def open_range(given: Any, where: str) -> Range:
    """A range with some width."""
    low, high = range_of(given, where)
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise SceneError(f"{where}: expected [low, high] with low < high, got {given}")
    return low, high


def range_of(given: Any, where: str) -> Range:
    """A number, [low, high] with null for no bound, or `free`."""
    if given == FREE:
        return -math.inf, math.inf
    if isinstance(given, list):
        if len(given) != 2:
            raise SceneError(f"{where}: expected a number or [low, high], got {given}")
        ends = (-math.inf, math.inf)
        pairs = zip(given, ends, strict=True)
        low, high = (end if one is None else schema.value(one, float, where) for one, end in pairs)
        if low > high:
            raise SceneError(f"{where}: lower bound {low:g} is above the upper one {high:g}")
        return low, high
    number = schema.value(given, float, where)
    return number, number


def duration_of(given: Any, where: str) -> Range:
    """Shortest and longest duration [s]."""
    low, high = range_of(given, where)
    if high == 0.0:
        raise SceneError(
            f"{where}: a phase that lasts no time; accepted: above 0, or leave it out and let the "
            "guard before it lead to the phase after it, with what both reset"
        )
    if not (low >= SMALLEST and high <= LARGEST):
        raise SceneError(f"{where}: {low:g} .. {high:g} s is out of range, accepted: {_LASTS}")
    return low, high


def ranges(given: Any, where: str) -> dict[str, Range]:
    """Quantity -> range."""
    if not isinstance(given, dict):
        raise SceneError(f"{where}: expected quantities with a number or [low, high] each")
    return {str(key): range_of(one, f"{where}.{key}") for key, one in given.items()}


def phases_of(
    given: Sequence[Any], motion: PhaseTask, where: str, folder: Path
) -> tuple[PhaseTask, ...]:
    """The phases of a list of entries.

    Args:
        motion: What is asked of all of it: bounds that hold in all phases, where they do not say
            otherwise, goals that count in all, ranges at its start and end.
        where: File and key, for the messages.
        folder: From which files are looked for.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    found = list[PhaseTask]()
    for i, entry in enumerate(given):
        one: PhaseTask = schema.call(_phase, entry, f"{where}[{i}]", f"{where}[{i}]", folder)
        bounds = {**motion.bounds, **one.bounds}
        found.append(replace(one, bounds=bounds, goals=(*motion.goals, *one.goals)))
    found[0] = replace(found[0], start={**motion.start, **found[0].start})
    found[-1] = replace(found[-1], end={**motion.end, **found[-1].end})
    return tuple(found)


def _phase(
    where: str,
    folder: Path,
    *,
    duration: Any,
    phase: str = "",
    bounds: Mapping[str, Any] | None = None,
    start: Mapping[str, Any] | None = None,
    end: Mapping[str, Any] | None = None,
    goals: Sequence[Any] = (),
) -> PhaseTask:
    return PhaseTask(
        phase,
        duration_of(duration, f"{where}.duration"),
        ranges(bounds or {}, f"{where}.bounds"),
        ranges(start or {}, f"{where}.start"),
        ranges(end or {}, f"{where}.end"),
        goals_of(goals, f"{where}.goals", folder),
    )


def guess_of(
    given: Any, where: str, folder: Path
) -> tuple[dict[str, tuple[float, ...]], Path | None]:
    """Lines of a guess, or its file.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    if given is None:
        return {}, None
    if isinstance(given, str):
        return {}, find_file(folder, given, where)
    if not isinstance(given, dict):
        raise SceneError(f"{where}: expected a file, or quantities with values, got {given!r}")
    return {str(key): _values(one, f"{where}.{key}") for key, one in given.items()}, None


def _values(given: Any, where: str) -> tuple[float, ...]:
    """A number, or some in a list."""
    listed = given if isinstance(given, list) else [given]
    if not listed:
        raise SceneError(f"{where}: expected a number or a list of them, got []")
    return tuple(schema.value(listed, Sequence[float], where))


def _names(given: Any, where: str) -> tuple[str, ...]:
    if isinstance(given, bool):
        return ("*.position", "*.velocity") if given else ()
    return tuple(schema.value(given, Sequence[str], where))


def muscles_of(given: Any, where: str) -> Mapping[str, Any] | None:
    """Arguments of the muscles in place of those of the scene; None where these stay.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    if given is None:
        return None
    entry = (
        {"type": given}
        if isinstance(given, str)
        else schema.value(given, Mapping[str, Any], where)
    )
    if entry.pop("type", None) != SMOOTH:
        raise SceneError(f"{where}: accepted: {SMOOTH}, or {{type: {SMOOTH}, tendon: rigid}}")
    return entry


def goals_of(given: Sequence[Any], where: str, folder: Path | None = None) -> tuple[Goal, ...]:
    """The goals of a list of entries.

    Args:
        given: Entries with `type`, `weight`, `name` and the keys of that type.
        where: File and key, for the messages.
        folder: From which files are looked for.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    found = list[Goal]()
    for i, entry in enumerate(given):
        at = f"{where}[{i}]"
        if callable(entry):
            entry = {"type": "function", "function": entry}
        found.append(_goal(entry, at, folder, {goal.name for goal in found}))
    return tuple(found)


def _goal(entry: Any, where: str, folder: Path | None, taken: set[str]) -> Goal:
    if not isinstance(entry, dict):
        raise SceneError(f"{where}: expected a mapping with type, got {entry!r}")
    rest = {key: one for key, one in entry.items() if key not in ("type", "weight", "name")}
    kind = entry.get("type")
    if not isinstance(kind, str) or kind not in _KINDS:
        raise SceneError(f"{where}.type: expected one of {', '.join(_KINDS)}, got {kind!r}")
    weight = schema.value(entry.get("weight", 1.0), float, f"{where}.weight")
    options = schema.call(_KINDS[kind], rest, where)
    name = str(entry.get("name", kind))
    number = 1
    while name in taken:
        number += 1
        name = f"{entry.get('name', kind)}_{number}"
    _check_quantities(options.get("of"), f"{where}.of")
    if kind == "function" and not callable(options["function"]):
        path = schema.value(options["function"], str, f"{where}.function")
        options["function"] = _function_of(path, f"{where}.function")
    if options.get("file"):
        options["file"] = find_file(folder or Path(), options["file"], f"{where}.file")
    return Goal(kind, weight, options, name)


def _check_quantities(of: Any, where: str) -> None:
    """Refuse what is neither a name, nor a list of names, nor names with weights."""
    if isinstance(of, dict):
        schema.value(of, Mapping[str, float], where)
    elif isinstance(of, list):
        schema.value(of, Sequence[str], where)
    elif of is not None:
        schema.value(of, str, where)


def _function_of(path: str, where: str) -> Callable[[Any], Any]:
    from mbd_ros.scene.schema.code_permission import require_permission

    require_permission(where, {"function": path})
    module, _, name = path.partition(":")
    try:
        found: Callable[[Any], Any] = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise SceneError(f"{where}: {path} cannot be imported: {error}") from error
    return found
