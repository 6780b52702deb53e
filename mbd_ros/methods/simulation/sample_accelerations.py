"""Accelerations and multipliers at the samples of a simulation.

A method at acceleration level computes them. A method at velocity level knows which contacts
press, stick and slip in a step. At the end of the step, gaps and slips are 0 only to the order of
the method, so that the state alone does not determine these modes; accelerations are therefore
computed with the modes of the step. Where no accelerations exist (Painlevé's paradox), the result
uses the mean forces of the step.

Source: F. Génot, B. Brogliato, New results on Painlevé paradoxes, European Journal of Mechanics
A/Solids 18, 1999, sec. 2.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.contact_modes.slip_directions import initial_name
from mbd_ros.core.kinematics.kinematics import Reads
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.errors import SolveError
from mbd_ros.methods.simulation.simulation import Simulation

if TYPE_CHECKING:
    from mbd_ros.core.rows.constraint_rows import Cone

OPEN: Mode = (1, 1, 1)
STICKS: Mode = (0, 0, 0)
_AT_BOUND = 1.0 - 1.0e-9  # share of the largest friction force above which a contact slips
_TOLERANCE = 1.0e-9  # accepted violation of a contact law, relative to the largest force
_ROUNDING = 1.0e-12  # relative to the largest force
_ITERATIONS = 4  # with corrected modes of contacts


def accelerations_at(
    simulation: Simulation, x: State, u: Array | None = None, forces: Array | None = None
) -> SampleAccelerations:
    """Return accelerations and multipliers of a simulation at a state of all joints.

    Args:
        simulation: The simulation; its later steps are not affected.
        x: State of all joints.
        u: Inputs at x; None for the values of the input sources.
        forces: `Stepper.forces` of the step that led to x; None if there was no step.

    Raises:
        SolveError: No accelerations exist, and the method is not at velocity level.
    """
    if forces is not None:
        return _with_step_modes(simulation, x, u, forces)
    try:
        _, a, _, lam, _ = simulation.system.evaluate(x, u)
    except SolveError:
        if not (simulation.integrator.at_velocity_level and simulation.system.layout.cones):
            raise
        return _with_next_step(simulation, x, u)
    return SampleAccelerations(a, lam)


class SampleAccelerations(NamedTuple):
    """Accelerations and multipliers at a sample.

    Attributes:
        a: Accelerations of all joints, shape (nv,).
        lam: Multipliers of all rows, shape (m,).
        is_mean: Whether they belong to the mean forces of a step, since no accelerations exist.
    """

    a: Array
    lam: Array
    is_mean: bool = False


def _with_step_modes(
    simulation: Simulation, x: State, u: Array | None, forces: Array
) -> SampleAccelerations:
    """Return the accelerations with the contact modes of the step that led to a state."""
    system = simulation.system
    lam = np.zeros(len(system.layout.rows))
    lam[_bounded_slots(simulation)] = forces
    cones = system.layout.cones
    least = _ROUNDING * float(np.abs(lam).max(initial=0.0))
    modes = [_mode(cone, lam[cone.slots], least) for cone in cones]
    try:
        for _ in range(_ITERATIONS):
            _, a, _, lam, _ = system.evaluate(_in_modes(simulation, x, u, modes), u)
            most = _TOLERANCE * float(np.abs(lam).max(initial=0.0))
            after = [
                _correct_mode(cone, mode, lam[cone.slots], most)
                for cone, mode in zip(cones, modes, strict=True)
            ]
            if after == modes:
                return SampleAccelerations(a, lam)
            modes = after
    except SolveError:
        pass  # no accelerations exist: use the mean forces
    return _with_mean_forces(simulation, x, u, forces)


def _bounded_slots(simulation: Simulation) -> list[int]:
    """Return the slots of the unilateral and bounded rows."""
    blocks = simulation.system.layout.yielding
    return [i for block in blocks for i in range(block.slots.start, block.slots.stop)]


def _mode(cone: Cone, force: Array, least: float) -> Mode:
    """Return the mode of a contact from its mean force; forces up to `least` count as zero."""
    normal, x, y = force.tolist()
    if normal <= least:
        return OPEN
    if math.hypot(x, y) < _AT_BOUND * cone.mu * normal:
        return STICKS
    return 0, *initial_name(-force[1:])


def _in_modes(simulation: Simulation, x: State, u: Array | None, modes: list[Mode]) -> State:
    """Return the state with given modes of contacts, and modes of other rows that follow."""
    system = simulation.system
    rows = system.event_rows
    assert rows is not None
    assert rows.contacts is not None
    y, cones, slots = system.reduce(x), system.layout.cones, rows.slots.tolist()
    has_others = len(slots) > 3 * len(cones)
    decided, undecided = rows.modes_by_distance(y) if has_others else ((1,) * len(slots), [])
    slips = np.zeros((len(cones), 2))
    if any(any(mode) and not mode[0] for mode in modes):
        system.k.refresh(x.q, x.v, Reads.JACOBIAN)
        slips = rows.contacts.slips(system.k, x)
    entries, contact_rows = list(decided), set[int]()
    for cone, mode, slip in zip(cones, modes, slips, strict=True):
        first = slots.index(cone.slots.start)
        keeps_slipping = not mode[0] and any(mode) and slip.dot(mode[1:]) > 0.0
        entries[first : first + 3] = (0, *initial_name(slip)) if keeps_slipping else mode
        contact_rows.update(range(first, first + 3))
    others = [row for row in undecided if row not in contact_rows]
    if others:
        solution = rows.solve(y, u, tuple(entries), others)
        for row in others:
            if solution.lam[row] <= solution.lower[row]:
                entries[row] = 1
            else:
                entries[row] = -1 if solution.lam[row] >= solution.upper[row] else 0
    return x._replace(mode=tuple(entries))


def _correct_mode(cone: Cone, mode: Mode, force: Array, most: float) -> Mode:
    """Return the mode of a contact, changed if its force violates the contact law."""
    normal, x, y = force.tolist()
    if mode[0]:
        return mode
    if normal < -most:
        return OPEN
    if not any(mode) and math.hypot(x, y) > cone.mu * normal + most:
        return 0, *initial_name(-force[1:])
    return mode


def _with_next_step(simulation: Simulation, x: State, u: Array | None) -> SampleAccelerations:
    """Return accelerations under the mean forces of the step that begins at a state."""
    system, stepper = simulation.system, simulation.stepper
    y, memory = system.reduce(x), stepper.checkpoint()
    inputs = system.loads.sources.hold(x.t) if u is None else u
    stepper.step(y, inputs, y.t + simulation.dt)
    forces = stepper.forces
    stepper.restart()
    stepper.restore(memory, y)
    assert forces is not None
    return _with_mean_forces(simulation, x, u, forces)


def _with_mean_forces(
    simulation: Simulation, x: State, u: Array | None, forces: Array
) -> SampleAccelerations:
    """Return accelerations under given forces of the unilateral and bounded rows."""
    system, slots = simulation.system, _bounded_slots(simulation)
    assert system.event_rows is not None
    now = system.evaluate(x._replace(mode=(1,) * len(system.event_rows.names)), u)
    lam = now.lam.copy()
    lam[slots] = forces
    J = np.concatenate([block.part.jacobian(system.k, x) for block in system.layout.yielding])
    force = (forces - now.lam[slots]).dot(J)
    change = now.respond(force[:, None])[:, 0]
    rigid = system.layout.rigid
    if rigid:  # their multipliers change too
        M = pin.crba(system.model, system.model.createData(), x.q)
        hold = np.concatenate([block.part.jacobian(system.k, x) for block in rigid])
        rigid_slots = [i for block in rigid for i in range(block.slots.start, block.slots.stop)]
        lam[rigid_slots] += np.linalg.lstsq(hold.T, M.dot(change) - force, rcond=None)[0]
    return SampleAccelerations(now.a + change, lam, is_mean=True)
