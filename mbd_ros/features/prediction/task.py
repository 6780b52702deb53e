"""The `predict` section of a task file: which motion is asked of a scene, and what is best."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from mbd_ros.core.ranges import Within
from mbd_ros.errors import SceneError
from mbd_ros.features.prediction.smooth_muscles import SMOOTH
from mbd_ros.features.prediction.task_goals import goals_of
from mbd_ros.features.prediction.task_phases import PhaseTask, phases_of
from mbd_ros.features.prediction.task_ranges import FREE, duration_of, open_range, ranges
from mbd_ros.features.prediction.task_recording import DrivenBy, RecordingTask, recording_of
from mbd_ros.optimal_control.collocation import LARGEST_DEGREE
from mbd_ros.optimal_control.problem import Range
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.locate import find_file

# The guess of a task of prediction, and the muscles that it asks for.


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
    return {
        str(key): tuple(
            schema.value(
                one if isinstance(one, list) else [one], Sequence[float], f"{where}.{key}"
            )
        )
        for key, one in given.items()
    }, None


def muscles_of(given: Any, where: str) -> Mapping[str, Any] | None:
    """Arguments of the muscles in place of those of the scene; None where these stay.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    if given is None:
        return None
    entry = {"type": given} if isinstance(given, str) else dict(given)
    if entry.pop("type", None) != SMOOTH:
        raise SceneError(f"{where}: accepted: {SMOOTH}, or {{type: {SMOOTH}, tendon: rigid}}")
    return entry


Scheme = Literal["gauss", "radau", "hermite_simpson"]
Count = Annotated[int, Within(1, 10_000)]
TOLERANCE = 1.0e-7  # of the error between nodes
_OF_RECORDING = 1.0e-5  # which is measured less well than that


@dataclass(frozen=True)
class MeshTask:
    """The first mesh.

    Attributes:
        scheme: Of collocation.
        degree: Points of an interval.
        intervals: Of each phase; None for 10, or 25 a second of a recording.
        refinements: How many times intervals are split at most.
    """

    scheme: Scheme = "gauss"
    degree: Annotated[int, Within(1, LARGEST_DEGREE)] = 5
    intervals: Annotated[int | None, Within(1, 10_000)] = None
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
            key: tuple(schema.value(one, Sequence[float], f"{where}.continuation.{key}"))
            for key, one in (continuation or {}).items()
        },
        muscles_of(muscles, f"{where}.muscles"),
        source,
        track,
        driven_by,
    )


def _names(given: Any, where: str) -> tuple[str, ...]:
    if isinstance(given, bool):
        return ("*.position", "*.velocity") if given else ()
    return tuple(schema.value(given, Sequence[str], where))
