"""Results on disk, a file an item, and what they depend on."""

from __future__ import annotations

import ast
import hashlib
import importlib.metadata
import importlib.util
import json
import platform
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import yaml

import mbd_ros
from mbd_ros.applications.report import items
from mbd_ros.applications.report.items import Item
from mbd_ros.errors import DataError, SceneError
from mbd_ros.files.output_folder import place_in
from mbd_ros.files.text_file import replacing
from mbd_ros.jobs.workers.task import Result
from mbd_ros.regular_file import open_regular
from mbd_ros.scene.schema.locate import find_file

VERSIONS = ("numpy", "pin", "proxsuite", "scipy", "casadi", "mujoco", "drake", "exudyn")
_REPORT = "mbd_ros.applications.report"
_REGISTRY = f"{_REPORT}.items"  # names all parts, of which none loads another one
_MODULE = re.compile(rf"{re.escape(_REPORT)}(\.\w+)+", re.ASCII)
_EMPTY = "package://mbd_ros/config/scenes/empty.yaml"
_NAME = re.compile(r"[\w.-]+", re.ASCII)
_FOLDER, _MARK, _NUMBERS = "results", ".mbd_ros_report", "report.json"
_OURS = b'"sections"'  # in the numbers of a report


class Store:
    """Results below a folder, found again by item and by what made them.

    Args:
        folder: That of the report; created.
        cpu: Processor on which items of this run are timed.

    Raises:
        DataError: The folder holds something else, or cannot be written.
    """

    def __init__(self, folder: Path, cpu: str) -> None:
        with naming_file(folder):
            if folder.exists() and not folder.is_dir():
                raise DataError(f"{folder}: is not a folder")
            if folder.is_dir() and any(folder.iterdir()) and not _is_report(folder):
                raise DataError(f"{folder}: holds something else than a report")
            self.folder = place_in(folder, _FOLDER)
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
            with open_regular(self._path(item, basis, self._cpu)) as file:
                stored = json.load(file)
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
        with naming_file(path):
            path.parent.mkdir(exist_ok=True)
            with replacing(path) as file:
                file.write(json.dumps({**item._asdict(), **entry}).encode())

    def _path(self, item: Item, basis: _Basis, cpu: str) -> Path:
        if not _NAME.fullmatch(item.name):
            raise ValueError(f"name of a {item.kind} item: {item.name!r}")
        parts = [item.name, item.spec, basis.files, cpu if item.alone else ""]
        identity = hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
        kind = f"{item.kind}-{basis.program[:12]}"
        return place_in(self.folder, kind, f"{item.name[:100]}-{identity[:12]}.json")


@contextmanager
def naming_file(path: Path) -> Iterator[None]:
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


class _Basis(NamedTuple):
    """Dependencies of a result besides its item: hashes of the program and of named files."""

    program: str
    files: Mapping[str, str]


def program_now(module: str) -> str:
    """Hash of all sources and versions of a part, read now.

    These are the package without nodes and other parts of the report, its scenes and robots, and
    the versions of the packages below. Modules that only show results are not among them.

    Args:
        module: That of the part.
    """
    root = Path(mbd_ros.__path__[0])
    files = {path for path in root.rglob("*.py") if _computes(path.relative_to(root))}
    files |= {*root.glob("report/**/*.json"), *root.glob("compiled/**/*.[ch]"), *_needed(module)}
    config = find_file(Path(), _EMPTY, "report").parents[1]
    files |= {path for path in config.rglob("*") if path.is_file()}
    parts = [f"{name} {version}" for name, version in versions().items()]
    return _hash([*parts, *sorted(_contents(files))])


def _computes(path: Path) -> bool:
    return path.parts[0] not in ("nodes", "demo", "report", "cli.py")


def _needed(module: str) -> set[Path]:
    """Files of a module and of all modules of the report that it needs, directly or not."""
    files, waiting, seen = set(), [module], set()
    while waiting:
        name = waiting.pop()
        if name in seen:
            continue
        seen.add(name)
        file = _file(name)
        if file is not None:
            files.add(file)
            waiting += _mentioned(file.read_bytes(), name != _REGISTRY)
    return files


def _file(module: str) -> Path | None:
    try:
        spec = importlib.util.find_spec(module)
    except ModuleNotFoundError:  # a text that only looks like the name of a module
        return None
    return Path(spec.origin) if spec is not None and spec.origin is not None else None


@cache
def _mentioned(source: bytes, with_texts: bool) -> tuple[str, ...]:
    """Modules of the report that a source imports, or names in a text to load them later."""
    names: list[str] = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and with_texts:
            names.append(node.value)
        names += _names(node)
    return tuple(name for name in names if _MODULE.fullmatch(name))


def _names(node: ast.AST) -> list[str]:
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        module = str(node.module)
        within = [f"{module}.{alias.name}" for alias in node.names]
        return within if _is_package(module) else [module]
    return []


def _is_package(module: str) -> bool:
    """Whether this is a folder of the report."""
    if module != _REPORT and not module.startswith(f"{_REPORT}."):
        return False
    spec = importlib.util.find_spec(module)
    return spec is not None and spec.submodule_search_locations is not None


def _hash(lines: Iterable[str]) -> str:
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def _contents(files: Iterable[Path]) -> Iterator[str]:
    for path in files:
        yield f"{path.name} {hashlib.sha256(path.read_bytes()).hexdigest()}"


def _differences(kind: str, before: _Basis, now: _Basis) -> Iterator[str]:
    if now.program != before.program:
        yield f"the sources of {kind}"
    for name in sorted({*before.files, *now.files}):
        if before.files.get(name) != now.files.get(name):
            yield name


@cache
def program(module: str) -> str:
    """The first result of `program_now`."""
    return program_now(module)


def versions(names: Iterable[str] = VERSIONS) -> dict[str, str]:
    """Versions of those packages that are installed."""
    version_of = {"python": platform.python_version()}
    for name in names:
        try:
            version_of[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return version_of


def named_files(value: Any) -> dict[str, str]:
    """Files that a spec names, and that scenes among them name, with hashes of their content."""
    found: dict[str, str] = {}
    for text in _strings(value):
        _add(found, Path(), text)
    return found


def _strings(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for entry in value.values():
            yield from _strings(entry)
    elif isinstance(value, list | tuple):
        for entry in value:
            yield from _strings(entry)


def _add(hashes: dict[str, str], folder: Path, text: str) -> None:
    if not text or len(text) > 1000 or "\n" in text or "\0" in text:
        return
    try:
        path = find_file(folder, text, "report")
        if path.is_file() and str(path) not in hashes:
            hashes[str(path)], named = _read(path)
            for entry in named:
                _add(hashes, path.parent, entry)
    except (SceneError, OSError):  # a text that is no file
        return


def _read(path: Path) -> tuple[str, tuple[str, ...]]:
    """Hash of a file, and the texts in it where it is YAML."""
    content = path.read_bytes()
    is_yaml = path.suffix in (".yaml", ".yml")
    return hashlib.sha256(content).hexdigest(), _texts(content) if is_yaml else ()


@cache
def _texts(content: bytes) -> tuple[str, ...]:
    with suppress(yaml.YAMLError):
        return tuple(_strings(yaml.safe_load(content)))
    return ()
