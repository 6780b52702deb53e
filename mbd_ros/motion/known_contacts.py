"""Contacts whose forces a motion carries: loads of its inverse dynamics.

The motion alone does not show them: a body at rest on four legs is as much at rest under any
share of them. A simulation writes them beside the motion, in columns `<contact>.<row>`.
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
    """The contacts of a scene whose forces a motion carries, in columns or beside it in a bag.

    Forces of compliant contacts follow from positions and velocities, unless they have bristles:
    these become known contacts, and leave the scene.

    Args:
        source: Where the motion comes from.
        topic: Of its joint states in a bag; those of constraint forces are beside it.
        say: Is told which columns are missing.

    Raises:
        DataError: Some columns of a contact are there and others are not, or none of one with
            bristles; names these.
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
        shown = getattr(load, "contact", None)
        if shown is not None and load.internal:
            names = [label(load, name) for name in shown.names]
            forces = _forces(source, names)
            if forces is None:
                raise DataError(
                    f"{name_of(source)}: no column {join_names(names)}: contact {load.name} has "
                    "bristles, which a motion does not show; simulate writes these columns"
                )
            bristly.append(load)
            known.append(KnownContact(load.name, forces, None, shown.exerted))
    if bristly:
        kept = [part for part in scene.parts["contacts"] if part not in bristly]
        scene = scene.holding(contacts=kept)
    return scene, known


class KnownContact(NamedTuple):
    """A contact whose forces a motion carries.

    Attributes:
        name: Of the contact.
        forces: In its contact frames, one row a sample [N], shape (n, m).
        stamps: Of these samples [ns], shape (n,); None for those of the motion.
        exert: Kinematics at positions, state, and one row of forces -> wrenches on bodies.
    """

    name: str
    forces: Array
    stamps: NDArray[np.int64] | None
    exert: Callable[[Kinematics, State, Array], tuple[Wrench, ...]]


def forces_at(known: KnownContact, motion: Motion, stamps: NDArray[np.int64]) -> Array:
    """Forces of a contact in its contact frames at some stamps [N], shape (n, m).

    Raises:
        DataError: A bag has no force of the contact at one of them.
    """
    of_forces = motion.stamps if known.stamps is None else known.stamps
    return known.forces[_rows(known.name, of_forces, stamps)]


def contact_loads(
    scene: Scene, known: Sequence[KnownContact], motion: Motion, samples: Observations
) -> tuple[dict[str, MeasuredWrench], list[Array]]:
    """Known contacts as external loads of links.

    Args:
        motion: As it was read, a row of forces each.
        samples: Those of it that are solved for.

    Returns:
        Loads by names of their own, and their values at the samples, shape (n, 6) each.

    Raises:
        DataError: A bag has no force of a contact at the stamp of a sample.
    """
    stamps = samples.stamps
    states = [_state(scene, sample) for sample in samples.rows()]
    robot, k = scene.robot, Kinematics(scene.robot)
    values: dict[tuple[str, str], list[Array]] = {}
    for one in known:
        for x, lam in zip(states, forces_at(one, motion, stamps), strict=True):
            k.refresh(x.q, x.v, Reads.POSITION)
            for wrench in one.exert(k, x, lam):
                if robot.carrier(wrench.frame).moves:
                    rows = values.setdefault((one.name, wrench.frame), [])
                    rows.append(in_link(k, robot, wrench))
    loads = {}
    for name, frame in values:
        load = MeasuredWrench(robot, frame=frame)
        load.name = f"{name}_on_{frame}"
        loads[load.name] = load
    return loads, [np.array(rows) for rows in values.values()]


def _rigid(scene: Scene) -> Iterator[tuple[Constraint, list[str]]]:
    """Rigid contacts and the columns of their multipliers."""
    names, end = [row.name for row in labelled(scene.constraints)], 0
    for part in scene.constraints:
        begin, end = end, end + len(part.rows)
        if part.law.kind is Kind.CONE:
            yield part, names[begin:end]


def _forces(source: Source, names: list[str]) -> Array | None:
    """Columns of a contact, shape (n, m); None where there is none of them."""
    columns = read_columns(source, names)
    if columns is None:
        return None
    lacking = [name for name, bad in zip(names, np.isnan(columns).any(axis=0), strict=True) if bad]
    if lacking:
        raise DataError(
            f"{name_of(source)}: no column {join_names(lacking)}, or it has gaps; accepted: all "
            f"forces of a contact, or none: {join_names(names)}"
        )
    return columns


def _in_bag(
    source: Source, topic: str, names: list[str]
) -> tuple[Array | None, NDArray[np.int64] | None]:
    """Forces and stamps of a contact on a topic of constraint forces; None without any."""
    if isinstance(source, Result) or not is_bag(source):
        return None, None
    beside = topic.rpartition("/")[0]
    for place in ("", "/simulator"):
        with suppress(DataError):  # there is no such topic, or it has no such rows
            found = read_motion(
                source, names, topic=f"{beside}{place}/constraint_forces", required=()
            )
            effort = found.motion.effort
            if effort is not None and np.isfinite(effort).all():
                return effort, found.motion.stamps
    return None, None


def _rows(name: str, known: NDArray[np.int64], stamps: NDArray[np.int64]) -> NDArray[np.intp]:
    """Rows of known stamps at those of samples."""
    rows = np.minimum(np.searchsorted(known, stamps), len(known) - 1)
    lacking = np.flatnonzero(known[rows] != stamps)
    if len(lacking):
        t = int(stamps[lacking[0]]) * NANOSECOND
        raise DataError(f"no force of contact {name} at t = {t:.9g} s, where there is a motion")
    return rows


def _unknown(scene: Scene, source: Source, part: Constraint, names: Sequence[str]) -> str:
    given = f"; the loads {', '.join(scene.wrenches)} act" if scene.wrenches else ""
    return (
        f"warning: {name_of(source)}: no column {join_names(names)}: the forces of contact "
        f"{part.name} are not known, 0 is taken{given}; simulate writes these columns, and "
        "external_wrenches of the scene take measured forces by --wrenches, and --stance "
        "makes unknowns of them"
    )


def _state(scene: Scene, sample: Observation) -> State:
    """State of all joints of a sample."""
    robot, couplings = scene.robot, scene.couplings
    q, v, a = robot.neutral().copy(), np.zeros(robot.model.nv), np.zeros(robot.model.nv)
    q[couplings.q_index], v[couplings.v_index] = sample.position, sample.velocity
    couplings.expand(q, v, a)
    return State(sample.stamp * NANOSECOND, q, v)
