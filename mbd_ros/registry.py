"""Where every part lives: one line a part, imported only when a scene names it."""

import importlib
import inspect
from collections.abc import Mapping
from typing import Any

from mbd_ros.errors import SceneError

PARTS: Mapping[str, Mapping[str, str]] = {
    "forces": {
        "joint_friction": "mbd_ros.forces.joint_friction:JointFriction",
        "joint_spring": "mbd_ros.forces.joint_spring:JointSpring",
    },
}
METHODS = {"forces": "force"}  # what the parts of a section must have


def resolve(section: str, name: str, where: str) -> Any:
    """The class behind `type: name` in a section of a scene.

    Args:
        section: Key of the scene, such as `forces`.
        name: A name of the registry, or `package.module:Class` of code outside this package.
        where: File and key, for the messages.

    Raises:
        SceneError: There is none; lists what exists.
    """
    target = PARTS[section].get(name, name)
    module, _, attribute = target.partition(":")
    if not all(word.isidentifier() for word in (*module.split("."), attribute)):
        accepted = ", ".join(PARTS[section])
        raise SceneError(
            f"{where}: unknown type '{name}', accepted: {accepted}, or package.module:Class"
        )
    try:
        part = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise SceneError(f"{where}: type '{name}': {error}") from error
    if not (inspect.isclass(part) and hasattr(part, METHODS[section])):
        raise SceneError(
            f"{where}: type '{name}' is not a class with a method '{METHODS[section]}'"
        )
    return part
