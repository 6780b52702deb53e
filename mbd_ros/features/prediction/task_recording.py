"""What a task of a motion says of a recording of it, and of what drives the scene."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from mbd_ros.core.ranges import Unit, Within
from mbd_ros.errors import SceneError
from mbd_ros.features.prediction.task_ranges import open_range
from mbd_ros.optimal_control.problem import Range
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.locate import find_file

DrivenBy = Literal["scene", "joints", "muscles"]


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
