"""Table of a simulation: motion, efforts, multipliers, energy and constraint violations."""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_ros.core.contracts import Part
from mbd_ros.core.dynamics.output_values import Showing
from mbd_ros.core.dynamics.system import System, during, phase_names
from mbd_ros.core.loads.inputs import command_names
from mbd_ros.core.state import Array, State
from mbd_ros.errors import DivergedError, MbdError, SolveError
from mbd_ros.files.table import TIME, Column, Table
from mbd_ros.methods.projection.assembly import violation
from mbd_ros.methods.simulation.sample_accelerations import SampleAccelerations, accelerations_at
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.motion.columns import (
    body_columns,
    body_topics,
    command_columns,
    force_topic,
    joint_columns,
    output_columns,
    state_topics,
    whole_bodies,
)

PHASE = "phase"  # column with the index of the phase in the scene
BALANCE = {  # column -> name in messages, unit
    "energy": ("energy", "J"),
    "drift.position": ("position drift", "rad or m"),
    "drift.velocity": ("velocity drift", "rad/s or m/s"),
}


def topics_of(system: System) -> dict[str, Any]:
    """Return the topics of a bag, see `files.bags.bag_writer`."""
    return {
        **state_topics(system.robot, ("position", "velocity", "effort")),
        **body_topics(system.robot),
        **force_topic(system.multiplier_rows),
        "/energy_and_drift": {"data": list(BALANCE)},
    }


def table_of(
    simulation: Simulation,
    states: Sequence[State],
    forces: Sequence[Array | None] = (),
    sensors: Sequence[Part] = (),
) -> tuple[Table, list[str], MbdError | None]:
    """Return a table with one row per state, up to the first state that is not finite.

    Args:
        simulation: The simulation.
        states: States of all joints.
        forces: `Stepper.forces` at each state; empty without contacts in time-stepping methods.
        sensors: Parts with outputs, but without influence on the motion.

    Returns:
        The table, remarks, and the error at which it ends, or None.
    """
    rows, system, means = [], simulation.system, list[float]()
    loads = system.loads
    showing = Showing(system.k, system.layout, (*loads.actuators, *loads.forces, *sensors))
    failure: MbdError | None = None
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            for x, known in itertools.zip_longest(states, forces):
                seen = accelerations_at(simulation, x, None, known)
                rows.append(_row(system, showing, x, seen))
                means += [x.t] * seen.is_mean
    except SolveError as error:
        failure = error
    joints, shown = system.robot.joints, showing.numbers
    q_index, v_index = [j.q for j in joints], [j.v for j in joints]
    nq, nv = system.model.nq, system.model.nv
    t, q, v, a, effort, values, balance = (
        np.array([row[i] for row in rows]).reshape(len(rows), width)
        for i, width in enumerate((1, nq, nv, nv, nv, len(shown), 3))
    )
    columns = [
        Column(TIME, t[:, 0], "s"),
        *joint_columns(joints, "position", q[:, q_index]),
        *joint_columns(joints, "velocity", v[:, v_index]),
        *joint_columns(joints, "acceleration", a[:, v_index]),
        *joint_columns(joints, "effort", effort[:, v_index]),
        *body_columns(system.robot, whole_bodies(system.robot, q, v, a)),
        *output_columns(shown, values),
        *(Column(name, balance[:, i], BALANCE[name][1]) for i, name in enumerate(BALANCE)),
    ]
    if phase_names(system):
        numbers = [x.mode[0] for x in states[: len(rows)]]
        columns.append(Column(PHASE, np.array(numbers, dtype=np.float64)))
    table = Table(columns)
    count, lost = _finite_rows(table)
    more = _commands(system, t[:, 0])
    return Table([*table.columns, *more]).first(count), _remarks(means), lost or failure


def _remarks(means: Sequence[float]) -> list[str]:
    """Return a remark on samples without accelerations, from their times [s]."""
    if not means:
        return []
    return [
        f"no consistent accelerations at {len(means)} samples, the first at t = {means[0]:.9g} s "
        "(Painlevé): forces of contacts there are means of the next step"
    ]


def _finite_rows(table: Table) -> tuple[int, DivergedError | None]:
    """Return the number of finite samples, and the error of the first other one, or None."""
    faults = []
    for name, values in table.items():
        rows = np.flatnonzero(~np.isfinite(values))
        if len(rows):
            joint, _, field = name.rpartition(".")
            quantity = BALANCE[name][0] if name in BALANCE else f"{field} of {joint}"
            faults.append((int(rows[0]), quantity))
    if not faults:
        return table.rows, None
    first_row = min(faults)[0]
    quantity = min(quantity for row, quantity in faults if row == first_row)
    return first_row, DivergedError(
        f"{quantity} is not finite at t = {table[TIME][first_row]:.9g} s"
    )


def _commands(system: System, times: Array) -> list[Column]:
    """Return columns of commands that are not joint torques, then of excitations."""
    actuators = system.loads.actuators
    named = list(zip(actuators, command_names(actuators), strict=True))
    chosen = [(a, names) for a, names in named if a.takes or names != a.joints]
    if not chosen:
        return []
    u = np.array([system.loads.sources.at(t) for t in times])
    u = u.reshape(len(times), len(system.loads.idle))
    of_joints = [(a, names) for a, names in chosen if a.joints]
    every = [name for _, names in of_joints for name in names]
    parts = [u[:, a.u] for a, _ in of_joints]
    found = command_columns(every, np.column_stack(parts)) if parts else []
    excited = [(a, name) for a, names in chosen if not a.joints for name in names]
    return [*found, *(Column(name, u[:, a.u.start], a.inputs[0].unit) for a, name in excited)]


def _row(system: System, showing: Showing, x: State, seen: SampleAccelerations) -> tuple[Any, ...]:
    """Return time, q, v, a, effort, outputs and balance of one state."""
    y, (a, lam, _) = system.reduce(x), seen
    balance = system.energy(y), *violation(during(system, y), y)
    effort = system.loads.actuator_torque(system.k, x, None)
    shown = showing.at(x, system.loads.inputs(x, None), a, lam)
    return x.t, x.q, x.v, a, effort, shown, balance
