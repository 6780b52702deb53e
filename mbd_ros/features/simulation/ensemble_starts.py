"""The rows of an ensemble: where each run starts, and with which numbers."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mbd_ros.core.kinematics.free_bases import configuration_of
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, SceneError
from mbd_ros.files.body_columns import POSE, TWIST, names_of
from mbd_ros.files.tables.csv import Numbers, read_table
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.numbers import found_place, places_of


class Starts(NamedTuple):
    """What differs from run to run, a row a run.

    Attributes:
        names: Names of the parameters.
        p: Their values.
        q: Configurations of all joints.
        v: Their velocities.
        z: Internal states, NaN for their equilibrium.
    """

    names: tuple[str, ...]
    p: Array
    q: Array
    v: Array
    z: Array


def read_starts(scene: Scene, path: Path) -> Starts:
    """The rows of a CSV file; what has no column is that of the scene.

    Args:
        scene: The scene.
        path: Has columns `<joint>.position`, `<joint>.velocity`, those of poses and twists of free
            bodies, internal states, and `<part>.<argument>` as `Scene.with_` takes them.

    Raises:
        DataError: Names file, column and what is accepted.
    """
    read = read_table(path, has_times=False)
    x, count = scene.initial, len(read.values)
    q, v, z = (np.tile(one, (count, 1)) for one in (x.q, x.v, x.z))
    taken = set(_fill(scene, read, q, v, z))
    robot = scene.robot
    for row in range(count):
        scene.couplings.expand(q[row], v[row], np.zeros(robot.model.nv))
    names = tuple(name for name in read.columns if name not in taken)
    places = places_of(scene)
    for name in names:
        try:
            is_of_part = found_place(scene.origin, places, name)[0].at is not None
        except SceneError as error:
            raise DataError(
                f"{path}: column {name}: {error}; accepted are also {_accepted(scene)}"
            ) from error
        if not is_of_part:
            raise DataError(f"{path}: column {name}: is no number of a part")
    return Starts(names, read.values[:, [read.columns.index(name) for name in names]], q, v, z)


def _fill(scene: Scene, read: Numbers, q: Array, v: Array, z: Array) -> Iterator[str]:
    """Writes the states of a file into rows; names of the columns that are states."""
    values = dict(zip(read.columns, read.values.T, strict=True))
    robot, free = scene.robot, set(scene.couplings.independent)
    for joint in robot.joints:
        for name, rows, at in (("position", q, joint.q), ("velocity", v, joint.v)):
            column = f"{joint.name}.{name}"
            if column in values and joint.name not in free:
                raise DataError(f"{read.path}: column {column}: the joint depends on another one")
            if column in values:
                rows[:, at] = values[column]
                yield column
    for base in robot.bases:
        for words, rows, place in ((POSE, q, base.q), (TWIST, v, base.v)):
            names = names_of(base.name, words)
            lacking = [name for name in names if name not in values]
            if len(lacking) == len(names):
                continue
            if lacking:
                raise DataError(f"{read.path}: no column {', '.join(lacking)}, beside {names[0]}")
            given = np.column_stack([values[name] for name in names])
            rows[:, place] = configuration_of(robot, given) if words is POSE else given
            yield from names
    for i, name in enumerate(scene.internals.names):
        if name in values:
            z[:, i] = values[name]
            yield name


def _accepted(scene: Scene) -> str:
    joints = ", ".join(scene.couplings.independent)
    internals = "".join(f", {name}" for name in scene.internals.names)
    return f".position and .velocity of {joints}{internals}"
