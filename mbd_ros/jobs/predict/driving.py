"""What drives a scene whose motion is looked for."""

from mbd_ros.errors import SceneError
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.predict_recording import DrivenBy
from mbd_ros.scene.smooth_muscles import smooth_entries

DRIVES = "drives"  # ideal ones in all independent joints
_RESIDUAL = "_residual"


def driven(scene: Scene, by: DrivenBy = "scene") -> Scene:
    """The scene with what drives it.

    Args:
        scene: The scene.
        by: `scene`: what it has; without any input an ideal drive in every independent joint.
            `joints`: these drives, and wrenches on free bases, in place of muscles and actuators.
            `muscles`: the same beside its muscles, with smooth curves and rigid tendons.

    Raises:
        SceneError: There are no muscles.
    """
    own = [name for name in scene.inputs.slots if name not in scene.wrenches]
    if by == "scene" and own:
        return scene
    names = [one.name for one in scene.robot.joints if one.name in scene.couplings.independent]
    drives = {"type": "ideal", "joints": names, "name": DRIVES}
    if by == "scene":
        return scene.with_(actuators=[drives])
    if by == "muscles" and not scene.muscles:
        raise SceneError(f"{scene.name}: driven_by: muscles: the scene has none")
    muscles = smooth_entries(scene, {"tendon": "rigid"}) if by == "muscles" else None
    wrenches = {f"{one.name}{_RESIDUAL}": {"frame": one.frame} for one in scene.robot.bases}
    given = scene.entries.get("external_wrenches") or {}
    return scene.with_(
        muscles=muscles,
        actuators=[drives],
        external_wrenches={**given, **wrenches} or None,
    )


def is_residual(name: str) -> bool:
    """Whether a wrench drives a free base."""
    return name.endswith(_RESIDUAL)
