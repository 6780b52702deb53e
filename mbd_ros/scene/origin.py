"""Where the entries of a scene or of a task come from."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

NO_FILE = "scene"  # what messages call a scene that no file holds


class Model(NamedTuple):
    """A model that was read, and what it brought.

    Attributes:
        urdf: Its bodies and joints.
        brought: Sections by key, as they were merged.
        left_out: What the scene does not have of it, a line each.
    """

    source: str
    urdf: str
    brought: Mapping[str, Any]
    left_out: tuple[str, ...]


class Origin(NamedTuple):
    """Source of a scene or a task.

    Attributes:
        path: The file, None where the sections come from Python.
        description: URDF that came with it: from a topic, or from Python.
        title: For the messages, where there is no file.
        base: Folder from which relative paths start, where there is no file.
        model: What the robot was read from, where its file brings sections too.
    """

    path: Path | None = None
    description: str | None = None
    title: str = NO_FILE
    base: Path = Path()
    model: Model | None = None

    @property
    def name(self) -> str:
        """For the messages."""
        return self.title if self.path is None else str(self.path)

    @property
    def folder(self) -> Path:
        """Folder from which relative paths start."""
        return self.base if self.path is None else self.path.parent

    def changed(self) -> "Origin":
        """Where a scene comes from that is made of this one."""
        title = self.title if self.path is None else f"{self.path} (changed)"
        return self._replace(path=None, title=title, base=self.folder)
