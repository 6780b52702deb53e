"""The `kinematics` section of a task file: how joint positions are fitted to markers."""

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
    """A joint whose position shall be near a value.

    Attributes:
        weight: Weight of the squared distance [m^2/rad^2]. It stands beside the weighted mean of
            the squared marker distances, not beside their sum.
        value: Position [rad or m]; None for that of the recorded motion, or without one for that
            of the start.
        from_motion: Whether the joint follows the recorded motion.
    """

    weight: Annotated[NotNegative, Unit("m^2/rad^2")]
    value: float | None = None
    from_motion: bool = False


@dataclass(frozen=True)
class KinematicsTask:
    """How joint positions are fitted to recorded markers, as a task file describes it.

    Attributes:
        markers: Weights by label; markers without one are left out. None takes the weights of
            the sensors.
        coordinates: Tasks by joint: a weight, or `weight`, `value` and `from_motion`.
        begin: First time [s]; None for the start of the recording.
        end: Last time [s]; None for its end.
        smoothness: Ratio of the error of markers to the error of accelerations [m s^2/rad]; 0
            fits every frame by itself.
        limits: Whether joints keep their limits.
        unit: Unit of the recorded markers; None for that of the file.
        axes: Recorded axis along each axis of the scene, such as `x,z,-y`, or `screen`; None if
            the axes are the same.
        motion: File with the positions that coordinate tasks follow.
        source: The task file, for messages; empty without one.
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


def build_task(site: Site, entry: Any) -> KinematicsTask:
    """Build the `kinematics` section of a task file.

    Raises:
        SceneError: A key is unknown or its value is not accepted; the message names both.
    """
    task: KinematicsTask = schema.call(task_of_keys, entry, site.where, site)
    return task


def refuse_unknown_joints(scene: Scene, names: Mapping[str, Any], where: str) -> None:
    """Refuse tasks for joints that the scene does not have.

    Raises:
        SceneError: A name is not that of a joint; the message lists the joints.
    """
    for name in names:
        try:
            scene.robot.joint(name)
        except ModelError as error:
            raise SceneError(f"{where}: {error}") from error


def task_of_keys(
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
    """Build a task; the keyword arguments are the keys of the section `kinematics`."""
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
        raise SceneError(f"{site.where}.motion: is missing; from_motion in coordinates needs it")
    return KinematicsTask(
        markers,
        tasks,
        begin,
        end,
        smoothness,
        limits,
        unit,
        axes,
        file,
        source=site.origin.name,
    )


def _coordinate(entry: Any, where: str) -> CoordinateTask:
    """Build a coordinate task from a weight, or from a mapping."""
    if not isinstance(entry, dict):
        return CoordinateTask(schema.value(entry, NotNegative, where))
    task: CoordinateTask = schema.call(CoordinateTask, entry, where)
    return task
