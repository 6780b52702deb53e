"""What a scene exerts besides its inertias, by which a learned model knows its scene again.

Numbers in a file can say the same in many ways; forces cannot. So parts are asked for their forces
at some states within the range of the model, and dependent joints for where they are.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from mbd_ros.core.contracts.parts import Load
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.learned.model_file import About
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import NONE, Array, State
from mbd_ros.errors import ModelError

_STATES = 4
_SAME = 1.0e-6  # of the largest number: what writing and reading a scene leaves
_FORCE = "force "  # how names of forces begin
_ROTORS = "inertia of drives"


def physics_of(
    robot: Robot, couplings: Couplings, forces: Sequence[Load], said: About
) -> dict[str, list[float]]:
    """Forces of each part, places of dependent joints, and inertia of drives.

    Args:
        robot: The robot.
        couplings: Its dependent joints.
        forces: Parts that act by themselves, without the model itself.
        said: Joints and range of the model.

    Returns:
        By words for people, what exerts nothing left out.
    """
    asked = [part for part in forces if not part.inputs and not part.internal]
    k, at = Kinematics(robot), [robot.joint(name).v for name in said.joints]
    found: dict[str, list[float]] = {}
    for q, v in _states(robot, couplings, said):
        k.refresh(q, v, max((part.reads for part in asked), default=Reads.NOTHING))
        for part in asked:
            force = part.force(k, State(0.0, q, v), NONE)[at]
            found.setdefault(f"{_FORCE}'{part.name}'", []).extend(force.tolist())
        for name in couplings.dependent:
            place = float(q[robot.joint(name).q])
            found.setdefault(f"coupling of '{name}'", []).append(place)
    found = {name: values for name, values in found.items() if np.any(values)}
    return found | {_ROTORS: robot.model.armature[at].tolist()}


def check_physics(name: str, said: About, here: Mapping[str, Sequence[float]]) -> None:
    """Refuse a model that was learned beside other forces, couplings or drives.

    Args:
        name: Of the file.
        said: What it says of itself.
        here: As `physics_of` gives it of the scene.

    Raises:
        ModelError: Names file and what differs.
    """
    same = _forces(said.physics, here)
    for key in {**said.physics, **here} if said.physics else ():
        if key in same:
            continue
        there, own = (np.array(one.get(key, ()), dtype=float) for one in (said.physics, here))
        if not len(own):
            what = f"which had {key}; this scene has not"
        elif not len(there):
            what = f"which had no {key}; this scene has"
        elif there.shape != own.shape or _differ(there, own):
            what = f"with another {key}"
        else:
            continue
        raise ModelError(
            f"{name} was learned on {said.scene}, {what}: a residual belongs to the forces "
            "that it was learned beside; learn it again, or load that scene"
        )


def _forces(said: Mapping[str, Sequence[float]], here: Mapping[str, Sequence[float]]) -> set[str]:
    """Names of forces, where they exert the same in all whatever they are called."""
    names = [{key for key in one if key.startswith(_FORCE)} for one in (said, here)]
    sums = [
        np.sum([one[key] for key in own], axis=0)
        for one, own in zip((said, here), names, strict=True)
    ]
    is_same = sums[0].shape == sums[1].shape and sums[0].size and not _differ(*sums)
    return names[0] | names[1] if is_same else set()


def _differ(there: Array, own: Array) -> bool:
    return float(np.abs(there - own).max()) > _SAME * float(np.abs(there).max())


def _states(robot: Robot, couplings: Couplings, said: About) -> list[tuple[Array, Array]]:
    """Positions and velocities of all joints, the same for the same range."""
    random, m = np.random.default_rng(0), len(said.joints)
    joints, found = [robot.joint(name) for name in said.joints], []
    for _ in range(_STATES):
        values = random.uniform(said.low, said.high)
        q, v, a = robot.neutral().copy(), *np.zeros((2, robot.model.nv))
        for joint, place, rate in zip(joints, values[:m], values[m:], strict=True):
            q[joint.q], v[joint.v] = place, rate
        couplings.expand(q, v, a)
        found.append((q, v))
    return found
