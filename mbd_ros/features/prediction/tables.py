"""Tables of a predicted motion, and the residual forces on its bases."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array, State
from mbd_ros.features.prediction.modes import PhaseMode
from mbd_ros.features.prediction.solving import Prediction
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
_PLANAR = 3  # joints to the ground, from which on a body counts as free
_NO_MASS = 1.0e-6  # of the total mass


def motion_table(
    simulation: Simulation,
    modes: Sequence[PhaseMode],
    motions: Sequence[PhaseMotion],
    *,
    is_converged: bool,
) -> Table:
    """Return samples of a motion at equal times of each phase, with the columns of a simulation.

    A last iterate with open loops has no accelerations, and its table only has positions and
    velocities.
    """
    pairs = zip(modes, motions, strict=True)
    states = [x for mode, motion in pairs for x in _states(mode, motion)]
    table, _, failure = table_of(simulation, states)
    if failure is not None and is_converged:
        raise failure
    if failure is not None:
        return _state_table(simulation, states)
    internals, z = simulation.system.internals, np.array([x.z for x in states])
    pairs_of_z = zip(internals.names, z.T, internals.units, strict=True)
    more = [Column(name, column, unit) for name, column, unit in pairs_of_z if name not in table]
    return Table([*table.columns, *more])


def _states(mode: PhaseMode, motion: PhaseMotion) -> Iterator[State]:
    """Yield states of all joints, both ends of the phase included."""
    shares = np.linspace(0.0, 1.0, SHOWN + 1)
    values = motion.at(shares[:-1])
    rows = {key: np.vstack((values[key], motion.nodes[key][-1])) for key in "qvz"}
    for i, t in enumerate(motion.begin + motion.duration * shares):
        y = State(float(t), *(rows[key][i] for key in "qvz"), mode.mode)
        x = mode.system.expand(y)
        yield x if mode.phased is None else mode.phased.outward(mode.number, x)


def _state_table(simulation: Simulation, states: Sequence[State]) -> Table:
    joints = simulation.system.robot.joints
    q, v = (np.array([getattr(x, key) for x in states]) for key in "qv")
    times = Column(TIME, np.array([x.t for x in states]), "s")
    positions = joint_columns(joints, "position", q[:, [joint.q for joint in joints]])
    velocities = joint_columns(joints, "velocity", v[:, [joint.v for joint in joints]])
    return Table([times, *positions, *velocities])


def requested_columns(prediction: Prediction) -> list[Column]:
    """Return quantities of parts, sensors and joints that the task names, as columns."""
    from mbd_ros.optimal_control.limits import PathBounds

    p, rows = prediction.solution.parameters, list[Array]()
    pairs = list(zip(prediction.problem.program.phases, prediction.solution.motions, strict=True))
    quantities_of_phases = [phase.quantities.requested() for phase, _ in pairs]
    first = quantities_of_phases[0]
    names = [name for name in first if all(name in q for q in quantities_of_phases)]
    for (phase, motion), requested in (
        zip(pairs, quantities_of_phases, strict=True) if names else ()
    ):
        quantities = [(requested[name][0], (-np.inf, np.inf)) for name in names]
        times, values = _sampled_letters(phase, motion, p)
        rows.append(PathBounds(quantities, phase.forms).values(times, values, p))
    units = [first[name][1] for name in names]
    columns = np.vstack(rows).T if rows else ()
    return [Column(*column) for column in zip(names, columns, units, strict=True)]


def _sampled_letters(
    phase: MotionPhase, motion: PhaseMotion, p: Array
) -> tuple[Array, dict[str, Array]]:
    """Return times of the samples of a phase, and all letters there, with consistent forces."""
    shares = np.linspace(0.0, 1.0, SHOWN + 1)
    values = motion.at(shares)
    for key in "qvz":
        values[key][-1] = motion.nodes[key][-1]
    times = motion.begin + motion.duration * shares
    return times, values | phase.equations.solved(values, times, p)


def goal_table(prediction: Prediction) -> Table:
    """Return a table with one goal per row: name, weight and contribution to the cost."""
    values = goal_values(prediction.solution)
    weights = {
        goal.name: goal.weight
        for phase in prediction.problem.program.phases
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
    """Return the contributions of goals to the cost, by name."""
    values = dict[str, float]()
    for block in solution.program.blocks:
        if block.form.has_cost:
            x = solution.solved.x[block.places]
            cost = block.form.cost.map(block.count)(x, block.data)
            values[block.name] = values.get(block.name, 0.0) + float(np.sum(cost.full()))
    return values


def node_table(prediction: Prediction) -> Table:
    """Return a table with one node per row: time, error and points of its interval, costates."""
    from mbd_ros.optimal_control.active_bounds import costates

    parts = list[dict[str, Array]]()
    pairs = zip(prediction.problem.program.phases, prediction.solution.motions, strict=True)
    for i, (phase, motion) in enumerate(pairs):
        part = {TIME: motion.begin + motion.duration * motion.mesh.knots}
        part["error"] = np.append(prediction.errors[i], 0.0)
        part["points"] = np.append(motion.mesh.degrees, 0).astype(float)
        for letter, values in costates(prediction.solution, i).items():
            for k, column in enumerate(values.T):
                part[f"{phase.quantities.name_of(letter, k)}.costate"] = column
        parts.append(part)
    names = [name for name in parts[0] if all(name in part for part in parts)]
    return Table([Column(name, np.concatenate([p[name] for p in parts])) for name in names])


def start_table(starts: Sequence[Start]) -> Table:
    """Return a table with one start per row: number, cost, convergence, iterations, error."""
    names = ("start", "cost", "converged", "iterations", "error")
    values = np.array(starts, dtype=np.float64).T
    return Table([Column(name, column) for name, column in zip(names, values, strict=True)])


def continuation_table(steps: Sequence[Step]) -> Table:
    """Return a table with one step per row: numbers, cost, duration, error between nodes."""
    names = list(steps[0].numbers)
    durations = [sum(m.duration for m in step.prediction.solution.motions) for step in steps]
    return Table(
        [
            *(Column(name, np.array([step.numbers[name] for step in steps])) for name in names),
            Column("cost", np.array([step.prediction.cost for step in steps])),
            Column("duration", np.array(durations), "s"),
            Column("error", np.array([step.prediction.worst for step in steps])),
        ]
    )


def base_residuals(prediction: Prediction) -> Iterator[Residual]:
    """Yield the residual forces on bases of a recorded motion; other motions have none."""
    problem = prediction.problem
    if problem.recording is None:
        return
    scene, first = problem.scene, problem.program.phases[0]
    u = np.vstack([motion.points["u"] for motion in prediction.solution.motions])
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
    """A residual force on a base.

    Attributes:
        name: Name of its input.
        unit: N or N·m.
        rms: Root mean square over all points.
        largest: Largest absolute value.
    """

    name: str
    unit: str
    rms: float
    largest: float

    @property
    def line(self) -> str:
        """Line for people."""
        return (
            f"  residual {self.name}: rms {self.rms:.3g} {self.unit}, "
            f"at most {self.largest:.3g} {self.unit}"
        )


def root_joints(robot: Robot) -> list[str]:
    """Return the joints between ground and first link with mass, if there are three or more."""
    model = robot.model
    mass = [inertia.mass for inertia in model.inertias]
    children = [list(map(int, joints)) for joints in model.children]
    chain, last = list[int](), 0
    while len(children[last]) == 1:
        last = children[last][0]
        chain.append(last)
        if mass[last] > _NO_MASS * sum(mass):
            break
    places = {int(model.joints[i].idx_v) for i in chain if model.joints[i].nv == 1}
    names = [joint.name for joint in robot.joints if joint.v in places]
    return names if len(names) >= _PLANAR else []
