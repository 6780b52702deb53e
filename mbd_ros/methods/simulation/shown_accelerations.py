"""Accelerations and multipliers at a state of a simulation, as people see them beside a motion.

A method that solves for accelerations has them. One that solves for velocities knows which
contacts press, stick and slip in a step; at the end of it gaps and slips are 0 to the order of the
method only, so that the state alone does not say it. Accelerations follow from equations with the
modes of the step. Where there are none (Painlevé's paradox), the mean forces of the step are seen.

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
_AT_BOUND = 1.0 - 1.0e-9  # of the largest friction: from here on it slips
_BEYOND = 1.0e-9  # of the largest force: by which a law may be passed
_NOTHING = 1.0e-12  # of the largest force: rounding
_LOOKS = 4  # at modes in which a contact passes its law


def seen_at(
    simulation: Simulation, x: State, u: Array | None = None, forces: Array | None = None
) -> Seen:
    """Accelerations and multipliers of a simulation at a state of all joints.

    Args:
        simulation: The simulation; its next step is the same afterwards, to the bit.
        u: Inputs there; None for those of the sources.
        forces: `Stepper.forces` of the step that led to the state; None where there was none.

    Raises:
        SolveError: There are none, and the method solves for accelerations.
    """
    if forces is not None:
        return seen_with(simulation, x, u, forces)
    try:
        _, a, _, lam, _ = simulation.system.evaluate(x, u)
    except SolveError:
        if not (simulation.integrator.at_velocity_level and simulation.system.layout.cones):
            raise
        return seen_ahead(simulation, x, u)
    return Seen(a, lam)


class Seen(NamedTuple):
    """What the equations of motion say at a state.

    Attributes:
        a: Accelerations of all joints, shape (nv,).
        lam: Multipliers of all rows, shape (m,).
        is_mean: Whether no accelerations exist there: these belong to the mean forces of a step.
    """

    a: Array
    lam: Array
    is_mean: bool = False


def seen_with(simulation: Simulation, x: State, u: Array | None, forces: Array) -> Seen:
    """With the modes of the step that led to a state; arguments as for `seen_at`."""
    system = simulation.system
    lam = np.zeros(len(system.layout.rows))
    lam[_yielding(simulation)] = forces
    cones = system.layout.cones
    least = _NOTHING * float(np.abs(lam).max(initial=0.0))
    modes = [_mode(cone, lam[cone.slots], least) for cone in cones]
    try:
        for _ in range(_LOOKS):
            _, a, _, found, _ = system.evaluate(_in_modes(simulation, x, u, modes), u)
            most = _BEYOND * float(np.abs(found).max(initial=0.0))
            after = [
                _lawful(cone, mode, found[cone.slots], most)
                for cone, mode in zip(cones, modes, strict=True)
            ]
            if after == modes:
                return Seen(a, found)
            modes = after
    except SolveError:
        pass  # the mean forces are what there is
    return _with_means(simulation, x, u, forces)


def _yielding(simulation: Simulation) -> list[int]:
    """Slots of the rows that give way."""
    blocks = simulation.system.layout.yielding
    return [i for block in blocks for i in range(block.slots.start, block.slots.stop)]


def _mode(cone: Cone, force: Array, least: float) -> Mode:
    """The mode of a contact by its mean force in a step, where the least is none."""
    normal, x, y = force.tolist()
    if normal <= least:
        return OPEN
    if math.hypot(x, y) < _AT_BOUND * cone.mu * normal:
        return STICKS
    return 0, *initial_name(-force[1:])


def _in_modes(simulation: Simulation, x: State, u: Array | None, modes: list[Mode]) -> State:
    """The state with these modes of contacts, and of other rows those that it decides."""
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
    entries, of_contacts = list(decided), set[int]()
    for cone, mode, slip in zip(cones, modes, slips, strict=True):
        first = slots.index(cone.slots.start)
        goes_on = not mode[0] and any(mode) and slip.dot(mode[1:]) > 0.0
        entries[first : first + 3] = (0, *initial_name(slip)) if goes_on else mode
        of_contacts.update(range(first, first + 3))
    others = [row for row in undecided if row not in of_contacts]
    if others:
        solution = rows.solve(y, u, tuple(entries), others)
        for row in others:
            if solution.lam[row] <= solution.lower[row]:
                entries[row] = 1
            else:
                entries[row] = -1 if solution.lam[row] >= solution.upper[row] else 0
    return x._replace(mode=tuple(entries))


def _lawful(cone: Cone, mode: Mode, force: Array, most: float) -> Mode:
    """The mode of a contact whose force passes its law no more; the same where it keeps it."""
    normal, x, y = force.tolist()
    if mode[0]:
        return mode
    if normal < -most:
        return OPEN
    if not any(mode) and math.hypot(x, y) > cone.mu * normal + most:
        return 0, *initial_name(-force[1:])
    return mode


def seen_ahead(simulation: Simulation, x: State, u: Array | None) -> Seen:
    """With the mean forces of the step that begins at a state; arguments as for `seen_at`."""
    system, stepper = simulation.system, simulation.stepper
    y, memory = system.reduce(x), stepper.checkpoint()
    held = system.loads.sources.held(x.t) if u is None else u
    stepper.step(y, held, y.t + simulation.dt)
    forces = stepper.forces
    stepper.restart()
    stepper.restore(memory, y)
    assert forces is not None
    return _with_means(simulation, x, u, forces)


def _with_means(simulation: Simulation, x: State, u: Array | None, forces: Array) -> Seen:
    """Accelerations under given forces of the rows that give way."""
    system, slots = simulation.system, _yielding(simulation)
    assert system.event_rows is not None
    now = system.evaluate(x._replace(mode=(1,) * len(system.event_rows.names)), u)
    lam = now.lam.copy()
    lam[slots] = forces
    J = np.concatenate([block.part.jacobian(system.k, x) for block in system.layout.yielding])
    force = (forces - now.lam[slots]).dot(J)
    change = now.respond(force[:, None])[:, 0]
    rigid = system.layout.rigid
    if rigid:  # they answer to it
        M = pin.crba(system.model, system.model.createData(), x.q)
        hold = np.concatenate([block.part.jacobian(system.k, x) for block in rigid])
        own = [i for block in rigid for i in range(block.slots.start, block.slots.stop)]
        lam[own] += np.linalg.lstsq(hold.T, M.dot(change) - force, rcond=None)[0]
    return Seen(now.a + change, lam, is_mean=True)
