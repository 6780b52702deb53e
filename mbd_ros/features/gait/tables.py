"""Tables of gaits: motion, length, speed, energy, branches and basins."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.contracts import Load
from mbd_ros.core.state import Array, State
from mbd_ros.features.gait.continuation import DOUBLING, FOLD, TORUS, NamedBranch
from mbd_ros.features.gait.periodic import PeriodicMotion
from mbd_ros.features.gait.search import Gait
from mbd_ros.features.gait.task import GaitTask
from mbd_ros.files.table import TIME, Column, Table
from mbd_ros.methods.sensitivities.flow import Travel
from mbd_ros.methods.sensitivities.simulated_flow import SimulatedFlow
from mbd_ros.motion.columns import body_columns, joint_columns, whole_bodies
from mbd_ros.motion.state_table import table_of
from mbd_ros.scene.built_scene import Scene

if TYPE_CHECKING:
    from mbd_ros.features.gait.basin import Outcome

_WORK_SAMPLES = 201  # of a segment: odd, as Simpson's rule requires
GAITS, BRANCHES, BASIN = "gaits", "branches", "basin"
MARKS = ("", FOLD, DOUBLING, TORUS)  # the indices are the numbers in a table
_SHOWN_STATES = 201  # states of a segment


def gait_table(flow: SimulatedFlow, gaits: Sequence[Gait], measures: Sequence[Measures]) -> Table:
    """Return a table with one gait per row.

    Returns:
        `gait`, `period`, `stable`, `travel`, `speed`, `energy_lost`, `positive_work`,
        `negative_work`, `cost_of_transport`, `multiplier_1.real`, `.imaginary`, .., the state just
        after the event of the section, and `residual` of the return map.
    """
    motions = [gait.motion for gait in gaits]
    columns = [
        Column("gait", np.arange(1, len(gaits) + 1)),
        Column("period", np.array([measure.period for measure in measures]), "s"),
        Column("stable", np.array([motion.is_stable for motion in motions])),
        *_measure_columns(measures),
        *_multiplier_columns([motion.multipliers for motion in motions]),
        *state_columns(flow, [motion.state for motion in motions]),
        Column("residual", np.array([motion.residual for motion in motions])),
    ]
    return Table(columns)


class Measures(NamedTuple):
    """Quantities of a gait over the cycles after which it repeats.

    Attributes:
        period: Duration [s].
        travel: Displacement along the travel [m]; None where nothing travels.
        speed: Travel over period [m/s]; None where nothing travels.
        energy_lost: Energy that impacts and other events dissipate [J].
        positive_work: Positive work of actuators [J].
        negative_work: Negative work of actuators [J], <= 0.
        cost_of_transport: Positive work over weight and travel; None without travel.
    """

    period: float
    travel: float | None
    speed: float | None
    energy_lost: float
    positive_work: float
    negative_work: float
    cost_of_transport: float | None


def _measure_columns(measures: Sequence[Measures]) -> list[Column]:
    columns = []
    for name, unit in (
        ("travel", "m"),
        ("speed", "m/s"),
        ("energy_lost", "J"),
        ("positive_work", "J"),
        ("negative_work", "J"),
        ("cost_of_transport", ""),
    ):
        values = [getattr(measure, name) for measure in measures]
        if None not in values:
            columns.append(Column(name, np.array(values, dtype=np.float64), unit))
    return columns


def _multiplier_columns(all_values: Sequence[Array]) -> list[Column]:
    values, columns = np.array(all_values), []
    for i, each in enumerate(values.T, 1):
        if i == 1 or np.abs(each).max() > 0.0:
            name = f"multiplier_{i}"
            columns.append(Column(f"{name}.real", each.real))
            columns.append(Column(f"{name}.imaginary", each.imag))
    return columns


def state_columns(flow: SimulatedFlow, states: Sequence[State]) -> list[Column]:
    """Return columns of joints, free bodies and internal states."""
    system = flow.system
    states_of_joints = [system.expand(y) for y in states]
    q, v, z = (np.array([getattr(x, key) for x in states_of_joints]) for key in ("q", "v", "z"))
    joints, internals = system.robot.joints, system.internals
    return [
        *joint_columns(joints, "position", q[:, [joint.q for joint in joints]]),
        *joint_columns(joints, "velocity", v[:, [joint.v for joint in joints]]),
        *body_columns(system.robot, whole_bodies(system.robot, q, v, None)),
        *(
            Column(name, values, unit)
            for name, values, unit in zip(internals.names, z.T, internals.units, strict=True)
        ),
    ]


def motion_table(flow: SimulatedFlow, gait: Gait) -> Table:
    """Return the samples of a gait until it repeats, with the columns of a simulation.

    Samples at an event hold the state after it; the last sample is before the last event.
    """
    states, segments = list[State](), list[int]()
    begin = gait.motion.passage.segments[0].begin.t
    for i, segment in enumerate(gait.motion.passage.segments):
        if segment.end.t <= segment.begin.t:
            continue
        if states:
            del states[-1], segments[-1]
        new_states = flow.states(segment, _SHOWN_STATES)
        states += [flow.system.expand(y)._replace(mode=y.mode) for y in new_states]
        segments += [i] * len(new_states)
    table, _, failure = table_of(flow, states)  # type: ignore[arg-type]
    if failure is not None:
        raise failure
    columns = [c._replace(values=c.values - begin) if c.name == TIME else c for c in table.columns]
    return Table([*columns, Column("gait.segment", np.array(segments))])


def branch_table(
    flow: SimulatedFlow, branches: Sequence[NamedBranch], gaits: Sequence[Gait]
) -> Table:
    """Return a table with one point of a branch per row.

    Returns:
        `branch`, `gait`, `cycles`, `parameter`, `period`, `stable`, `mark`,
        `travel`, `speed`, multipliers and the state just after the event of the section. A mark is
        0 at an ordinary point, 1 at a fold, 2 at a period doubling, 3 at a torus bifurcation.
    """
    rows = [(i, b, p) for i, b in enumerate(branches, 1) for p in b.branch.points]
    motions = [point.motion for _, _, point in rows]
    periods = np.array([motion.passage.period for motion in motions])
    columns = [
        Column("branch", np.array([i for i, _, _ in rows])),
        Column("gait", np.array([named.gait for _, named, _ in rows])),
        Column("cycles", np.array([named.branch.cycles for _, named, _ in rows])),
        Column("parameter", np.array([point.parameter for _, _, point in rows])),
        Column("period", periods, "s"),
        Column("stable", np.array([motion.is_stable for motion in motions])),
        Column("mark", np.array([MARKS.index(point.mark) for _, _, point in rows])),
    ]
    travel = gaits[0].travel
    if len(travel.directions):
        moved = [
            travel.place(motion.passage.segments[-1].end) - travel.place(motion.passage.begin)
            for motion in motions
        ]
        length = np.linalg.norm(moved, axis=1)
        columns += [Column("travel", length, "m"), Column("speed", length / periods, "m/s")]
    columns += _multiplier_columns([motion.multipliers for motion in motions])
    return Table([*columns, *state_columns(flow, [motion.state for motion in motions])])


def basin_table(outcomes: Sequence[Outcome]) -> Table:
    """Return a table with one start per row: its values, `outcome` and `cycles`.

    The outcome is the number of the gait, 0 for a fall, -1 where neither was reached, and -2 where
    the loops cannot be closed.
    """
    names = list(outcomes[0].start)
    return Table(
        [
            *(Column(name, np.array([o.start[name] for o in outcomes])) for name in names),
            Column("outcome", np.array([outcome.number for outcome in outcomes])),
            Column("cycles", np.array([outcome.cycles for outcome in outcomes])),
        ]
    )


def measure_gait(
    scene: Scene, task: GaitTask, flow: SimulatedFlow, travel: Travel, motion: PeriodicMotion
) -> Measures:
    """Return length, speed and energy of a gait."""
    passage, system = motion.passage, flow.system
    period = passage.period
    moved = travel.place(passage.segments[-1].end) - travel.place(passage.begin)
    length = float(np.linalg.norm(moved)) if len(moved) else None
    if task.step_between:
        length = _distance(scene, flow, passage.segments[-1].end, task.step_between)
    lost = sum(system.energy(s.end) - system.energy(s.after) for s in passage.segments)
    positive, negative = _work(flow, motion)
    weight = pin.computeTotalMass(scene.robot.model) * float(
        np.linalg.norm(scene.robot.model.gravity.linear)
    )
    is_known = length is not None and length > 0.0 and weight > 0.0
    return Measures(
        period,
        length,
        None if length is None else length / period,
        float(lost),
        positive,
        negative,
        positive / (weight * float(length or 1.0)) if is_known else None,
    )


def _distance(scene: Scene, flow: SimulatedFlow, y: State, frames: tuple[str, ...]) -> float:
    """Return the distance of two frames [m]."""
    robot, x = scene.robot, flow.system.expand(y)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, x.q)
    first, second = (data.oMf[robot.frame(name)].translation for name in frames)
    return float(np.linalg.norm(first - second))


def _work(flow: SimulatedFlow, motion: PeriodicMotion) -> tuple[float, float]:
    """Return positive and negative work of the actuators, by Simpson's rule."""
    if not _working(flow):
        return 0.0, 0.0
    positive = negative = 0.0
    for segment in motion.passage.segments:
        duration = segment.end.t - segment.begin.t
        if duration <= 0.0:
            continue
        powers = np.array([_powers(flow, x) for x in flow.states(segment, _WORK_SAMPLES)])
        weights = np.full(_WORK_SAMPLES, 2.0)
        weights[1::2], weights[[0, -1]] = 4.0, 1.0
        weights *= duration / (3.0 * (_WORK_SAMPLES - 1))
        positive += float(weights.dot(np.maximum(powers, 0.0)).sum())
        negative += float(weights.dot(np.minimum(powers, 0.0)).sum())
    return positive, negative


def _working(flow: SimulatedFlow) -> list[Load]:
    loads = flow.system.loads
    return [load for load in (*loads.actuators, *loads.forces) if load.gives_work]


def _powers(flow: SimulatedFlow, y: State) -> Array:
    """Return the power of each actuator [W], shape (n,)."""
    system = flow.system
    x = system.expand(y)
    loads, k = system.loads, system.k
    u, powers = loads.inputs(x, None), []
    for actuator in _working(flow):
        k.refresh(x.q, x.v, actuator.reads)
        powers.append(float(actuator.force(k, x, u).dot(x.v)))
    return np.array(powers)
