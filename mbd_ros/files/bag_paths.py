"""The files of a bag, and places where a bag may be written."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from mmap import ACCESS_READ, mmap
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from mbd_ros.core.model.robot import BASE
from mbd_ros.errors import DataError, SceneError
from mbd_ros.regular_file import open_regular
from mbd_ros.scene.schema.strict_yaml import read_mapping

SUFFIXES = (".mcap", ".db3")
MARK = ("written_by", "mbd_ros")
JOINT_STATES, ODOMETRY = "joint_states", "odometry"
WORLD = "world"  # frame in which poses of free bodies are given


def check_source(path: Path) -> BagFiles:
    """Refuse paths that are no bag, and a folder whose files are not all inside of it.

    Returns:
        Its files.

    Raises:
        DataError: What is wrong with which file.
    """
    if not path.exists():
        raise DataError(f"{path}: does not exist")
    if not path.is_dir() and (path.suffix not in SUFFIXES or not path.is_file()):
        raise DataError(f"{path}: not a bag, expected a rosbag2 folder, .mcap or .db3 file")
    bag = _bag_files(path) if path.is_dir() else BagFiles([path], is_packed=False)
    for file in bag.storage:
        check_sqlite_path(file)
    return bag


class BagFiles(NamedTuple):
    """The files of a bag.

    Attributes:
        storage: Files with messages.
        is_packed: Whether each of them is compressed as a whole.
    """

    storage: list[Path]
    is_packed: bool


def _bag_files(folder: Path) -> BagFiles:
    metadata = folder / "metadata.yaml"
    if not metadata.is_file():
        raise DataError(f"{folder}: no metadata.yaml in it, so not a rosbag2 folder")
    try:
        info = read_mapping(metadata, "metadata of the bag")["rosbag2_bagfile_information"]
    except SceneError as error:
        raise DataError(str(error)) from error
    files = [metadata]
    for name in info["relative_file_paths"]:
        named = PurePosixPath(name)
        files.append(folder / named.name)  # before version 4 the folder itself is named, too
        if named.is_absolute() or ".." in named.parts:
            raise DataError(f"{metadata}: relative_file_paths: {name!r} leads out of the bag")
        if not files[-1].is_file():
            raise DataError(f"{metadata}: relative_file_paths: {name!r} is no file of the bag")
    for file in files:
        if not file.resolve().is_relative_to(folder.resolve()):
            raise DataError(f"{file}: is a link that leads out of the bag")
    return BagFiles(files[1:], str(info.get("compression_mode")).lower() == "file")


def check_target(path: Path) -> None:
    """Refuse to replace anything but a bag of this package.

    Args:
        path: A folder, or a file ending in .mcap or .db3.

    Raises:
        DataError: Another suffix, no directory to write in, or a place that is taken.
    """
    if path.suffix not in SUFFIXES and path.suffix and not path.is_dir():
        raise DataError(f"{path}: {path.suffix!r} is no bag, expected a folder, .mcap or .db3")
    if not path.parent.is_dir():
        raise DataError(f"{path}: directory {path.parent} does not exist")
    check_sqlite_path(path)
    if (path.exists() or path.is_symlink()) and not _is_ours(path):
        raise DataError(f"{path}: exists and is not a bag written by mbd_ros, not replaced")


def _is_ours(path: Path) -> bool:
    files = list(path.iterdir()) if path.is_dir() else [path]
    names = {file.name for file in files}
    known = all(file.suffix in SUFFIXES or file.name == "metadata.yaml" for file in files)
    if (
        path.is_symlink()
        or not known
        or not all(f.is_file() and not f.is_symlink() for f in files)
    ):
        return False
    if path.is_dir() and "metadata.yaml" not in names:
        return False
    marked = path / "metadata.yaml" if path.is_dir() else path
    try:
        with open_regular(marked) as file, mmap(file.fileno(), 0, access=ACCESS_READ) as content:
            return content.find(": ".join(MARK).encode()) >= 0
    except (OSError, ValueError):  # it may not be read, or is empty
        return False


def check_sqlite_path(path: Path) -> None:
    """Refuse characters that change meaning in the `file:` address of sqlite in rosbags."""
    if path.suffix == ".db3" and set("#?%") & set(str(path)):
        raise DataError(f"{path}: the path of a .db3 file must not contain '#', '?' or '%'")


def beside(topic: str, other: str) -> str:
    """The topic of another message of the same robot: `/a/odometry` beside `/a/joint_states`.

    Args:
        topic: Of the joint states of the only robot.
    """
    return f"{topic.rpartition('/')[0]}/{other}"


def by_member(joints: Sequence[str], members: Collection[str]) -> dict[str, dict[str, str]]:
    """Robot or body -> name of a joint on its topic -> name in the scene.

    Args:
        joints: Names in the scene, such as `left/elbow`.
        members: Names of the robots and bodies among those of the scene.
    """
    joints_of: dict[str, dict[str, str]] = {}
    for joint in joints:
        member, _, own = joint.partition("/")
        pair = (member, own) if member in members else ("", joint)
        joints_of.setdefault(pair[0], {})[pair[1]] = joint
    return joints_of


def joint_state_topic(member: str) -> str:
    """Topic of the joint states of a robot or body of a scene, of the only robot where empty."""
    return f"{member}/{JOINT_STATES}" if member else JOINT_STATES


def odometry_topic(body: str) -> str:
    """Topic of the pose and twist of a free body."""
    return ODOMETRY if body == BASE else f"{body}/{ODOMETRY}"
