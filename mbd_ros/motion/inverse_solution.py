"""A recorded motion with everything that explains it."""

from typing import TYPE_CHECKING, NamedTuple

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.jobs.lines import Say
from mbd_ros.motion import closed_chains as loops
from mbd_ros.motion import open_chains
from mbd_ros.motion.explained_motion import Way
from mbd_ros.motion.recordings import name_of
from mbd_ros.motion.samples import Observed, Task, loads_of_laboratory, observe_motion
from mbd_ros.scene.built_scene import Scene

if TYPE_CHECKING:
    from mbd_ros.motion.contact_forces import KnownContact
    from mbd_ros.motion.unmeasured_contacts import Ground


class Solved(NamedTuple):
    """A motion, and what explains it.

    Attributes:
        scene: The scene, with known contacts among its external loads.
        observed: What was solved.
        wrenches: One (n, 6) array for every external load of the scene.
        contacts: Names of the external loads that are forces of contacts.
        known: The contacts that these are forces of.
        ground: Contacts of unknown force; None without any.
        has_loops: Whether rows besides couplings took part.
        way: What was found.
    """

    scene: Scene
    observed: Observed
    wrenches: list[Array]
    contacts: set[str]
    known: "list[KnownContact]"
    ground: "Ground | None"
    has_loops: bool
    way: Way


def solve_motion(scene: Scene, task: Task, say: Say) -> Solved:
    """Efforts and multipliers of a motion; arguments and errors as for `inverse`."""
    external = loads_of_laboratory(scene, task)
    if external is not None:
        scene = external.scene
        for text in external.remarks:
            say(text)
    where = name_of(task.motion)
    for text in scene.robot.doubts:
        say(f"warning: {text}")
    given = set(scene.wrenches)
    scene, known, ground = _known_contacts(scene, task, say)
    has_loops = scene.has_loops or task.bounds or ground is not None
    if task.parts and has_loops:
        raise DataError(f"{scene.name}: --parts goes with scenes without loops and --bounds only")
    observed = observe_motion(scene, task, say, external)
    samples = observed.samples
    scene, wrenches = _with_contacts(scene, known, observed)
    if has_loops:
        if ground is not None:
            ground = ground.told(scene, task.motion, observed)
        way = loops.solve(scene, where, samples, wrenches, task, ground)
    else:
        way = open_chains.solve(scene, where, samples, wrenches, task)
    contacts = {one for one in scene.wrenches if one not in given}
    return Solved(scene, observed, wrenches, contacts, known, ground, has_loops, way)


def _known_contacts(
    scene: Scene, task: Task, say: Say
) -> "tuple[Scene, list[KnownContact], Ground | None]":
    """The scene, contacts whose forces the motion carries, and those of unknown force."""
    if not scene.parts.get("contacts"):
        if task.stance is not None:
            raise DataError(f"{scene.name}: --stance goes with scenes with rigid contacts")
        return scene, [], None
    from mbd_ros.motion.contact_forces import known_contacts  # only where something touches

    tell = say if task.stance is None else lambda text: None
    scene, known = known_contacts(scene, task.motion, task.topic, tell)
    if task.stance is None:
        return scene, known, None
    from mbd_ros.motion.unmeasured_contacts import ground_of

    ground = ground_of(scene, task.stance, [one.name for one in known], say)
    return scene, known, ground if ground.contacts else None


def _with_contacts(
    scene: Scene, known: "list[KnownContact]", observed: Observed
) -> tuple[Scene, list[Array]]:
    """The scene with known contacts among its loads, and the values of all loads."""
    if not known:
        return scene, observed.wrenches
    from mbd_ros.motion.contact_forces import contact_loads

    loads, wrenches = contact_loads(scene, known, observed.motion, observed.samples)
    every = {**scene.wrenches, **loads}
    return scene.holding(external_wrenches=every), [*observed.wrenches, *wrenches]
