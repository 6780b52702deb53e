"""Solve the inverse dynamics of recorded motions, with and without closed loops."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbd_ros.core.dynamics.output_values import Showing
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.couplings import IndependentCoordinates
from mbd_ros.core.rows.constraint import Constraint
from mbd_ros.core.rows.constraint_rows import ConstraintRows, CouplingRows, RowLayout
from mbd_ros.core.state import NANOSECOND, Array, State
from mbd_ros.core.thresholds import TOGGLE
from mbd_ros.errors import DataError, SolveError
from mbd_ros.files.table import Column
from mbd_ros.jobs.progress import Say, progress
from mbd_ros.methods.inverse_dynamics.closed_loop import ClosedLoopInverseDynamics
from mbd_ros.methods.inverse_dynamics.efforts import join_names
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import TorqueComponents, Torques
from mbd_ros.methods.inverse_dynamics.power import ExertedForces, PowerBalance
from mbd_ros.methods.inverse_dynamics.torque_estimator import Observations
from mbd_ros.motion.columns import (
    body_columns,
    body_topics,
    carried_columns,
    force_topic,
    joint_columns,
    output_columns,
    state_topics,
    whole_bodies,
)
from mbd_ros.motion.recordings import name_of
from mbd_ros.motion.samples import Observed, Task, loads_of_laboratory, observe_motion
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reading.coupling_entries import coupling_kinds

if TYPE_CHECKING:
    from mbd_ros.methods.inverse_dynamics.force_split import ForceTarget
    from mbd_ros.motion.known_contacts import KnownContact
    from mbd_ros.motion.stance import Ground

_CHUNK = 1000  # samples between two updates of the progress bar


def solve_motion(scene: Scene, task: Task, say: Say) -> Solved:
    """Return efforts and multipliers of a motion.

    Args:
        scene: The scene.
        task: The motion, and options.
        say: Function that prints remarks.

    Raises:
        DataError: The motion or its loads cannot be used, or options exclude each other.
        SolveError: The mechanism cannot be assembled, or actuators cannot produce the motion.
    """
    external = loads_of_laboratory(scene, task)
    if external is not None:
        scene = external.scene
        for text in external.remarks:
            say(text)
    where = name_of(task.motion)
    for text in scene.robot.inertia_warnings:
        say(f"warning: {text}")
    own_loads = set(scene.wrenches)
    scene, known, ground = _known_contacts(scene, task, say)
    has_loops = scene.has_loops or task.bounds or ground is not None
    if task.parts and has_loops:
        raise DataError(
            f"{scene.name}: --parts is accepted only for scenes without loops, and without "
            "--bounds and --stance"
        )
    observed = observe_motion(scene, task, say, external)
    samples = observed.samples
    scene, wrenches = _with_contacts(scene, known, observed)
    if has_loops:
        if ground is not None:
            stamps = observed.motion.stamps, observed.samples.stamps
            ground = ground.with_recorded_states(scene, task.motion, *stamps)
        solution = solve_closed(scene, where, samples, wrenches, task, ground)
    else:
        solution = solve_open(scene, where, samples, wrenches, task)
    contacts = {name for name in scene.wrenches if name not in own_loads}
    return Solved(scene, observed, wrenches, contacts, known, ground, has_loops, solution)


def _known_contacts(
    scene: Scene, task: Task, say: Say
) -> tuple[Scene, list[KnownContact], Ground | None]:
    """Return the scene, contacts whose forces are recorded, and those of unknown force."""
    if not scene.parts.get("contacts"):
        if task.stance is not None:
            raise DataError(f"{scene.name}: --stance needs a scene with rigid contacts")
        return scene, [], None
    from mbd_ros.motion.known_contacts import known_contacts  # only where something touches

    tell = say if task.stance is None else lambda text: None
    scene, known = known_contacts(scene, task.motion, task.topic, tell)
    if task.stance is None:
        return scene, known, None
    from mbd_ros.motion.stance import ground_of

    ground = ground_of(scene, task.stance, [one.name for one in known], say)
    return scene, known, ground if ground.contacts else None


def _with_contacts(
    scene: Scene, known: list[KnownContact], observed: Observed
) -> tuple[Scene, list[Array]]:
    """Return the scene with known contacts as external loads, and the values of all loads."""
    if not known:
        return scene, observed.wrenches
    from mbd_ros.motion.known_contacts import contact_loads

    loads, wrenches = contact_loads(scene, known, observed.motion, observed.samples)
    every = {**scene.wrenches, **loads}
    return scene.holding(external_wrenches=every), [*observed.wrenches, *wrenches]


class Solved(NamedTuple):
    """A motion with its efforts and loads.

    Attributes:
        scene: The scene, with known contacts among its external loads.
        observed: The prepared motion.
        wrenches: One (n, 6) array for every external load of the scene.
        contacts: Names of the external loads that are contact forces.
        known: Contacts with recorded forces.
        ground: Contacts of unknown force, or None.
        has_loops: Whether there are constraints besides couplings.
        solution: Efforts and multipliers.
    """

    scene: Scene
    observed: Observed
    wrenches: list[Array]
    contacts: set[str]
    known: list[KnownContact]
    ground: Ground | None
    has_loops: bool
    solution: Solution


class Solution(NamedTuple):
    """Efforts and multipliers of a motion.

    Attributes:
        columns: Columns of motion, efforts and multipliers.
        remarks: Remarks on the solution.
        explained: The solution as states and forces.
    """

    columns: list[Column]
    remarks: list[str]
    explained: Explained


class Explained(NamedTuple):
    """A motion with the forces that cause it.

    Attributes:
        rows: Constraint rows of the multipliers.
        driven: Joints with efforts.
        count: Number of samples.
        motions: Function that yields state, accelerations and forces, sample by sample.
    """

    rows: ConstraintRows
    driven: Sequence[str]
    count: int
    motions: Callable[[], Iterator[tuple[State, Array, ExertedForces]]]


def solve_open(
    scene: Scene, where: str, samples: Observations, wrenches: Sequence[Array], task: Task
) -> Solution:
    """Solve a scene without loops.

    The result contains torques of the independent joints, multipliers of the dependent ones, and
    residuals of free bodies.

    Args:
        scene: A scene without loops.
        where: Source of the motion, for messages.
        samples: Samples of the independent joints.
        wrenches: One (n, 6) array for every load of the scene.
        task: Options; `parts` adds torque components.
    """
    chains = OpenChains(scene, task.parts)
    solved = chains.solved(samples, wrenches)
    columns = chains.columns_of(samples, wrenches, solved)
    return Solution(columns, [], chains.explained(samples, solved))


class OpenChains:
    """Inverse dynamics of a scene without loops.

    Args:
        scene: The scene.
        with_parts: Whether to compute the torque components, too.
    """

    def __init__(self, scene: Scene, with_parts: bool) -> None:
        self._scene = scene
        self._with_parts = with_parts
        self._solver = scene.inverse_dynamics()
        self._at = IndependentCoordinates(scene.robot, self._solver.couplings)
        couplings = scene.couplings
        rows = [CouplingRows(scene.robot, couplings)] if couplings.dependent else []
        self._layout = RowLayout(rows)
        self._showing = Showing(Kinematics(scene.robot), self._layout, scene.forces)

    def columns(self, samples: Observations, wrenches: Sequence[Array]) -> list[Column]:
        """Return columns of the motion and the torques."""
        return self.columns_of(samples, wrenches, self.solved(samples, wrenches))

    def solved(self, samples: Observations, wrenches: Sequence[Array]) -> Torques:
        """Return the torques of all samples."""
        solver, (z, v, a) = self._solver, samples[1:4]
        chunks = [slice(i, i + _CHUNK) for i in range(0, len(z), _CHUNK)]
        solved = [
            solver.batch(z[part], v[part], a[part], [w[part] for w in wrenches])
            for part in progress(chunks, len(chunks), "solving")
        ]
        tau, multipliers = (np.concatenate([each[i] for each in solved]) for i in (0, 1))
        residual = np.concatenate([each.residual.reshape(len(each.tau), -1) for each in solved])
        return Torques(tau, multipliers, solved[0].rank, residual)

    def columns_of(
        self, samples: Observations, wrenches: Sequence[Array], solved: Torques
    ) -> list[Column]:
        """Return columns of the motion and of its torques."""
        solver, robot, at = self._solver, self._scene.robot, self._at
        (z, v, a), (tau, multipliers, _, residual) = samples[1:4], solved[:4]
        fields = {"position": z, "velocity": v, "acceleration": a, "effort": tau}
        if self._with_parts:
            fields |= self._components(samples, wrenches)
        joints, columns = [robot.joint(name) for name in solver.couplings.independent], []
        for field, values in fields.items():
            indices = at.joint_y if field == "position" else at.joint_w
            columns += joint_columns(joints, field, values[:, indices])
        bodies = [(z[:, y], v[:, w], a[:, w]) for y, w in zip(at.body_y, at.body_w, strict=True)]
        columns += [*body_columns(robot, bodies), *carried_columns(robot, residual)]
        return [*columns, *self._outputs(samples, multipliers)]

    def _components(self, samples: Observations, wrenches: Sequence[Array]) -> dict[str, Array]:
        """Return the torques by cause."""
        each = zip(*samples[1:4], *wrenches, strict=True)
        rows = progress(each, len(samples.stamps), "components")
        components = [self._solver.components(*row[:3], row[3:]) for row in rows]
        names = TorqueComponents._fields
        return {name: np.array([c[i] for c in components]) for i, name in enumerate(names)}

    def explained(self, samples: Observations, solved: Torques) -> Explained:
        """Return the motion of all joints with the forces that cause it."""
        couplings, robot = self._scene.couplings, self._scene.robot
        rows = ConstraintRows(self._layout.blocks, robot.model.nv)
        index = couplings.v_index
        carried = np.isin(index, robot.base_v)

        def motions() -> Iterator[tuple[State, Array, ExertedForces]]:
            each = zip(self._states(samples), *solved[:2], strict=True)
            for (x, a), tau, multipliers in each:
                efforts, residual = np.zeros(robot.model.nv), np.zeros(robot.model.nv)
                efforts[index], residual[index] = np.where(
                    carried, (0.0 * tau, tau), (tau, 0.0 * tau)
                )
                yield x, a, ExertedForces(efforts, residual, multipliers)

        return Explained(rows, couplings.independent, len(samples.stamps), motions)

    def _states(self, samples: Observations) -> Iterator[tuple[State, Array]]:
        """Yield states and accelerations of all joints."""
        robot, couplings = self._scene.robot, self._scene.couplings
        for sample in samples.rows():
            q, v, a = robot.neutral().copy(), np.zeros(robot.model.nv), np.zeros(robot.model.nv)
            q[couplings.q_index], v[couplings.v_index], a[couplings.v_index] = sample[1:4]
            couplings.expand(q, v, a)
            yield State(sample.stamp * NANOSECOND, q, v), a

    def _outputs(self, samples: Observations, multipliers: Array) -> list[Column]:
        """Return columns of multipliers and of outputs of forces."""
        scene, showing = self._scene, self._showing
        if len(showing.numbers) == multipliers.shape[1]:
            return output_columns(showing.numbers, multipliers)
        u = Loads(scene.robot.model.nv, scene.forces, scene.actuators).idle
        pairs = zip(self._states(samples), multipliers, strict=True)
        values = [showing.at(x, u, a, lam) for (x, a), lam in pairs]
        return output_columns(showing.numbers, np.array(values))


def solve_closed(
    scene: Scene,
    where: str,
    samples: Observations,
    wrenches: Sequence[Array],
    task: Task,
    ground: Ground | None = None,
) -> Solution:
    """Solve a scene with loops, bounds or unknown contact forces.

    The result contains all joints, the efforts of actuators and the multipliers.

    Args:
        scene: The scene.
        where: Source of the motion, for messages.
        samples: Samples of the independent joints.
        wrenches: One (n, 6) array for every load of the scene.
        task: Options; `bounds` keeps efforts and multipliers within their bounds.
        ground: Contacts of unknown force.

    Raises:
        SolveError: The mechanism cannot be assembled, or the actuators cannot produce the motion;
            the message names the time.
    """
    contacts = (
        {} if ground is None else {"contacts": ground.contacts, "thresholds": ground.task.near}
    )
    observed = scene.inverse_dynamics(with_bounds=task.bounds, **contacts)
    inverse, states, corrections = observed.inverse, [], []
    for sample in samples.rows():
        t = sample.stamp * NANOSECOND
        measured, measured_a = observed.measured(t, *sample[1:4])
        with _error_context(where, t):
            x, a = inverse.project_motion(measured, measured_a)
        states.append((x, a))
        steps = x.q - measured.q, x.v - measured.v, a - measured_a
        corrections.append([np.abs(step).max(initial=0.0) for step in steps])
    standing = None
    if ground is not None:
        from mbd_ros.motion.stance import smooth_transitions, stance_lines, standing_in

        standing = standing_in(inverse, ground, states)

    def solved_at(i: int, target: ForceTarget | None = None) -> Torques:
        here = None if standing is None else standing[i]
        with _error_context(where, states[i][0].t):
            return inverse.solve(*states[i], [load[i] for load in wrenches], here, target)

    solved = [solved_at(i) for i in progress(range(len(states)), len(states), "solving")]
    remarks = list(_remarks(np.max(corrections, axis=0), samples.stamps, solved))
    if ground is not None and standing is not None:
        passed = ""
        if ground.task.method == "smooth":
            passed = smooth_transitions(inverse, states, standing, solved, solved_at)
        remarks += stance_lines(inverse, ground, standing, solved, passed)
    columns = _columns(scene, inverse, states, solved)
    return Solution(columns, remarks, _explained(inverse, states, solved))


@contextmanager
def _error_context(where: str, t: float) -> Iterator[None]:
    """Add source and time of a sample to its errors."""
    try:
        yield
    except SolveError as error:
        raise SolveError(f"{where}: at {t:.9g} s: {error}") from error


def _remarks(corrections: Array, stamps: np.ndarray, solved: Sequence[Torques]) -> Iterator[str]:
    q, v, a = corrections
    yield (
        f"moved onto the constraints by at most {q:.3g} rad or m, {v:.3g} per s, {a:.3g} per s^2"
    )
    widest = max(solved, key=lambda each: each.null_space)
    if widest.undetermined:
        yield (
            f"null space of dimension {widest.null_space}: {join_names(widest.undetermined)} are "
            "not determined, smallest norm taken"
        )
    worst = int(np.argmax([each.condition for each in solved]))
    condition = solved[worst].condition
    if condition > TOGGLE:
        yield (
            f"condition number {condition:.2g} at {stamps[worst] * NANOSECOND:.9g} s: near a "
            "toggle, multipliers are unreliable there"
        )


def _columns(
    scene: Scene,
    inverse: ClosedLoopInverseDynamics,
    states: Sequence[tuple[State, Array]],
    solved: Sequence[Torques],
) -> list[Column]:
    """Return columns of the motion and of the solution."""
    q, v, a = (np.array(each) for each in zip(*((x.q, x.v, a) for x, a in states), strict=True))
    joints = scene.robot.joints
    at_q, at_v = [joint.q for joint in joints], [joint.v for joint in joints]
    effort = np.array([each.tau for each in solved])
    showing = _showing(scene, inverse.constraints.parts)
    u = Loads(scene.robot.model.nv, scene.forces, scene.actuators).idle
    outputs = [
        showing.at(x, u, a, each.multipliers) for (x, a), each in zip(states, solved, strict=True)
    ]
    driven, free = (
        [scene.robot.joint(name) for name in names]
        for names in (inverse.efforts.names, inverse.root_joints)
    )
    carried = np.array([each.root_residual for each in solved]).reshape(len(solved), -1)
    return [
        *joint_columns(joints, "position", q[:, at_q]),
        *joint_columns(joints, "velocity", v[:, at_v]),
        *joint_columns(joints, "acceleration", a[:, at_v]),
        *joint_columns(driven, "effort", effort),
        *joint_columns(free, "residual", carried),
        *body_columns(scene.robot, whole_bodies(scene.robot, q, v, a)),
        *carried_columns(scene.robot, np.array([each.residual for each in solved])),
        *output_columns(showing.numbers, np.array(outputs)),
    ]


def _showing(scene: Scene, constraints: Sequence[Constraint]) -> Showing:
    """Return the outputs of parts; `constraints` in the order of the multipliers."""
    return Showing(Kinematics(scene.robot), RowLayout(constraints), scene.forces)


def _explained(
    inverse: ClosedLoopInverseDynamics,
    states: Sequence[tuple[State, Array]],
    solved: Sequence[Torques],
) -> Explained:
    """Return the motion with the forces that cause it."""

    def motions() -> Iterator[tuple[State, Array, ExertedForces]]:
        for (x, a), each in zip(states, solved, strict=True):
            efforts = inverse.columns(x).dot(each.tau)
            yield x, a, ExertedForces(efforts, inverse.unsupported_force(each), each.multipliers)

    return Explained(inverse.constraints, inverse.efforts.names, len(states), motions)


class Violations:
    """Largest deviations of measured dependent joints from their couplings."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._deviations = np.zeros(len(scene.couplings.dependent))  # NaN where not measured

    def add(self, samples: Observations) -> None:
        """Take more samples into account."""
        couplings, robot = self._scene.couplings, self._scene.robot
        if not couplings.dependent:
            return
        q = np.zeros((robot.model.nq, len(samples.stamps)))
        q[couplings.q_index] = samples.position.T
        couplings.expand(q, np.zeros_like(q), np.zeros_like(q))
        coupled = q[[robot.joint(name).q for name in couplings.dependent]].T
        measured = np.where(np.isfinite(samples.dependent), samples.dependent, np.nan)
        self._deviations = np.maximum(self._deviations, np.abs(measured - coupled).max(axis=0))

    def lines(self) -> Iterator[str]:
        """Yield one line per dependent joint."""
        for name, deviation in zip(self._scene.couplings.dependent, self._deviations, strict=True):
            if np.isnan(deviation):
                yield f"{name} is reconstructed from {coupling_kinds(self._scene)[name]}"
            else:
                yield f"{name} is off its coupling by at most {deviation:.3g}"


