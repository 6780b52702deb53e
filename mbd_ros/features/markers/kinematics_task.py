"""The `kinematics` section of a task file: what a fit of markers is asked for."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from mbd_ros.core.ranges import NotNegative, Unit
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.locate import find_file


@dataclass(frozen=True)
class CoordinateTask:
    """A joint that should be near a position.

    Attributes:
        weight: Of the square of its distance [m^2/rad^2], beside the mean square of markers: a
            sum of marker weights times more than its number says.
        value: Position [rad or m]; None for that of a recorded motion where there is one, else
            for that of the start.
        from_motion: Whether it follows a recorded motion.
    """

    weight: Annotated[NotNegative, Unit("m^2/rad^2")]
    value: float | None = None
    from_motion: bool = False


@dataclass(frozen=True)
class KinematicsTask:
    """What a fit of markers is asked for.

    Attributes:
        markers: Label -> weight, of no other markers than these; None for those of the sensors.
        coordinates: Joint -> its task.
        begin: First time [s].
        end: Last time [s].
        smoothness: See `features.markers.marker_trial`; 0 fits frames alone.
        limits: Whether joints keep their limits.
        unit: Of the recorded places; None for that of the file.
        axes: Recorded axis along each axis of the scene, as `x,z,-y`, or `screen`; None: the same.
        motion: File of the positions that coordinate tasks follow.
        source: The file, for messages; empty without one.
    """

    markers: Mapping[str, float] | None = None
    coordinates: Mapping[str, CoordinateTask] = field(default_factory=dict)
    begin: float | None = None
    end: float | None = None
    smoothness: float = 0.0
    limits: bool = True
    unit: str | None = None
    axes: str | None = None
    motion: Path | None = None
    source: str = ""


def build_task(site: Site, given: Any) -> KinematicsTask:
    """The `kinematics` section of a task file.

    Raises:
        SceneError: Names file, key, what is wrong and what is accepted.
    """
    task: KinematicsTask = schema.call(_task, given, site.where, site)
    return task


def refuse_unknown_joints(scene: Scene, names: Mapping[str, Any], where: str) -> None:
    """Refuse tasks for joints that the scene does not move.

    Raises:
        SceneError: Names the joint and what there is.
    """
    for name in names:
        try:
            scene.robot.joint(name)
        except ModelError as error:
            raise SceneError(f"{where}: {error}") from error


def _task(
    site: Site,
    *,
    markers: Mapping[str, NotNegative] | None = None,
    coordinates: Mapping[str, Any] | None = None,
    begin: float | None = None,
    end: float | None = None,
    smoothness: NotNegative = 0.0,
    limits: bool = True,
    unit: str | None = None,
    axes: str | None = None,
    motion: str | None = None,
) -> KinematicsTask:
    file = None
    if motion is not None:
        file = find_file(site.origin.folder, motion, f"{site.where}.motion")
    tasks = {
        name: _coordinate(entry, f"{site.where}.coordinates.{name}")
        for name, entry in (coordinates or {}).items()
    }
    if site.scene is not None:
        refuse_unknown_joints(site.scene, tasks, f"{site.where}.coordinates")
    if file is None and any(task.from_motion for task in tasks.values()):
        raise SceneError(f"{site.where}.coordinates: from_motion asks for a key 'motion'")
    given = markers, tasks, begin, end, smoothness, limits, unit, axes, file
    return KinematicsTask(*given, source=site.origin.name)


def _coordinate(entry: Any, where: str) -> CoordinateTask:
    """A weight alone, or a mapping."""
    if not isinstance(entry, dict):
        return CoordinateTask(schema.value(entry, NotNegative, where))
    task: CoordinateTask = schema.call(CoordinateTask, entry, where)
    return task
