"""The place of an entry, and the parts that it may be built from."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from mbd_ros.core.model.robot import Robot
from mbd_ros.scene.sections import Section

if TYPE_CHECKING:
    from mbd_ros.scene.built_scene import Scene

NO_FILE = "scene"  # what messages call a scene that no file holds


class Origin(NamedTuple):
    """Source of a scene or a task.

    Attributes:
        path: The file, None where the sections come from Python.
        description: URDF that came with it: from a topic, or from Python.
        task_of: The scene that a task is asked of, None for a scene.
        title: For the messages, where there is no file.
        base: Folder from which relative paths start, where there is no file.
    """

    path: Path | None = None
    description: str | None = None
    task_of: "Scene | None" = None
    title: str = NO_FILE
    base: Path = Path()

    @property
    def name(self) -> str:
        """For the messages."""
        return self.title if self.path is None else str(self.path)

    @property
    def folder(self) -> Path:
        """Folder from which relative paths start."""
        return self.base if self.path is None else self.path.parent


class Site(NamedTuple):
    """The knowledge of the builder of a section.

    Attributes:
        section: Its line of the table.
        origin: The file, or where else the entries came from.
        robot: The robot with the inertia of the drives that are built; None before it is.
        parts: The sections that are built, by key.
    """

    section: Section
    origin: Origin
    robot: Robot | None
    parts: Mapping[str, Any]

    @property
    def where(self) -> str:
        """File and key, for the messages."""
        return f"{self.origin.name}: {self.section.key}"
