"""Muscles of a scene with curves that have derivatives of every order."""

import inspect
from collections.abc import Mapping
from typing import Any

from mbd_ros.errors import SceneError
from mbd_ros.scene.built_scene import Scene

SMOOTH = "degroote_fregly"
_KEPT = (
    "path",
    "max_isometric_force",
    "optimal_fiber_length",
    "tendon_slack_length",
    "pennation_angle",
    "maximum_pennation_angle",
    "max_contraction_velocity",
    "activation_time",
    "deactivation_time",
    "minimum_activation",
    "tendon",
    "tendon_strain",
    "passive_strain",
)
_NOTHING: Mapping[str, Any] = {}


def with_smooth_muscles(scene: Scene, more: Mapping[str, Any] = _NOTHING) -> tuple[Scene, str]:
    """A scene whose muscles are `degroote_fregly`, with sizes and times of those it had.

    Args:
        scene: The scene.
        more: Arguments that all of them get besides, such as `tendon`.

    Returns:
        The scene, and what changed, for people.

    Raises:
        SceneError: It has no muscles, or they do not take these arguments.
    """
    if not scene.muscles:
        raise SceneError(f"{scene.name}: muscles: the scene has none")
    types = sorted({str(entry["type"]) for entry in scene.entries["muscles"]})
    words = ", ".join(f"{key} {value}" for key, value in more.items())
    line = f"muscles: {', '.join(types)} -> {SMOOTH}" + (f" with {words}" if words else "")
    return scene.with_(muscles=smooth_entries(scene, more)), line


def smooth_entries(scene: Scene, more: Mapping[str, Any] = _NOTHING) -> list[dict[str, Any]]:
    """Entries of smooth muscles in place of those of a scene; `more` for all of them."""
    given = zip(scene.muscles, scene.entries["muscles"], strict=True)
    return [_smooth(muscle, entry, more) for muscle, entry in given]


def _smooth(muscle: Any, entry: Mapping[str, Any], more: Mapping[str, Any]) -> dict[str, Any]:
    """The entry of a muscle with other curves; what its own left out is what its type says."""
    if entry["type"] == SMOOTH:
        return {**entry, **more}
    usual = inspect.signature(type(muscle).__init__).parameters
    kept = {key: entry.get(key, usual[key].default) for key in _KEPT if key in usual}
    return {"type": SMOOTH, "name": muscle.name, **kept, **more}
