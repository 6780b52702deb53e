"""Contact forces that are recorded with a motion, as external loads of its inverse dynamics.

The motion alone does not determine them: a body at rest on four legs stays at rest under many
distributions of its weight. A simulation writes them in columns `<contact>.<row>`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.contracts import Wrench, label
from mbd_ros.core.dynamics.output_values import in_link
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.rows.constraint import Constraint, Kind
from mbd_ros.core.rows.constraint_rows import labelled
from mbd_ros.core.state import NANOSECOND, Array, Motion, State
from mbd_ros.errors import DataError
from mbd_ros.files.formats import is_bag
from mbd_ros.files.table import Result
from mbd_ros.jobs.progress import Say
from mbd_ros.methods.inverse_dynamics.efforts import join_names
from mbd_ros.methods.inverse_dynamics.torque_estimator import Observation, Observations
from mbd_ros.motion.recordings import Source, name_of, read_columns, read_motion
from mbd_ros.scene.built_scene import MeasuredWrench, Scene


def known_contacts(
    scene: Scene, source: Source, topic: str, say: Say
) -> tuple[Scene, list[KnownContact]]:
    """Find the contacts of a scene whose forces are recorded with a motion.

    The forces are columns of a table, or on another topic of a bag. Forces of compliant contacts
    follow from positions and velocities, unless the contacts have bristles; then they become known
    contacts and are removed from the scene.

    Args:
        scene: The scene.
        source: Source of the motion.
        topic: Topic of its joint states in a bag; the topic of constraint forces is next to it.
        say: Function that prints which columns are missing.

    Returns:
        The scene, and its known contacts.

    Raises:
        DataError: Some columns of a contact are missing, or all of one with bristles.
    """
    known, bristly = [], []
    for part, names in _rigid(scene):
        forces, stamps = _forces(source, names), None
        if forces is None:
            forces, stamps = _in_bag(source, topic, names)
        if forces is None:
            say(_unknown(scene, source, part, names))
        else:
            known.append(KnownContact(part.name, forces, stamps, part.wrenches))
    for load in scene.forces:
        outputs = getattr(load, "contact", None)
        if outputs is not None and load.internal:
            names = [label(load, name) for name in outputs.names]
            forces = _forces(source, names)
            if forces is None:
                raise DataError(
                    f"{name_of(source)}: no column {join_names(names)}: contact {load.name} has "
                    "bristles, whose forces do not follow from a motion; simulate writes these "
                    "columns"
                )
            bristly.append(load)
            known.append(KnownContact(load.name, forces, None, outputs.exerted))
    if bristly:
        others = [part for part in scene.parts["contacts"] if part not in bristly]
        scene = scene.holding(contacts=others)
    return scene, known


class KnownContact(NamedTuple):
    """A contact whose forces are recorded with a motion.

    Attributes:
        name: Name of the contact.
        forces: Forces in its contact frames, one row per sample [N], shape (n, m).
        stamps: Stamps of these samples [ns], shape (n,); None for the stamps of the motion.
        exert: Function of kinematics, state and one row of forces that returns the wrenches.
    """

    name: str
    forces: Array
    stamps: NDArray[np.int64] | None
    exert: Callable[[Kinematics, State, Array], tuple[Wrench, ...]]


def forces_at(known: KnownContact, motion: Motion, stamps: NDArray[np.int64]) -> Array:
    """Return the forces of a contact in its contact frames at some stamps [N], shape (n, m).

    Raises:
        DataError: A bag has no force of the contact at one of them.
    """
    of_forces = motion.stamps if known.stamps is None else known.stamps
    return known.forces[_rows(known.name, of_forces, stamps)]


def contact_loads(
    scene: Scene, known: Sequence[KnownContact], motion: Motion, samples: Observations
) -> tuple[dict[str, MeasuredWrench], list[Array]]:
    """Convert known contacts to external loads of links.

    Args:
        scene: The scene.
        known: The known contacts.
        motion: The motion as it was read, with one row per row of forces.
        samples: Samples of the motion that are solved.

    Returns:
        Loads by name, and their values at the samples, shape (n, 6) each.

    Raises:
        DataError: A bag has no force of a contact at the stamp of a sample.
    """
    stamps = samples.stamps
    states = [_state(scene, sample) for sample in samples.rows()]
    robot, k = scene.robot, Kinematics(scene.robot)
    values: dict[tuple[str, str], list[Array]] = {}
    for contact in known:
        for x, lam in zip(states, forces_at(contact, motion, stamps), strict=True):
            k.refresh(x.q, x.v, Reads.POSITION)
            for wrench in contact.exert(k, x, lam):
                if robot.carrier(wrench.frame).moves:
                    rows = values.setdefault((contact.name, wrench.frame), [])
                    rows.append(in_link(k, robot, wrench))
    loads = {}
    for name, frame in values:
        load = MeasuredWrench(robot, frame=frame)
        load.name = f"{name}_on_{frame}"
        loads[load.name] = load
    return loads, [np.array(rows) for rows in values.values()]


def _rigid(scene: Scene) -> Iterator[tuple[Constraint, list[str]]]:
    """Yield rigid contacts and the columns of their multipliers."""
    names, end = [row.name for row in labelled(scene.constraints)], 0
    for part in scene.constraints:
        begin, end = end, end + len(part.rows)
        if part.law.kind is Kind.CONE:
            yield part, names[begin:end]


def _forces(source: Source, names: list[str]) -> Array | None:
    """Return the columns of a contact, shape (n, m), or None if there are none."""
    columns = read_columns(source, names)
    if columns is None:
        return None
    gaps = np.isnan(columns).any(axis=0)
    missing = [name for name, has_gap in zip(names, gaps, strict=True) if has_gap]
    if missing:
        raise DataError(
            f"{name_of(source)}: no column {join_names(missing)}, or it has gaps; accepted: all "
            f"forces of a contact, or none: {join_names(names)}"
        )
    return columns


def _in_bag(
    source: Source, topic: str, names: list[str]
) -> tuple[Array | None, NDArray[np.int64] | None]:
    """Return forces and stamps of a contact from a topic of constraint forces, or None."""
    if isinstance(source, Result) or not is_bag(source):
        return None, None
    namespace = topic.rpartition("/")[0]
    for node in ("", "/simulator"):
        with suppress(DataError):  # there is no such topic, or it has no such rows
            recording = read_motion(
                source, names, topic=f"{namespace}{node}/constraint_forces", required=()
            )
            effort = recording.motion.effort
            if effort is not None and np.isfinite(effort).all():
                return effort, recording.motion.stamps
    return None, None


def _rows(name: str, known: NDArray[np.int64], stamps: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return the rows of known stamps at the stamps of samples."""
    rows = np.minimum(np.searchsorted(known, stamps), len(known) - 1)
    missing = np.flatnonzero(known[rows] != stamps)
    if len(missing):
        t = int(stamps[missing[0]]) * NANOSECOND
        raise DataError(f"contact {name} has no force at t = {t:.9g} s, but the motion does")
    return rows


def _unknown(scene: Scene, source: Source, part: Constraint, names: Sequence[str]) -> str:
    loads = f"; the loads {', '.join(scene.wrenches)} act" if scene.wrenches else ""
    return (
        f"warning: {name_of(source)}: no column {join_names(names)}: the forces of contact "
        f"{part.name} are not known and taken as 0{loads}; record them (simulate writes these "
        "columns), measure them (external_wrenches with --wrenches), or estimate them (--stance)"
    )


def _state(scene: Scene, sample: Observation) -> State:
    """Return the state of all joints of a sample."""
    robot, couplings = scene.robot, scene.couplings
    q, v, a = robot.neutral().copy(), np.zeros(robot.model.nv), np.zeros(robot.model.nv)
    q[couplings.q_index], v[couplings.v_index] = sample.position, sample.velocity
    couplings.expand(q, v, a)
    return State(sample.stamp * NANOSECOND, q, v)
