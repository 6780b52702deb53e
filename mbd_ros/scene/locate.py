"""Files that a scene names."""

import argparse
import os
import sys
from pathlib import Path

from mbd_ros.errors import SceneError, printable


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


def find_file(folder: Path, name: str, where: str) -> Path:
    """A file that a scene names, relative to its folder or as `package://<package>/<path>`.

    Raises:
        SceneError: The package is not installed.
    """
    if not name.startswith("package://"):
        return folder / name
    package, _, rest = name.removeprefix("package://").partition("/")
    if ".." in (package, *Path(rest).parts) or Path(rest).is_absolute():
        raise SceneError(f"{where}: {name} leaves the package")
    prefixes = [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    shares = [Path(prefix) / "share" / package for prefix in prefixes if prefix]
    if package == "mbd_ros":
        shares.append(Path(__file__).resolve().parents[2])
    for share in shares:
        try:
            if (share / rest).is_file():
                return share / rest
        except OSError as error:
            raise SceneError(f"{where}: {name} cannot be read: {error.strerror}") from error
    raise SceneError(f"{where}: {name} not found in {', '.join(map(str, shares))}")
