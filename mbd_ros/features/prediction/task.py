"""The section `predict` of a task file: phases, bounds and goals of a predicted motion."""

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
Selection = Any  # a name of quantities, a list of names, or names with weights


def _powers(of: Selection = None, power: Power = 2) -> dict[str, Any]:
    return {"of": of, "power": power}


def _power(
    of: Selection = None, smoothing: Annotated[Positive, Unit("W")] = 0.1
) -> dict[str, Any]:
    return {"of": of, "smoothing": smoothing}


def _metabolic(
    of: Selection = None,
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


def _smoothness(of: Selection = None) -> dict[str, Any]:
    return {"of": of}


def _tracking(of: Selection, file: str = "") -> dict[str, Any]:
    return {"of": of, "file": file}


def _integral(of: Selection, power: Power = 1, target: Unlimited = 0.0) -> dict[str, Any]:
    return {"of": of, "power": power, "target": target}


def _value(of: Selection, power: Power = 2, target: Unlimited = 0.0) -> dict[str, Any]:
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
_DURATION_TEXT = "a number above 0, or [shortest, longest]"
DrivenBy = Literal["scene", "joints", "muscles"]
Scheme = Literal["gauss", "radau", "hermite_simpson"]
Count = Annotated[int, Within(1, 10_000)]
TOLERANCE = 1.0e-7  # of the error between nodes
_RECORDING_TOLERANCE = 1.0e-5  # the same beside a recording, which is less accurate than that


@dataclass(frozen=True)
class MeshTask:
    """The first mesh.

    Attributes:
        scheme: Collocation scheme.
        degree: Points per interval.
        intervals: Intervals of each phase; None for 10, or 25 per second of a recording.
        refinements: Largest number of refinements.
    """

    scheme: Scheme = "gauss"
    degree: Annotated[int, Within(1, LARGEST_DEGREE)] = 5
    intervals: Annotated[int | None, Within(1, MOST_INTERVALS)] = None
    refinements: Annotated[int, Within(0, 30)] = 10


@dataclass(frozen=True)
class PredictTask:
    """A motion to be predicted.

    Attributes:
        phases: Phases, in the order of the motion.
        start_free: Whether the initial state is free where `start` does not name it; otherwise it
            is that of the scene.
        periodic: Quantities that have the same value at both ends; empty for none.
        symmetric: Quantity at the end -> quantity at the beginning with the same value.
        travel: Joints whose position does not repeat in a periodic motion.
        parameters: Unknown numbers of the scene and their ranges.
        mesh: The first mesh.
        tolerance: Relative tolerance of the error between nodes.
        accuracy: Tolerance of the conditions of optimality.
        grip: Share of the friction of held contacts that the motion may use.
        iterations: Largest number of iterations on a mesh.
        guess: Quantity -> values at equally spaced times, with straight lines between them.
        guess_file: Initial motion; None for straight lines.
        starts: Number of guesses; the first one is the given guess, the others are random.
        continuation: Number of the scene -> values; the last one is that of the motion.
        muscles: Arguments of the smooth muscles that replace those of the scene; None where the
            muscles of the scene remain.
        source: Task file, for messages; empty without one.
        recording: Recorded motion; None without one.
        driven_by: What drives the scene: `scene` for its own inputs, `joints` for ideal drives in
            all independent joints, `muscles` for these and its muscles.
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
    """A phase of the motion.

    Attributes:
        phase: Name of a phase of the scene; empty where the scene has none.
        duration: Shortest and longest duration [s]; None for that of the recording.
        bounds: Quantity -> range at all times.
        start: Quantity -> range at the beginning.
        end: Quantity -> range at the end.
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
    """A recorded motion and the loads that were measured with it.

    Attributes:
        motion: File of the motion, which is the guess, and the reference of goals without a file.
        external: File of external loads of OpenSim (.xml).
        wrenches: Table of the external wrenches of the scene.
        times: First and last time that are used [s]; None for the entire motion.
        cutoff: Cutoff frequency of the low-pass for the motion [Hz]; None for none.
    """

    motion: Path
    external: Path | None = None
    wrenches: Path | None = None
    times: Range | None = None
    cutoff: float | None = None


def build_task(site: Site, value: Any) -> PredictTask:
    """Build the `predict` section of a task file.

    Raises:
        SceneError: An entry is wrong; the message names file, key and what is accepted.
    """
    return predict_task(value, site.where, site.origin.name, site.origin.folder)


def predict_task(
    value: Any, where: str, source: str = "", folder: Path | None = None
) -> PredictTask:
    """Build a task from the entries of its section.

    Args:
        value: Entries by key, the keyword arguments of `_task`.
        where: File and key, for messages.
        source: Task file; empty without one.
        folder: Folder to which names of files are relative.

    Raises:
        SceneError: An entry is wrong; the message names the key and what is accepted.
    """
    task: PredictTask = schema.call(_task, value, where, where, source, folder or Path())
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
    track = parse_recording(recording, f"{where}.recording", folder)
    if duration is None and not phases and track is None:
        raise SceneError(
            f"{where}: key 'duration' is missing; give a number or [shortest, longest]"
        )
    if duration is not None and phases:
        raise SceneError(f"{where}.duration: give the duration in each entry of phases instead")
    is_free = start == FREE or bool(periodic) or bool(symmetric) or track is not None
    motion = PhaseTask(
        "",
        None if duration is None else parse_duration(duration, f"{where}.duration"),
        parse_ranges(bounds or {}, f"{where}.bounds"),
        {} if start is None or start == FREE else parse_ranges(start, f"{where}.start"),
        parse_ranges(end or {}, f"{where}.end"),
        parse_goals(goals, f"{where}.goals", folder),
    )
    tasks = parse_phases(phases, motion, f"{where}.phases", folder) if phases else (motion,)
    if not any(phase.goals for phase in tasks):
        raise SceneError(f"{where}: key 'goals' is missing; give some, such as [{{type: effort}}]")
    lines, file = parse_guess(guess, f"{where}.guess", folder)
    return PredictTask(
        tasks,
        is_free,
        _names(periodic, f"{where}.periodic"),
        dict(symmetric or {}),
        tuple(travel),
        {
            key: parse_open_range(entry, f"{where}.parameters.{key}")
            for key, entry in (parameters or {}).items()
        },
        schema.call(MeshTask, dict(mesh or {}), f"{where}.mesh"),
        (TOLERANCE if track is None else _RECORDING_TOLERANCE) if tolerance is None else tolerance,
        accuracy,
        grip,
        iterations,
        lines,
        file,
        starts,
        {
            key: _values(entry, f"{where}.continuation.{key}")
            for key, entry in (continuation or {}).items()
        },
        parse_muscles(muscles, f"{where}.muscles"),
        source,
        track,
        driven_by,
    )


def parse_recording(value: Any, where: str, folder: Path) -> RecordingTask | None:
    """Parse the entry `recording`: a file, or a mapping.

    Raises:
        SceneError: The entry is wrong; the message names the key and what is accepted.
    """
    if value is None:
        return None
    if isinstance(value, str):
        value = {"motion": value}
    if not isinstance(value, dict):
        raise SceneError(
            f"{where}: expected a file, or a mapping with motion and optionally external, "
            "wrenches, times and cutoff"
        )
    recording: RecordingTask = schema.call(_recording, value, where, where, folder)
    return recording


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
        raise SceneError(
            f"{where}: external and wrenches are two sources of the same loads; give one of them"
        )
    names = {"motion": motion, "external": external, "wrenches": wrenches}
    files = {
        key: None if name is None else find_file(folder, name, f"{where}.{key}")
        for key, name in names.items()
    }
    assert files["motion"] is not None
    span = None if times is None else parse_open_range(times, f"{where}.times")
    return RecordingTask(files["motion"], files["external"], files["wrenches"], span, cutoff)


def parse_open_range(value: Any, where: str) -> Range:
    """Parse a bounded range [low, high] with low < high."""
    low, high = parse_range(value, where)
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise SceneError(f"{where}: expected [low, high] with low < high, got {value}")
    return low, high


def parse_range(value: Any, where: str) -> Range:
    """Parse a range: a number, [low, high] with null for no bound, or `free`."""
    if value == FREE:
        return -math.inf, math.inf
    if isinstance(value, list):
        if len(value) != 2:
            raise SceneError(f"{where}: expected a number or [low, high], got {value}")
        ends = (-math.inf, math.inf)
        pairs = zip(value, ends, strict=True)
        low, high = (
            limit if bound is None else schema.value(bound, float, where) for bound, limit in pairs
        )
        if low > high:
            raise SceneError(f"{where}: lower bound {low:g} is above upper bound {high:g}")
        return low, high
    number = schema.value(value, float, where)
    return number, number


def parse_duration(value: Any, where: str) -> Range:
    """Parse the shortest and the longest duration [s]."""
    low, high = parse_range(value, where)
    if high == 0.0:
        raise SceneError(
            f"{where}: a duration must be above 0 s; leave such a phase out, and let the "
            "guard before it lead to the phase after it, with both resets"
        )
    if not (low >= SMALLEST and high <= LARGEST):
        raise SceneError(
            f"{where}: {low:g} .. {high:g} s is out of range; accepted is {_DURATION_TEXT}"
        )
    return low, high


def parse_ranges(value: Any, where: str) -> dict[str, Range]:
    """Parse a mapping from quantities to ranges."""
    if not isinstance(value, dict):
        raise SceneError(f"{where}: expected quantities with a number or [low, high] for each")
    return {str(key): parse_range(entry, f"{where}.{key}") for key, entry in value.items()}


def parse_phases(
    value: Sequence[Any], motion: PhaseTask, where: str, folder: Path
) -> tuple[PhaseTask, ...]:
    """Parse the list `phases`.

    Args:
        motion: Entries of the entire motion: bounds of all phases, unless a phase has others,
            goals that count in all phases, and ranges at start and end.
        where: File and key, for messages.
        folder: Folder to which names of files are relative.

    Raises:
        SceneError: An entry is wrong; the message names the key and what is accepted.
    """
    tasks = list[PhaseTask]()
    for i, entry in enumerate(value):
        task: PhaseTask = schema.call(_phase, entry, f"{where}[{i}]", f"{where}[{i}]", folder)
        bounds = {**motion.bounds, **task.bounds}
        tasks.append(replace(task, bounds=bounds, goals=(*motion.goals, *task.goals)))
    tasks[0] = replace(tasks[0], start={**motion.start, **tasks[0].start})
    tasks[-1] = replace(tasks[-1], end={**motion.end, **tasks[-1].end})
    return tuple(tasks)


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
        parse_duration(duration, f"{where}.duration"),
        parse_ranges(bounds or {}, f"{where}.bounds"),
        parse_ranges(start or {}, f"{where}.start"),
        parse_ranges(end or {}, f"{where}.end"),
        parse_goals(goals, f"{where}.goals", folder),
    )


