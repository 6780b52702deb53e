"""Results on disk, a file an item: what an interrupted report goes on from."""

import hashlib
import json
import re
from pathlib import Path

from mbd_ros.errors import DataError
from mbd_ros.report import items
from mbd_ros.report.items import Item
from mbd_ros.report.program import named_files, program
from mbd_ros.tables import replacing
from mbd_ros.workers.task import Result, cpu

_NAME = re.compile(r"[\w.-]+", re.ASCII)
_FOLDER = "results"


class Store:
    """Results below a folder, found again by item and by the program that made them.

    Args:
        folder: That of the report; created.

    Raises:
        DataError: The folder holds something else.
    """

    def __init__(self, folder: Path) -> None:
        if folder.exists() and not folder.is_dir():
            raise DataError(f"{folder}: is not a folder")
        if folder.is_dir() and any(folder.iterdir()) and not (folder / _FOLDER).is_dir():
            raise DataError(f"{folder}: holds something else than a report")
        self.folder = folder / _FOLDER
        self.folder.mkdir(parents=True, exist_ok=True)
        self._paths: dict[tuple[str, str], Path] = {}

    def load(self, item: Item) -> Result | None:
        """The result of an item; None where there is none that holds."""
        try:
            stored = json.loads(self._path(item).read_bytes())
            return Result(stored["outcome"], "", stored["took"], stored["cpu"])
        except (OSError, ValueError, KeyError):  # missing, or cut off by a loss of power
            return None

    def save(self, item: Item, result: Result) -> None:
        """Keep the result of an item; a failure is none, so that it is tried again."""
        if result.failure:
            return
        entry = {"outcome": result.value, "took": result.seconds, "cpu": result.cpu}
        path = self._path(item)
        path.parent.mkdir(exist_ok=True)
        with replacing(path) as file:
            file.write(json.dumps({**item._asdict(), **entry}).encode())

    def _path(self, item: Item) -> Path:
        if item[:2] not in self._paths:
            self._paths[item[:2]] = self._place(item)
        return self._paths[item[:2]]

    def _place(self, item: Item) -> Path:
        if not _NAME.fullmatch(item.name):
            raise ValueError(f"name of a {item.kind} item: {item.name!r}")
        folder = self.folder / f"{item.kind}-{program(items.PARTS[item.kind])[:12]}"
        return folder / f"{item.name[:100]}-{_identity(item)[:12]}.json"


def _identity(item: Item) -> str:
    where = cpu() if item.alone else ""
    parts = [item.name, item.spec, named_files(item.spec), where]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
