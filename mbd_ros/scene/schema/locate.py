"""Places of scenes, and of the files that they name."""

import argparse
import os
import sys
from pathlib import Path

from mbd_ros.errors import SceneError, printable

_SCENES, _TASKS = Path("config/scenes"), Path("config/tasks")


def path_word(text: str) -> Path:
    """A word of the command line that names a file or folder, there or to be written.

    Raises:
        argparse.ArgumentTypeError: No file can have that name, or its links lead in a circle.
    """
    path = Path(text)
    try:
        path.resolve()
        path.is_dir()
    except (OSError, RuntimeError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise argparse.ArgumentTypeError(
            printable(f"'{text}': cannot be used: {reason}")
        ) from error
    return path


def scene_word(text: str) -> Path | str:
    """A word of the command line that names a scene, as `find_scene` understands it.

    Returns:
        The file, or the word where there is none: `load_scene` refuses it, once the other words
        are understood.

    Raises:
        argparse.ArgumentTypeError: No file can have that name.
    """
    try:
        path = find_scene(text)
    except SceneError:
        return text
    return path_word(str(path))


def find_scene(name: str | Path) -> Path:
    """The file of a scene.

    Args:
        name: A file, `package://<package>/<path>`, or the name of an embedded scene, such as
            `arm7` or `benchmark/a01_pendulum`. A name with a suffix is always a file. A name
            without one is an embedded scene, unless a file of that name exists.

    Returns:
        The file; where only a file can be meant, the reader finds out whether it exists.

    Raises:
        SceneError: There is neither a file nor a scene of that name; with the nearest names.
    """
    text = str(name)
    if text.startswith("package://"):
        return find_file(Path(), text, "scene")
    if Path(text).suffix or (os.path.exists(text) and not os.path.isdir(text)):
        return Path(text)
    embedded = embedded_scenes()
    if text in embedded:
        return embedded[text]
    if os.path.exists(text) or (os.sep in text and Path(text).parent.is_dir()):
        return Path(text)
    from mbd_ros.scene.schema.nearest import nearest  # here, since it serves errors only

    close = nearest(text, embedded)
    hint = f"nearest: {', '.join(close)}; " if close else ""
    raise SceneError(
        f"{text}: there is no such file, and no embedded scene of that name; {hint}"
        "`mbd-ros scenes` lists them"
    )


def find_task(name: str | Path) -> Path:
    """The file of a task.

    Args:
        name: A file, `package://<package>/<path>`, or the name of an embedded task, such as
            `arm_reach`, unless a file of that name exists.

    Raises:
        SceneError: The package is not installed.
    """
    text = str(name)
    if not Path(text).suffix and not os.path.exists(text):
        for share in (*_own_shares(), *_shares("mbd_ros")):
            file = share / _TASKS / f"{text}.yaml"
            if file.is_file():
                return file
    return find_file(Path(), text, "task")


def embedded_scenes() -> dict[str, Path]:
    """The scenes of this package, in order: name -> file."""
    for share in (*_own_shares(), *_shares("mbd_ros")):
        folder = share / _SCENES
        if folder.is_dir():
            files = sorted(folder.rglob("*.yaml"), key=lambda file: (file.parent, file.name))
            return {file.relative_to(folder).with_suffix("").as_posix(): file for file in files}
    return {}


def _own_shares() -> list[Path]:
    """Where this very copy of the package may have its data: a checkout, a folder, a prefix."""
    above = Path(__file__).resolve().parents[3:7]
    return [above[0], *(folder / "share" / "mbd_ros" for folder in above)]


def _shares(package: str) -> list[Path]:
    """Where ROS and Python install the data of a package."""
    prefixes = [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    return [Path(prefix) / "share" / package for prefix in prefixes if prefix]


def find_file(folder: Path, name: str, where: str) -> Path:
    """A file that a scene names, relative to its folder or as `package://<package>/<path>`.

    Raises:
        SceneError: The package is not installed.
    """
    if not name.startswith("package://"):
        return Path(os.path.normpath(folder / name))
    package, _, rest = name.removeprefix("package://").partition("/")
    if ".." in (package, *Path(rest).parts) or Path(rest).is_absolute():
        raise SceneError(f"{where}: {name} leaves the package")
    shares = _shares(package)
    if package == "mbd_ros":
        shares += _own_shares()
    for share in shares:
        try:
            if (share / rest).is_file():
                return share / rest
        except OSError as error:
            raise SceneError(f"{where}: {name} cannot be read: {error.strerror}") from error
    raise SceneError(f"{where}: {name} not found in {', '.join(map(str, shares))}")
