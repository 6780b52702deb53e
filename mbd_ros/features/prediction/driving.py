"""What drives a scene whose motion is looked for."""

import itertools
from collections.abc import Iterable, Mapping
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

from mbd_ros.errors import SceneError
from mbd_ros.features.prediction.smooth_muscles import smooth_entries
from mbd_ros.features.prediction.task_recording import DrivenBy
from mbd_ros.scene.built_scene import Scene

DRIVES = "drives"  # ideal ones in all independent joints
_RESIDUAL = "_residual"


class Driven(NamedTuple):
    """A scene with what drives it.

    Attributes:
        scene: The scene.
        residuals: Names of the wrenches that drive its free bases.
    """

    scene: Scene
    residuals: tuple[str, ...] = ()


def driven(scene: Scene, by: DrivenBy = "scene", bounded: Iterable[str] = ()) -> Driven:
    """The scene with what drives it.

    Args:
        scene: The scene.
        by: `scene`: what it has; without any input an ideal drive in every independent joint.
            `joints`: these drives, and wrenches on free bases, in place of muscles and actuators.
            `muscles`: the same beside its muscles, with smooth curves and rigid tendons.
        bounded: Names of quantities with bounds; external wrenches among them drive the scene.

    Raises:
        SceneError: There are no muscles, or nothing that drives.
    """
    own = [name for name in scene.inputs.slots if name not in scene.wrenches]
    if by == "scene" and (own or driving_wrenches(scene, bounded)):
        return Driven(scene)
    names = [one.name for one in scene.robot.joints if one.name in scene.couplings.independent]
    drives = [{"type": "ideal", "joints": names, "name": DRIVES}] if names else []
    if by == "scene" and not drives:
        raise SceneError(
            f"{scene.name}: nothing drives it; accepted: actuators, external_wrenches that have "
            "bounds in the task, or driven_by: joints"
        )
    if by == "scene":
        return Driven(scene.with_(actuators=drives))
    if by == "muscles" and not scene.muscles:
        raise SceneError(f"{scene.name}: driven_by: muscles: the scene has none")
    muscles = smooth_entries(scene, {"tendon": "rigid"}) if by == "muscles" else None
    given = scene.entries.get("external_wrenches") or {}
    wrenches = {
        _untaken(f"{one.name}{_RESIDUAL}", given): {"frame": one.frame}
        for one in scene.robot.bases
    }
    found = scene.with_(
        muscles=muscles,
        actuators=drives,
        external_wrenches={**given, **wrenches} or None,
    )
    return Driven(found, tuple(wrenches))


def driving_wrenches(scene: Scene, bounded: Iterable[str]) -> tuple[str, ...]:
    """Components of external wrenches that have bounds, as inputs are called."""
    names, patterns = scene.inputs.names, tuple(bounded)
    slots = (scene.inputs.slots[name] for name in scene.wrenches)
    every = (name for one in slots for name in names[one.start : one.stop])
    return tuple(name for name in every if any(fnmatchcase(name, key) for key in patterns))


def _untaken(name: str, taken: Mapping[str, Any]) -> str:
    """The name, numbered where a wrench of the scene has it."""
    numbered = (f"{name}_{number}" for number in itertools.count(2))
    return next(one for one in itertools.chain([name], numbered) if one not in taken)
