"""The table of events: time, guard, impulses, energy, and the states before and after."""

from collections.abc import Iterator, Sequence

import numpy as np

from mbd_ros.core.contracts import without_multiplier
from mbd_ros.core.dynamics.system import System, phase_names
from mbd_ros.core.state import Array, State
from mbd_ros.files.table import TIME, Column, Table
from mbd_ros.methods.events.step_events import Event
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.motion.columns import body_columns, joint_columns, whole_bodies
from mbd_ros.motion.state_table import PHASE

EVENTS = "events"  # the table, and the last word of the topic
CONTACTS = "contacts"
SIDES = ("before", "after")


def event_table(simulation: Simulation, events: Sequence[Event]) -> Table:
    """Return a table with one row per event.

    Args:
        simulation: The simulation.
        events: Its events.

    Returns:
        `time`; `<guard>.event`, whether that guard was zero; `<row>.impulse`; with contacts
        `contacts.restitution_share`, the share of their restitution that acted; `energy.before`,
        `energy.after`, `energy.lost`; `<joint>.position.before` and so on; in a scene with phases
        `phase.before` and `phase.after`, their numbers in the order of the scene, from 0 on;
        `<switch>.mode.before` and `.mode.after`: 0 while a constraint or surface is active, 1 or
        -1 on its sides.
    """
    system, rows = simulation.system, simulation.system.multiplier_rows
    impulses = np.array([event.impulse for event in events]).reshape(len(events), len(rows))
    columns = [
        Column(TIME, np.array([event.t for event in events], dtype=np.float64), "s"),
        *(Column(f"{name}.event", _hit(events, name)) for name in simulation.guards),
        *(
            Column(f"{without_multiplier(row.name)}.impulse", values, f"{row.unit}·s")
            for row, values in zip(rows, impulses.T, strict=True)
        ),
    ]
    if system.layout.cones:
        shares = np.array([event.share for event in events], dtype=np.float64)
        columns.append(Column(f"{CONTACTS}.restitution_share", shares))
    sides = [[getattr(event, side) for event in events] for side in SIDES]
    for side, states in zip(SIDES, sides, strict=True):
        energy = [system.energy(system.reduce(x)) for x in states]
        columns.append(Column(f"energy.{side}", np.array(energy, dtype=np.float64), "J"))
    columns.append(Column("energy.lost", columns[-2].values - columns[-1].values, "J"))
    for side, states in zip(SIDES, sides, strict=True):
        named = (c._replace(name=f"{c.name}.{side}") for c in _state_columns(system, states))
        columns.extend(named)
    for side, states in zip(SIDES, sides, strict=True):
        modes = np.array([x.mode for x in states], dtype=np.float64)
        modes = modes.reshape(len(events), len(simulation.switches))
        if phase_names(system):
            columns.append(Column(f"{PHASE}.{side}", modes[:, 0]))
        pairs = list(zip(simulation.switches, modes.T, strict=True))[bool(phase_names(system)) :]
        columns.extend(Column(f"{name}.mode.{side}", values) for name, values in pairs)
        columns.extend(_contact_states(simulation, modes, side))
    return Table(columns)


def _contact_states(simulation: Simulation, modes: Array, side: str) -> Iterator[Column]:
    """Yield the states of contacts for their modes: 0 open, 1 slip, 2 stick."""
    for cone in simulation.system.layout.cones:
        if cone.name in simulation.switches:
            first = simulation.switches.index(cone.name)
            normal, *tangents = modes[:, first : first + 3].T
            state = np.where(normal != 0, 0.0, np.where(np.any(tangents, axis=0), 1.0, 2.0))
            part, _, row = cone.name.rpartition(".")
            name = "_".join(filter(None, ("state", row.removesuffix("normal").rstrip("_"))))
            yield Column(f"{part}.{name}.{side}", state)


def _hit(events: Sequence[Event], guard: str) -> Array:
    return np.array([guard in event.guards for event in events], dtype=np.float64)


def _state_columns(system: System, states: Sequence[State]) -> list[Column]:
    """Return columns of joints, free bodies and internal states."""
    joints, model = system.robot.joints, system.model
    q = np.array([x.q for x in states]).reshape(len(states), model.nq)
    v = np.array([x.v for x in states]).reshape(len(states), model.nv)
    z = np.array([x.z for x in states]).reshape(len(states), system.internals.nz)
    internals = zip(system.internals.names, z.T, system.internals.units, strict=True)
    return [
        *joint_columns(joints, "position", q[:, [joint.q for joint in joints]]),
        *joint_columns(joints, "velocity", v[:, [joint.v for joint in joints]]),
        *body_columns(system.robot, whole_bodies(system.robot, q, v, None)),
        *(Column(*internal) for internal in internals),
    ]