def power_columns(
    scene: Scene, explained: Explained, wrenches: Sequence[Array], contacts: Collection[str]
) -> tuple[list[Column], str]:
    """Return columns of powers, and a remark on their balance.

    Args:
        scene: The scene.
        explained: The motion with the forces that cause it.
        wrenches: One (n, 6) array for every load of the scene.
        contacts: Names of the loads that are contact forces.
    """
    rows, driven, count, motions = explained
    loads = scene.wrenches
    balance = PowerBalance(scene.robot, rows, driven, loads, scene.forces_without_input, contacts)
    values = np.array(
        [
            balance.values(*motion, [load[i] for load in wrenches])
            for i, motion in enumerate(progress(motions(), count, "power"))
        ]
    )
    columns = output_columns(balance.outputs, values)
    return columns, _balance_line(columns)


def _balance_line(columns: Sequence[Column]) -> str:
    """Return a remark on the difference of all powers and the rate of the kinetic energy."""
    named = {column.name: column.values for column in columns}
    sums = [v for name, v in named.items() if name.startswith("power.") and "energy" not in name]
    residual = float(np.abs(named["power.residual"]).max())
    largest = max(float(np.abs(values).max()) for values in sums)
    return f"power: balance off by at most {residual:.2g} W, the largest sum is {largest:.4g} W"


def topics(scene: Scene) -> dict[str, Any]:
    """Return the topics of a bag, see `files.bags.bag_writer`."""
    return {
        "/joint_torques": {field: field for field in ("effort", "position", "velocity")},
        **body_topics(scene.robot),
        "/constraint_forces": {"effort": "multiplier"},
    }


def loop_topics(scene: Scene, contacts: Collection[str] = ()) -> dict[str, Any]:
    """Return the topics of a bag, see `files.bags.bag_writer`."""
    rows = scene.closed_loop(contacts=contacts).constraints.rows
    states = state_topics(scene.robot, ("position", "velocity"))
    return {**topics(scene), **force_topic(rows), **states}
