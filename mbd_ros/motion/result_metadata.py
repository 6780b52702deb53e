"""What a result says of where it comes from."""

import platform
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from mbd_ros.files.table import Result
from mbd_ros.motion.recordings import name_of
from mbd_ros.scene.built_scene import Scene


def metadata_of(
    job: str, scene: Scene, inputs: Mapping[str, Any], topics: Mapping[str, Any]
) -> dict[str, Any]:
    """Metadata of a result.

    Args:
        job: Name of the command.
        scene: The scene.
        inputs: What the job was asked for; files by their names, None is left out.
        topics: Topics of a bag, see `bag_streams`.
    """
    given = {key: _plain(value) for key, value in inputs.items() if value is not None}
    return {
        "job": job,
        "scene": scene.name,
        "inputs": given,
        "versions": dict(_versions()),
        "topics": dict(topics),
    }


def _plain(value: Any) -> Any:
    if isinstance(value, Result):
        return {"job": value.metadata.get("job", ""), "inputs": value.metadata.get("inputs", {})}
    return value if isinstance(value, int | float | str | list | dict) else name_of(value)


@cache
def _versions() -> tuple[tuple[str, str], ...]:
    found = [("python", platform.python_version())]
    for package, name in (("mbd_ros", "mbd_ros"), ("pinocchio", "pin"), ("numpy", "numpy")):
        try:
            found.append((package, version(name)))
        except PackageNotFoundError:  # colcon and conda install without what pip knows
            found.append((package, "unknown"))
    return tuple(found)
