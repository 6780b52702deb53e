"""Results on disk, a file an item, from which an interrupted report continues."""

import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from mbd_ros.applications.report import items
from mbd_ros.applications.report.items import Item
from mbd_ros.applications.report.program import named_files, program, program_now
from mbd_ros.errors import DataError
from mbd_ros.files.replacing import replacing
from mbd_ros.jobs.workers.task import Result

_NAME = re.compile(r"[\w.-]+", re.ASCII)
_FOLDER, _MARK, _NUMBERS = "results", ".mbd_ros_report", "report.json"
_OURS = b'"sections"'  # in the numbers of a report


class _Basis(NamedTuple):
    """What a result depends on besides its item: hashes of the program and of named files."""

    program: str
    files: Mapping[str, str]


class Store:
    """Results below a folder, found again by item and by what made them.

    Args:
        folder: That of the report; created.
        cpu: Processor on which items of this run are timed.

    Raises:
        DataError: The folder holds something else, or cannot be written.
    """

    def __init__(self, folder: Path, cpu: str) -> None:
        with told(folder):
            if folder.exists() and not folder.is_dir():
                raise DataError(f"{folder}: is not a folder")
            if folder.is_dir() and any(folder.iterdir()) and not _is_report(folder):
                raise DataError(f"{folder}: holds something else than a report")
            self.folder = folder / _FOLDER
            self.folder.mkdir(parents=True, exist_ok=True)
            with replacing(folder / _MARK) as file:
                file.write(b"A report of mbd_ros; it may be written over.\n")
        self._cpu = cpu
        self._bases: dict[tuple[str, str], _Basis] = {}
        self.changed: dict[str, None] = {}
        """What became another one while items that depend on it ran; in their order."""

    def load(self, item: Item) -> Result | None:
        """The result of an item; None where there is none that holds."""
        basis = _Basis(program(items.PARTS[item.kind]), named_files(item.spec))
        self._bases[item[:2]] = basis
        try:
            stored = json.loads(self._path(item, basis, self._cpu).read_bytes())
            if item.alone and stored["cpu"] != self._cpu:
                return None
            return Result(stored["outcome"], "", stored["took"], stored["cpu"])
        except (OSError, ValueError, KeyError):  # missing, or cut off by a loss of power
            return None

    def save(self, item: Item, result: Result) -> None:
        """Keep the result of an item that was asked for before.

        A failure is none, so that it is tried again. Neither is what may have been made from other
        files than those that were there in the beginning: `changed` gets their names.

        Raises:
            DataError: The folder cannot be written.
        """
        if result.failure:
            return
        before = self._bases[item[:2]]
        now = _Basis(program_now(items.PARTS[item.kind]), named_files(item.spec))
        if now != before:
            self.changed |= dict.fromkeys(_differences(item.kind, before, now))
            return
        entry = {"outcome": result.value, "took": result.seconds, "cpu": result.cpu}
        path = self._path(item, before, result.cpu)
        with told(path):
            path.parent.mkdir(exist_ok=True)
            with replacing(path) as file:
                file.write(json.dumps({**item._asdict(), **entry}).encode())

    def _path(self, item: Item, basis: _Basis, cpu: str) -> Path:
        if not _NAME.fullmatch(item.name):
            raise ValueError(f"name of a {item.kind} item: {item.name!r}")
        parts = [item.name, item.spec, basis.files, cpu if item.alone else ""]
        identity = hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
        folder = self.folder / f"{item.kind}-{basis.program[:12]}"
        return folder / f"{item.name[:100]}-{identity[:12]}.json"


@contextmanager
def told(path: Path) -> Iterator[None]:
    """Whatever the system refuses, as an error that names the path.

    Raises:
        DataError: It did.
    """
    try:
        yield
    except OSError as error:
        raise DataError(f"{path}: cannot be written ({error.strerror})") from error


def _is_report(folder: Path) -> bool:
    if (folder / _MARK).is_file():
        return True
    numbers = folder / _NUMBERS  # a report from before there was a mark
    return (folder / _FOLDER).is_dir() and numbers.is_file() and _OURS in numbers.read_bytes()


def _differences(kind: str, before: _Basis, now: _Basis) -> Iterator[str]:
    if now.program != before.program:
        yield f"the sources of {kind}"
    for name in sorted({*before.files, *now.files}):
        if before.files.get(name) != now.files.get(name):
            yield name
