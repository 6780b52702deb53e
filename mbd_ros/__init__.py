"""Multibody dynamics of prostheses and robot arms.

    import mbd_ros as mbd

    scene = mbd.load_scene("prosthetic_arm")
    motion = scene.simulate(1.0)
    torques = scene.inverse(motion)
    torques.to_csv("torques.csv")

Importing this package is cheap: the module behind a name is imported when the name is first used.
"""

from importlib import import_module

TYPE_CHECKING = False  # type checkers read True; importing `typing` would dominate the import time
if TYPE_CHECKING:
    from typing import Any

    from mbd_ros.api import Scene as Scene
    from mbd_ros.api import load_scene as load_scene
    from mbd_ros.api import read_result as read_result
    from mbd_ros.api import read_robot as read_robot
    from mbd_ros.api import scene_from as scene_from
    from mbd_ros.errors import MbdError as MbdError
    from mbd_ros.files.table import Column as Column
    from mbd_ros.files.table import Result as Result
    from mbd_ros.files.table import Table as Table

_HOMES = {
    **dict.fromkeys(("Scene", "load_scene", "read_result", "read_robot", "scene_from"), "api"),
    **dict.fromkeys(("MbdError",), "errors"),
    **dict.fromkeys(("Column", "Result", "Table"), "files.table"),
}
__all__ = ["__version__", *_HOMES]


def __getattr__(name: str) -> "Any":
    if name == "__version__":
        return import_module("importlib.metadata").version(__name__)
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
