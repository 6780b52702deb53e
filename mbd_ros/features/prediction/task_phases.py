"""The phases of a motion that a task file asks for."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mbd_ros.features.prediction.task_goals import goals_of
from mbd_ros.features.prediction.task_ranges import duration_of, ranges
from mbd_ros.optimal_control.problem import Goal, Range
from mbd_ros.scene.schema import schema


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


def phases_of(
    given: Sequence[Any], motion: PhaseTask, where: str, folder: Path
) -> tuple[PhaseTask, ...]:
    """The phases of a list of entries.

    Args:
        given: Entries.
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