def parse_guess(
    value: Any, where: str, folder: Path
) -> tuple[dict[str, tuple[float, ...]], Path | None]:
    """Parse the entry `guess`: lines by quantity, or a file.

    Raises:
        SceneError: The entry is wrong; the message names the key and what is accepted.
    """
    if value is None:
        return {}, None
    if isinstance(value, str):
        return {}, find_file(folder, value, where)
    if not isinstance(value, dict):
        raise SceneError(f"{where}: expected a file, or quantities with values, got {value!r}")
    return {str(key): _values(entry, f"{where}.{key}") for key, entry in value.items()}, None


def _values(value: Any, where: str) -> tuple[float, ...]:
    """Parse a number, or a list of numbers."""
    numbers = value if isinstance(value, list) else [value]
    if not numbers:
        raise SceneError(f"{where}: expected a number or a list of numbers, got []")
    return tuple(schema.value(numbers, Sequence[float], where))


def _names(value: Any, where: str) -> tuple[str, ...]:
    if isinstance(value, bool):
        return ("*.position", "*.velocity") if value else ()
    return tuple(schema.value(value, Sequence[str], where))


def parse_muscles(value: Any, where: str) -> Mapping[str, Any] | None:
    """Parse the entry `muscles`: arguments of smooth muscles, or None without the entry.

    Raises:
        SceneError: The entry is wrong; the message names the key and what is accepted.
    """
    if value is None:
        return None
    entry = (
        {"type": value}
        if isinstance(value, str)
        else schema.value(value, Mapping[str, Any], where)
    )
    if entry.pop("type", None) != SMOOTH:
        raise SceneError(f"{where}: accepted are {SMOOTH} and {{type: {SMOOTH}, tendon: rigid}}")
    return entry


