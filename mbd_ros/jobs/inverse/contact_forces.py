"""Forces of contacts that a motion carries: loads of its inverse dynamics.

A motion does not show them: a body at rest on four legs is as much at rest under any share of
them. A simulation writes them beside the motion, in columns `<contact>.<row>`.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.dynamics.showing import in_link
from mbd_ros.core.estimation.torque_estimator import Observation
from mbd_ros.core.inverse.reach import listed
from mbd_ros.core.model.kinematics import Kinematics, Reads
from mbd_ros.core.row_laws import Kind
from mbd_ros.core.rows.constraint import Constraint
from mbd_ros.core.rows.row_layout import labelled
from mbd_ros.core.state import NANOSECOND, Array, Motion, State
from mbd_ros.errors import DataError
from mbd_ros.files.recordings import Source, name_of, read_columns
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.part_entries import MeasuredWrench


class ContactForces(NamedTuple):
    """Known forces of contacts, as external loads in links.

    Attributes:
        loads: On every link that a contact of known forces acts on, by a name of their own.
        wrenches: Their values at the samples, shape (n, 6) each.
        remarks: What is not known.
    """

    loads: dict[str, MeasuredWrench]
    wrenches: list[Array]
    remarks: list[str]


def contact_forces(
    scene: Scene, source: Source, motion: Motion, samples: Sequence[Observation]
) -> ContactForces:
    """The forces of the contacts of a scene, from the columns of a motion.

    Args:
        scene: The scene.
        source: Where the motion comes from.
        motion: As it was read, a row of columns each.
        samples: Those of it that are solved for.

    Raises:
        DataError: Some columns of a contact are there and others are not; names these.
    """
    found = ContactForces({}, [], [])
    stamps = np.array([sample.stamp for sample in samples], dtype=np.int64)
    chosen = np.searchsorted(motion.stamps, stamps)
    states = None
    for part, names in _contacts(scene):
        lam = _multipliers(source, names)
        if lam is None:
            found.remarks.append(_unknown(scene, source, part, names))
            continue
        states = states or [_state(scene, sample) for sample in samples]
        _add(found, scene, part, states, lam[chosen])
    return found


def _contacts(scene: Scene) -> Iterator[tuple[Constraint, list[str]]]:
    """Contacts and the columns of their multipliers."""
    names, end = [row.name for row in labelled(scene.constraints)], 0
    for part in scene.constraints:
        begin, end = end, end + len(part.rows)
        if part.law.kind is Kind.CONE:
            yield part, names[begin:end]


def _multipliers(source: Source, names: list[str]) -> Array | None:
    """Columns of a contact, shape (n, m); None where there is none of them."""
    columns = read_columns(source, names)
    if columns is None:
        return None
    lacking = [name for name, bad in zip(names, np.isnan(columns).any(axis=0), strict=True) if bad]
    if lacking:
        raise DataError(
            f"{name_of(source)}: no column {listed(lacking)}, or it has gaps; accepted: all "
            f"forces of a contact, or none: {listed(names)}"
        )
    return columns


def _unknown(scene: Scene, source: Source, part: Constraint, names: Sequence[str]) -> str:
    given = f"; the loads {', '.join(scene.wrenches)} act" if scene.wrenches else ""
    return (
        f"warning: {name_of(source)}: no column {listed(names)}: the forces of contact "
        f"{part.name} are not known, 0 is taken{given}; simulate writes these columns, and "
        "external_wrenches of the scene take measured forces by --wrenches"
    )


def _state(scene: Scene, sample: Observation) -> State:
    """State of all joints of a sample."""
    robot, couplings = scene.robot, scene.couplings
    q, v, a = robot.neutral().copy(), np.zeros(robot.model.nv), np.zeros(robot.model.nv)
    q[couplings.q_index], v[couplings.v_index] = sample.position, sample.velocity
    couplings.expand(q, v, a)
    return State(sample.stamp * NANOSECOND, q, v)


def _add(
    found: ContactForces, scene: Scene, part: Constraint, states: Sequence[State], lam: Array
) -> None:
    """Add the loads of one contact: wrenches about the origins of links, in their axes."""
    robot, k = scene.robot, Kinematics(scene.robot)
    values: dict[str, list[Array]] = {}
    for x, forces in zip(states, lam, strict=True):
        k.refresh(x.q, x.v, Reads.POSITION)
        for wrench in part.wrenches(k, x, forces):
            if robot.carrier(wrench.frame).moves:
                values.setdefault(wrench.frame, []).append(in_link(k, robot, wrench))
    for frame, rows in values.items():
        load = MeasuredWrench(robot, frame=frame)
        load.name = f"{part.name}_on_{frame}"
        found.loads[load.name] = load
        found.wrenches.append(np.array(rows))
