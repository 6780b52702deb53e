"""The guess of a task of prediction, and the muscles that it asks for."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mbd_ros.errors import SceneError
from mbd_ros.features.prediction.smooth_muscles import SMOOTH
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.locate import find_file


def guess_of(
    given: Any, where: str, folder: Path
) -> tuple[dict[str, tuple[float, ...]], Path | None]:
    """Lines of a guess, or its file.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    if given is None:
        return {}, None
    if isinstance(given, str):
        return {}, find_file(folder, given, where)
    if not isinstance(given, dict):
        raise SceneError(f"{where}: expected a file, or quantities with values, got {given!r}")
    return {
        str(key): tuple(
            schema.value(
                one if isinstance(one, list) else [one], Sequence[float], f"{where}.{key}"
            )
        )
        for key, one in given.items()
    }, None


def muscles_of(given: Any, where: str) -> Mapping[str, Any] | None:
    """Arguments of the muscles in place of those of the scene; None where these stay.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    if given is None:
        return None
    entry = {"type": given} if isinstance(given, str) else dict(given)
    if entry.pop("type", None) != SMOOTH:
        raise SceneError(f"{where}: accepted: {SMOOTH}, or {{type: {SMOOTH}, tendon: rigid}}")
    return entry
