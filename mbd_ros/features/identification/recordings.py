"""Recordings of a task: with what is held in some of them, and in units of torque."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import zip_longest

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.inertial_parameters import COUNT, moved_numbers
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, ModelError
from mbd_ros.features.identification.samples import Piece, Recorded, read
from mbd_ros.features.identification.task import Task
from mbd_ros.jobs.lines import Say
from mbd_ros.scene.built_scene import Scene


def recordings(scene: Scene, task: Task, say: Say) -> Iterator[Recorded]:
    """All recordings, those with a known load last.

    Raises:
        DataError: There is none, or the load or a wrench is missing.
    """
    sources = (*task.motions, *task.held)
    if task.wrenches and len(task.wrenches) != len(sources):
        raise DataError(
            f"--wrenches: {len(task.wrenches)} for {len(sources)} motions; give one for each"
        )
    if not sources:
        raise DataError("no motion to identify from")
    if bool(task.held) != (task.payload is not None):
        raise DataError("--held and --payload: give the recording and what it holds")
    carried = None if task.payload is None else _carried(scene, *task.payload)
    for i, (source, load) in enumerate(zip_longest(sources, task.wrenches)):
        options = {"topic": task.topic, "derivatives": task.derivatives, "say": say}
        found = read(scene, source, wrenches=load, **options)  # type: ignore[arg-type]
        yield found if i < len(task.motions) else found._replace(carried=carried)


def _carried(scene: Scene, frame: str, numbers: Sequence[float]) -> Array:
    """Inertial numbers of all bodies of what is fixed to a link, shape (10 bodies,)."""
    model = scene.robot.model
    try:
        link = model.frames[scene.robot.frame(frame)]
    except ModelError as error:
        raise DataError(f"--payload {frame}: {error}") from error
    joint = int(link.parentJoint)
    if joint == 0:
        raise DataError(f"--payload {frame}: this link does not move")
    mass, x, y, z, *moments = numbers
    load = pin.Inertia(mass, np.array([x, y, z]), np.diag(moments or [0.0, 0.0, 0.0]))
    own = load.toDynamicParameters()
    found = np.zeros(COUNT * (model.njoints - 1))
    found[COUNT * (joint - 1) : COUNT * joint] = moved_numbers(link.placement) @ own
    return found


def gained(
    found: Iterable[Piece], names: Sequence[str], gains: Mapping[str, float]
) -> Iterator[Piece]:
    """Pieces with the torques of efforts in other units.

    Raises:
        DataError: A gain of no joint.
    """
    unknown = [name for name in gains if name not in names]
    if unknown:
        raise DataError(f"--gain {unknown[0]}: no such joint; there are {', '.join(names)}")
    factors = np.array([gains.get(name, 1.0) for name in names])
    for piece in found:
        yield piece._replace(effort=factors * piece.effort, measured=factors * piece.measured)
