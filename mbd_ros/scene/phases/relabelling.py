"""Joints and internal states that change their names between two phases: exchanged legs."""

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mbd_ros.core.events.phase_reset import Relabelling
from mbd_ros.core.ranges import NotZero
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import TINY
from mbd_ros.errors import SceneError
from mbd_ros.scene.reading.phase_entries import known
from mbd_ros.scene.reading.phase_plans import ResetEntry
from mbd_ros.scene.schema import schema

if TYPE_CHECKING:
    from mbd_ros.scene.scene_parts import SceneParts

Sources = dict[str, dict[str, float]]


def relabelling_of(scene: "SceneParts", entry: ResetEntry, where: str) -> Relabelling | None:
    """The relabelling of a reset; None where everything keeps its name.

    Args:
        scene: The scene.
        entry: The reset.
        where: File and key, for the messages.

    Raises:
        SceneError: A name that nothing has or that is given twice, a joint whose source is a
            state, or what cannot be told apart afterwards.
    """
    joints = {joint.name: joint for joint in scene.robot.joints}
    states = {name: i for i, name in enumerate(scene.internals.names) if name}
    sources = _sources(entry, (*joints, *states), where)
    shifts = entry.shift or {}
    chosen = list(dict.fromkeys([*sources, *shifts, *(n for s in sources.values() for n in s)]))
    if not chosen:
        return None
    own, inner = ([n for n in chosen if n in kind] for kind in (joints, states))
    for name, given in sources.items():
        if any((source in states) != (name in states) for source in given):
            raise SceneError(f"{where}: {name}: a joint and an internal state are not the same")
    A, B = _matrix(own, sources, where), _matrix(inner, sources, where)
    b = np.array([shifts.get(name, 0.0) for name in own])
    q, v = (np.array([getattr(joints[n], key) for n in own], dtype=np.intp) for key in "qv")
    return Relabelling(q, v, A, b, np.array([states[n] for n in inner], dtype=np.intp), B)


def _sources(entry: ResetEntry, names: Collection[str], where: str) -> Sources:
    """Name -> what it is made of, by factors."""
    sources = {name: dict(given) for name, given in (entry.relabel or {}).items()}
    for name, given in sources.items():
        for one in (name, *given):
            known(one, names, _WHAT, f"{where}.relabel.{name}")
    for name, swapped in (entry.exchange or {}).items():
        key = f"{where}.exchange.{name}"
        one = swapped if isinstance(swapped, Mapping) else {"joint": swapped}
        other, factor = schema.call(_swapped, one, key)
        for each in {known(name, names, _WHAT, key), known(other, names, _WHAT, key)}:
            if each in sources:
                raise SceneError(f"{key}: {each} is relabelled twice")
        sources[name] = {other: factor}
        sources[other] = {name: 1.0 / factor}
    return sources


def _matrix(names: Sequence[str], sources: Sources, where: str) -> Array:
    """What makes the values of all names of those before, shape (n, n)."""
    matrix = np.eye(len(names))
    for name in (name for name in names if name in sources):
        row = names.index(name)
        matrix[row] = 0.0
        for source, factor in sources[name].items():
            matrix[row, names.index(source)] = factor
    if not abs(np.linalg.det(matrix)) > TINY:
        raise SceneError(
            f"{where}: {', '.join(names)} cannot be told apart afterwards: each needs a source "
            "of its own"
        )
    return matrix


_WHAT = "joint or internal state"


def _swapped(joint: str, factor: NotZero = 1.0) -> tuple[str, float]:
    return joint, factor
