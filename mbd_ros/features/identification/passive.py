"""Joints that no motor drives."""

from collections.abc import Sequence

import numpy as np

from mbd_ros.errors import DataError
from mbd_ros.features.identification.samples import Recorded
from mbd_ros.jobs.lines import Say
from mbd_ros.scene.built_scene import Scene


def passive_joints(
    scene: Scene, named: Sequence[str], recorded: Sequence[Recorded], say: Say
) -> tuple[str, ...]:
    """Joints whose effort is 0: those named, else those by which the first body is placed.

    Without any effort, a chain of joints from the world to the first link with mass is what
    measured a body that moves freely, such as the pelvis in a model of a person.

    Args:
        scene: The scene.
        named: Joints that the user names.
        recorded: The recordings.
        say: Is told which they are.

    Raises:
        DataError: Unknown joints.
    """
    joints = scene.couplings.independent
    unknown = [name for name in named if name not in joints]
    if unknown:
        raise DataError(f"--passive {unknown[0]}: no such joint; there are {', '.join(joints)}")
    if named:
        return tuple(named)
    has_effort = any(one.motion.effort is not None for one in recorded)
    if has_effort or not scene.wrenches or scene.robot.floating:
        return ()
    model, chain, at = scene.robot.model, list[str](), 0
    while True:
        below = [j for j in range(1, model.njoints) if int(model.parents[j]) == at]
        if len(below) != 1:
            break
        at = below[0]
        names = [j.name for j in scene.robot.joints if model.getJointId(j.urdf_name) == at]
        chain += [name for name in names if name in joints]
        if model.inertias[at].mass > 0.0:
            break
    if len(chain) > 1:
        say(
            f"no efforts: {', '.join(chain)} place a body that nothing drives, its balance is used"
        )
        return tuple(chain)
    return ()


def driven_joints(scene: Scene, recorded: Sequence[Recorded]) -> list[str]:
    """Independent joints with an effort that is not 0 throughout.

    Raises:
        DataError: There is none.
    """
    names, found = scene.couplings.independent, []
    for i, name in enumerate(names):
        efforts = [one.motion.effort for one in recorded]
        known = [effort[:, i] for effort in efforts if effort is not None]
        if known and all(np.isfinite(e).mean() > 0.99 and e.any() for e in known):
            found.append(name)
    if not found:
        where = ", ".join(one.where for one in recorded)
        raise DataError(f"{where}: no effort of any of {', '.join(names)}")
    return found
