"""Joints that change their names between two phases: exchanged legs."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from mbd_ros.core.events.phase_reset import Relabelling
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import NotZero
from mbd_ros.core.thresholds import TINY
from mbd_ros.errors import SceneError
from mbd_ros.scene import schema
from mbd_ros.scene.phase_entries import ResetEntry

Sources = dict[str, dict[str, float]]


def relabelling_of(robot: Robot, entry: ResetEntry, where: str) -> Relabelling | None:
    """The relabelling of a reset; None where joints keep their names.

    Args:
        robot: The robot.
        entry: The reset; its names are those of joints.
        where: File and key, for the messages.

    Raises:
        SceneError: A joint that is given twice, or joints that cannot be told apart afterwards.
    """
    sources = {name: dict(given) for name, given in (entry.relabel or {}).items()}
    for name, given in (entry.exchange or {}).items():
        _exchange(robot, sources, name, given, f"{where}.exchange.{name}")
    shifts = entry.shift or {}
    names = list(dict.fromkeys([*sources, *shifts, *(n for s in sources.values() for n in s)]))
    if not names:
        return None
    A, b = np.eye(len(names)), np.zeros(len(names))
    for name, given in sources.items():
        row = names.index(name)
        A[row] = 0.0
        for source, factor in given.items():
            A[row, names.index(source)] = factor
    for name, shift in shifts.items():
        b[names.index(name)] = shift
    if not abs(np.linalg.det(A)) > TINY:
        raise SceneError(
            f"{where}: {', '.join(names)} cannot be told apart afterwards: every joint needs a "
            "source of its own"
        )
    joints = [robot.joint(name) for name in names]
    q, v = ([getattr(joint, key) for joint in joints] for key in ("q", "v"))
    return Relabelling(np.array(q, dtype=np.intp), np.array(v, dtype=np.intp), A, b)


def _exchange(robot: Robot, sources: Sources, name: str, given: Any, where: str) -> None:
    """Two joints take the place of each other, perhaps with the sign of their axis."""
    entry = given if isinstance(given, Mapping) else {"joint": given}
    other, factor = schema.call(_swapped, entry, where)
    from mbd_ros.scene.phase_entries import known

    other = known(other, [joint.name for joint in robot.joints], "joint", where)
    for one in {name, other}:
        if one in sources:
            raise SceneError(f"{where}: joint {one} is relabelled twice")
    sources[name] = {other: factor}
    sources[other] = {name: 1.0 / factor}


def _swapped(joint: str, factor: NotZero = 1.0) -> tuple[str, float]:
    return joint, factor
