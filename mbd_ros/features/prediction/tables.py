"""Tables of a predicted motion, and what holds it up that no joint could."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array, State
from mbd_ros.features.prediction.modes import PhaseMode
from mbd_ros.features.prediction.solving import Found
from mbd_ros.files.table import TIME, Column, Table
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.motion.columns import joint_columns
from mbd_ros.motion.state_table import table_of
from mbd_ros.optimal_control.phase_motion import PhaseMotion

if TYPE_CHECKING:
    from mbd_ros.features.prediction.search import Start, Step
    from mbd_ros.optimal_control.motion_phase import MotionPhase
    from mbd_ros.optimal_control.motion_program import Solution

GOALS = "goals"
NODES = "nodes"
CONTINUATION = "continuation"
STARTS = "starts"
SHOWN = 240  # intervals of the samples of a phase
_PLANAR = 3  # joints to the ground, from which on a body moves freely
_NO_MASS = 1.0e-6  # of all


def motion_table(
    simulation: Simulation,
    modes: Sequence[PhaseMode],
    motions: Sequence[PhaseMotion],
    *,
    is_converged: bool,
) -> Table:
    """Samples of a motion at equal times of each phase, with the columns of a simulation.

    A last iterate has no accelerations where its loops are open: it has positions and velocities
    alone then.
    """
    pairs = zip(modes, motions, strict=True)
    states = [x for mode, motion in pairs for x in _states(mode, motion)]
    table, _, failure = table_of(simulation, states)
    if failure is not None and is_converged:
        raise failure
    if failure is not None:
        return _states_alone(simulation, states)
    internals, z = simulation.system.internals, np.array([x.z for x in states])
    pairs_of_z = zip(internals.names, z.T, internals.units, strict=True)
    more = [Column(name, one, unit) for name, one, unit in pairs_of_z if name not in table]
    return Table([*table.columns, *more])


def _states(mode: PhaseMode, motion: PhaseMotion) -> Iterator[State]:
    """States of all joints, both ends of the phase included."""
    shares = np.linspace(0.0, 1.0, SHOWN + 1)
    values = motion.at(shares[:-1])
    rows = {key: np.vstack((values[key], motion.nodes[key][-1])) for key in "qvz"}
    for i, t in enumerate(motion.begin + motion.duration * shares):
        y = State(float(t), *(rows[key][i] for key in "qvz"), mode.mode)
        x = mode.system.expand(y)
        yield x if mode.phased is None else mode.phased.outward(mode.number, x)


def _states_alone(simulation: Simulation, states: Sequence[State]) -> Table:
    joints = simulation.system.robot.joints
    q, v = (np.array([getattr(x, key) for x in states]) for key in "qv")
    times = Column(TIME, np.array([x.t for x in states]), "s")
    positions = joint_columns(joints, "position", q[:, [joint.q for joint in joints]])
    velocities = joint_columns(joints, "velocity", v[:, [joint.v for joint in joints]])
    return Table([times, *positions, *velocities])


def asked_columns(found: Found) -> list[Column]:
    """Quantities of parts, sensors and joints that the task names, at the times of the motion."""
    from mbd_ros.optimal_control.limits import PathBounds

    p, rows = found.solution.parameters, list[Array]()
    pairs = list(zip(found.problem.program.phases, found.solution.motions, strict=True))
    every = [phase.quantities.asked() for phase, _ in pairs]
    names = [name for name in every[0] if all(name in one for one in every)]
    for (phase, motion), asked in zip(pairs, every, strict=True) if names else ():
        quantities = [(asked[name][0], (-np.inf, np.inf)) for name in names]
        times, values = _letters(phase, motion, p)
        rows.append(PathBounds(quantities, phase.forms).values(times, values, p))
    units = [every[0][name][1] for name in names]
    columns = np.vstack(rows).T if rows else ()
    return [Column(*one) for one in zip(names, columns, units, strict=True)]


def _letters(phase: MotionPhase, motion: PhaseMotion, p: Array) -> tuple[Array, dict[str, Array]]:
    """Times of the samples of a phase, and all letters there, forces as the equations say."""
    shares = np.linspace(0.0, 1.0, SHOWN + 1)
    values = motion.at(shares)
    for key in "qvz":
        values[key][-1] = motion.nodes[key][-1]
    times = motion.begin + motion.duration * shares
    return times, values | phase.equations.solved(values, times, p)


def goal_table(found: Found) -> Table:
    """A row a goal: name, weight and what it adds to the cost."""
    values = goal_values(found.solution)
    weights = {
        goal.name: goal.weight
        for phase in found.problem.program.phases
        for goal in phase.problem.goals
    }
    return Table(
        [
            Column("goal", np.array(list(weights))),
            Column("weight", np.array(list(weights.values()))),
            Column("value", np.array([values.get(name, 0.0) for name in weights])),
        ]
    )


def goal_values(solution: Solution) -> dict[str, float]:
    """Name of a goal -> what it adds to the cost."""
    found = dict[str, float]()
    for block in solution.program.blocks:
        if block.form.has_cost:
            x = solution.solved.x[block.places]
            values = block.form.cost.map(block.count)(x, block.data)
            found[block.name] = found.get(block.name, 0.0) + float(np.sum(values.full()))
    return found


def node_table(found: Found) -> Table:
    """A row a node: time, error and points of the interval that follows, costates."""
    from mbd_ros.optimal_control.active_bounds import costates

    parts = list[dict[str, Array]]()
    pairs = zip(found.problem.program.phases, found.solution.motions, strict=True)
    for i, (phase, motion) in enumerate(pairs):
        part = {TIME: motion.begin + motion.duration * motion.mesh.knots}
        part["error"] = np.append(found.errors[i], 0.0)
        part["points"] = np.append(motion.mesh.degrees, 0).astype(float)
        for letter, values in costates(found.solution, i).items():
            for k, column in enumerate(values.T):
                part[f"{phase.quantities.name_of(letter, k)}.costate"] = column
        parts.append(part)
    names = [name for name in parts[0] if all(name in part for part in parts)]
    return Table([Column(name, np.concatenate([p[name] for p in parts])) for name in names])


def start_table(starts: Sequence[Start]) -> Table:
    """A row a start: its number, cost, whether it is a solution, iterations, error."""
    names = ("start", "cost", "converged", "iterations", "error")
    values = np.array(starts, dtype=np.float64).T
    return Table([Column(name, one) for name, one in zip(names, values, strict=True)])


def continuation_table(steps: Sequence[Step]) -> Table:
    """A row a value: the numbers, cost, duration, error between nodes."""
    names = list(steps[0].numbers)
    durations = [sum(one.duration for one in step.found.solution.motions) for step in steps]
    return Table(
        [
            *(Column(name, np.array([step.numbers[name] for step in steps])) for name in names),
            Column("cost", np.array([step.found.cost for step in steps])),
            Column("duration", np.array(durations), "s"),
            Column("error", np.array([step.found.worst for step in steps])),
        ]
    )


def residuals_of(found: Found) -> Iterator[Residual]:
    """The forces on bases of a motion that was recorded; of any other there are none."""
    problem = found.problem
    if problem.recording is None:
        return
    scene, first = problem.scene, problem.program.phases[0]
    u = np.vstack([motion.points["u"] for motion in found.solution.motions])
    units = [channel.unit for channel in scene.inputs.channels]
    for joint in root_joints(scene.robot):
        name = f"{joint}.effort"
        if name in first.quantities.names and first.quantities.find(name)[0].letter == "u":
            at = first.quantities.find(name)[0].index
            yield _residual(
                name, "N" if joint in scene.robot.prismatic_joints else "N·m", u[:, at]
            )
    for part in problem.residuals:
        slots = scene.inputs.slots[part]
        for at in range(slots.start, slots.stop):
            yield _residual(scene.inputs.names[at], units[at], u[:, at])


def _residual(name: str, unit: str, values: np.ndarray) -> Residual:
    rms = float(np.sqrt(np.mean(values**2)))
    return Residual(name, unit, rms, float(np.abs(values).max(initial=0.0)))


class Residual(NamedTuple):
    """A force on a base.

    Attributes:
        name: Of its input.
        unit: N or N·m.
        rms: Over all points.
        largest: The largest size.
    """

    name: str
    unit: str
    rms: float
    largest: float

    @property
    def line(self) -> str:
        """For people."""
        return (
            f"  residual {self.name}: rms {self.rms:.3g} {self.unit}, "
            f"at most {self.largest:.3g} {self.unit}"
        )


def root_joints(robot: Robot) -> list[str]:
    """Joints between the ground and the first link with mass, where they are three or more."""
    model = robot.model
    mass = [one.mass for one in model.inertias]
    children = [list(map(int, one)) for one in model.children]
    found, at = list[int](), 0
    while len(children[at]) == 1:
        at = children[at][0]
        found.append(at)
        if mass[at] > _NO_MASS * sum(mass):
            break
    places = {int(model.joints[i].idx_v) for i in found if model.joints[i].nv == 1}
    names = [joint.name for joint in robot.joints if joint.v in places]
    return names if len(names) >= _PLANAR else []