def parse_goals(value: Sequence[Any], where: str, folder: Path | None = None) -> tuple[Goal, ...]:
    """Parse the list `goals`.

    Args:
        value: Entries with `type`, `weight`, `name` and the keys of that type, or functions.
        where: File and key, for messages.
        folder: Folder to which names of files are relative.

    Raises:
        SceneError: An entry is wrong; the message names the key and what is accepted.
    """
    goals = list[Goal]()
    for i, entry in enumerate(value):
        if callable(entry):
            entry = {"type": "function", "function": entry}
        goals.append(_parse_goal(entry, f"{where}[{i}]", folder, {goal.name for goal in goals}))
    return tuple(goals)


def _parse_goal(entry: Any, where: str, folder: Path | None, names: set[str]) -> Goal:
    if not isinstance(entry, dict):
        raise SceneError(f"{where}: expected a mapping with a type, got {entry!r}")
    arguments = {k: v for k, v in entry.items() if k not in ("type", "weight", "name")}
    kind = entry.get("type")
    if not isinstance(kind, str) or kind not in _KINDS:
        raise SceneError(f"{where}.type: expected one of {', '.join(_KINDS)}, got {kind!r}")
    weight = schema.value(entry.get("weight", 1.0), float, f"{where}.weight")
    options = schema.call(_KINDS[kind], arguments, where)
    name = str(entry.get("name", kind))
    number = 1
    while name in names:
        number += 1
        name = f"{entry.get('name', kind)}_{number}"
    _check_quantities(options.get("of"), f"{where}.of")
    if kind == "function" and not callable(options["function"]):
        path = schema.value(options["function"], str, f"{where}.function")
        options["function"] = _import_function(path, f"{where}.function")
    if options.get("file"):
        options["file"] = find_file(folder or Path(), options["file"], f"{where}.file")
    return Goal(kind, weight, options, name)


def _check_quantities(of: Any, where: str) -> None:
    """Refuse entries that are neither a name, nor a list of names, nor names with weights."""
    if isinstance(of, dict):
        schema.value(of, Mapping[str, float], where)
    elif isinstance(of, list):
        schema.value(of, Sequence[str], where)
    elif of is not None:
        schema.value(of, str, where)


def _import_function(path: str, where: str) -> Callable[[Any], Any]:
    from mbd_ros.scene.schema.code_permission import require_permission

    require_permission(where, {"function": path})
    module, _, name = path.partition(":")
    try:
        function: Callable[[Any], Any] = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise SceneError(f"{where}: {path} cannot be imported: {error}") from error
    return function
