"""Inverse dynamics of recorded motions: `mbd-ros inverse`.

The torques come from `motion.inverse_solution`. In a result `.effort` is the torque of a joint and
`.command` what its actuator takes.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.core.contracts import Actuator
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.kinematics.poses import configuration_of
from mbd_ros.core.loads.inputs import command_names
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.state import NANOSECOND, Array, State
from mbd_ros.errors import DataError
from mbd_ros.features.inverse_dynamics.result import check_finite, effort_residual, result_metadata
from mbd_ros.files.body_columns import POSE, TWIST, names_of
from mbd_ros.files.formats import is_bag
from mbd_ros.files.table import MAIN, TIME, Column, Result, Table, stamps_of, time_columns
from mbd_ros.files.text_file import check_place, refuse_overwriting
from mbd_ros.jobs.arguments import about
from mbd_ros.jobs.progress import Say, Watch, watching
from mbd_ros.motion.batch import Batch, Outcome, do_batch, do_one, task_of
from mbd_ros.motion.columns import command_columns
from mbd_ros.motion.derivatives import Derivatives
from mbd_ros.motion.external_loads import refuse_unused
from mbd_ros.motion.inverse_solution import (
    Violations,
    loop_topics,
    power_columns,
    solve_motion,
    topics,
)
from mbd_ros.motion.recordings import Source, name_of
from mbd_ros.motion.samples import Task
from mbd_ros.motion.stance import stance_of
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene

_SAME_EFFORT = 1e-9  # of the largest effort


def inverse(
    scene: Scene,
    motion: Source,
    *,
    derivatives: str = "given",
    cutoff: float | None = None,
    half_width: int | None = None,
    wrenches: Source | None = None,
    external: str | Path | None = None,
    time_range: tuple[float, float] | None = None,
    wrench_axes: str | None = None,
    topic: str = "/joint_states",
    parts: bool = False,
    bounds: bool = False,
    power: bool = False,
    stance: str | None = None,
    stance_gap: float | None = None,
    stance_speed: float | None = None,
    say: Say | None = None,
    progress: Watch = False,
) -> Result:
    """Torques and coupling forces of a motion.

    Args:
        motion: Result, file or bag with the positions of its joints.
        derivatives: given, causal, zero-phase or opensim.
        cutoff: Half-power frequency of the filters [Hz]; None: as `Derivatives` says.
        half_width: Samples on either side of a local zero-phase fit, in place of a cut-off.
        wrenches: Result, file or bag of the external loads; a bag motion carries its own.
        external: External loads of OpenSim (.xml), in place of those of the scene.
        time_range: First and last time that is solved [s]; derivatives come from the whole motion.
        wrench_axes: Recorded axis of `wrenches` along each axis of the scene, as `x,z,-y`, or
            `screen` where a .c3d says them.
        topic: JointState topic of a bag.
        parts: Also give the torque components (gravity, coriolis, inertial, external).
        bounds: Efforts keep the limits of their actuators; stops, dry friction and limited
            drives are unknowns that keep their law, not parts of the efforts.
        power: Also give the powers of joints, parts and segments, their sums and their balance.
        stance: `minimum-norm` or `smooth`: forces of contacts that nobody measured are unknowns,
            and this decides where the motion does not; None takes 0 for them.
        stance_gap: Largest gap of what is on the ground, as a multiple of the size L [-].
        stance_speed: Largest speed of it along the normal, as a multiple of sqrt(g L) [-].
        say: Is called with each line for people; without it the lines are
            `metadata["remarks"]`.
        progress: True for a line on a terminal, or a function of a label and a share.

    Returns:
        Table `samples`: `time`, `<joint>.position`, `.velocity`, `.acceleration`, `.effort`,
        perhaps `.<cause>`, `<joint>.multiplier`, `<part>.<quantity>`, perhaps `<joint>.command`;
        the independent joints, in a scene with loops all of them. Of free bodies
        `<body>.position.x` and so on, and `<body>.residual.force_x`: what nothing carries.

    Raises:
        DataError: Something cannot be read or does not fit the scene.
        SolveError: A mechanism with loops cannot be assembled, or its actuators cannot produce
            the motion.
    """
    chosen = Derivatives(derivatives, cutoff, half_width)
    remarks: list[str] = []
    asked = stance_of(stance, stance_gap, stance_speed)
    with watching(progress):
        loads = None if external is None else Path(external)
        task = Task(
            *(motion, chosen, wrenches, topic, parts, bounds, loads, time_range, power, asked),
            wrench_axes,
        )
        result = run_inverse(scene, task, say or remarks.append)
    if say is None:
        result.metadata["remarks"] = remarks
    return result


def run_inverse(scene: Scene, task: Task, say: Say) -> Result:
    """Do the task of `inverse`."""
    where, solved = name_of(task.motion), solve_motion(scene, task, say)
    scene, observed, ground = solved.scene, solved.observed, solved.ground
    columns, remarks, explained = solved.solution
    if task.power:
        powers, text = power_columns(scene, explained, solved.wrenches, solved.contacts)
        columns, remarks = [*columns, *powers], [*remarks, text]
    table = Table([*time_columns(observed.samples.stamps), *columns])
    check_finite(where, table)
    with about(where), np.errstate(over="ignore", invalid="ignore"):
        commands, beyond = commands_of(scene, table)
    table = Table([*table.columns, *commands])
    violations = Violations(scene)
    violations.add(observed.samples)
    for text in (*violations.lines(), *remarks, *beyond):
        say(text)
    if observed.cutoff is not None:
        for text in effort_residual(observed.motion, table, observed.cutoff):
            say(text)
    done = task._replace(derivatives=observed.derivatives)
    contacts = () if ground is None else ground.contacts
    streams = loop_topics(scene, contacts) if solved.has_loops else topics(scene)
    return Result({MAIN: table}, result_metadata(scene, done, streams))


def commands_of(scene: Scene, table: Table) -> tuple[list[Column], list[str]]:
    """Commands that give the efforts of a table.

    Commands are those of actuators that take something else than the torque of their joint, and
    whose torque follows from a motion: internal states are not in it.

    Args:
        table: Motion and efforts.

    Returns:
        Columns `.command`, and remarks on efforts that no command gives.

    Raises:
        DataError: A command is not finite.
    """
    names: list[str] = []
    commands: list[Array] = []
    remarks = []
    states = _states(scene, table) if scene.actuators else []
    for actuator, inputs in zip(scene.actuators, command_names(scene.actuators), strict=True):
        if not all(f"{name}.effort" in table for name in actuator.joints):
            continue
        if actuator.internal:
            states_of = ", ".join(one.name or "its state" for one in actuator.internal)
            remarks.append(f"{actuator.name}: no command, a motion does not show {states_of}")
            continue
        wanted = np.column_stack([table[f"{name}.effort"] for name in actuator.joints])
        pairs = list(zip(wanted, states, strict=True))
        u = np.array([actuator.demanded(tau, x) for tau, x in pairs])
        if not np.isfinite(u).all():
            row, i = np.argwhere(~np.isfinite(u))[0]
            listed = ", ".join(f"{effort:.4g}" for effort in wanted[row])
            raise DataError(
                f"{inputs[i]}.command at {table[TIME][row]:.9g} s is not "
                f"finite: no command of its actuator gives the effort {listed}"
            )
        given = _given(scene, actuator, u, states)
        short = np.abs(given - wanted) > _SAME_EFFORT * np.abs(wanted).max(initial=1.0)
        for name, lacking in zip(actuator.joints, short.T, strict=True):
            if lacking.any():
                t = table[TIME][int(np.argmax(lacking))]
                remarks.append(
                    f"{name}: its actuator cannot give {lacking.sum()} of {len(lacking)} efforts, "
                    f"the first at {t:.9g} s: beyond its limit"
                )
        if actuator.takes or inputs != actuator.joints:
            names += inputs
            commands.append(u)
    return command_columns(names, np.column_stack(commands)) if names else [], remarks


def _states(scene: Scene, table: Table) -> list[State]:
    """The states of a table, a row each."""
    model = scene.robot.model
    q, v = np.zeros((table.rows, model.nq)), np.zeros((table.rows, model.nv))
    for joint in scene.robot.joints:
        if f"{joint.name}.position" in table:
            q[:, joint.q] = table[f"{joint.name}.position"]
            v[:, joint.v] = table[f"{joint.name}.velocity"]
    for base in scene.robot.bases:
        pose = np.column_stack([table[name] for name in names_of(base.name, POSE)])
        q[:, base.q] = configuration_of(scene.robot, pose)
        v[:, base.v] = np.column_stack([table[name] for name in names_of(base.name, TWIST)])
    times = (stamps_of(table) * NANOSECOND).tolist()
    return [State(*row) for row in zip(times, q, v, strict=True)]


def _given(scene: Scene, actuator: Actuator, commands: Array, states: Sequence[State]) -> Array:
    """Efforts of the joints of an actuator under its commands, a row a state."""
    k, idle = Kinematics(scene.robot), Loads(scene.robot.model.nv, (), scene.actuators).idle
    at = [scene.robot.joint(name).v for name in actuator.joints]
    given = np.empty((len(states), len(at)))
    for row, (u, x) in enumerate(zip(commands, states, strict=True)):
        every = idle.copy()
        every[actuator.u] = u
        k.refresh(x.q, x.v, actuator.reads)
        given[row] = actuator.force(k, x, every)[at]
    return given


def inverse_to(scene: Scene, task: Task, out: Path, say: Say) -> None:
    """Read a motion, write its torques.

    Args:
        task: What is asked for.
        out: Its suffix chooses the format.
        say: Is told what was done and left out, a line each.
    """
    sources = [s for s in (task.motion, task.wrenches, task.external) if isinstance(s, Path)]
    refuse_overwriting(out, *sources)
    check_place(out)
    rows, source = _in_pieces(scene, task, out, say), task.derivatives.source
    if rows is None:
        result = run_inverse(scene, task, say)
        result.to(out)
        rows, source = result[MAIN].rows, result.metadata["inputs"]["derivatives"]
    say(f"{rows} samples, {source} derivatives -> {out}")


def _in_pieces(scene: Scene, task: Task, out: Path, say: Say) -> int | None:
    """Number of samples written from bag to bag; None where that takes the whole motion."""
    if not (isinstance(task.motion, Path) and is_bag(task.motion) and is_bag(out)):
        return None
    if (task.external, task.time_range, task.wrench_axes) != (None, None, None):
        return None
    from mbd_ros.features.inverse_dynamics.bag_stream import stream  # loads rosbags

    return stream(scene, task, task.motion, out, say)


def inverse_batch(batch: Batch, say: Say) -> None:
    """Do all motions; the options are `parts`, `bounds`, `power` and those of the stance."""

    def check() -> None:
        refuse_unused(load_scene(batch.scene), batch.wrenches)

    do_batch(batch, _inverse_of_batch, inverse_in_worker, say, check)


def inverse_in_worker(argument: Mapping[str, Any]) -> Outcome:
    """One motion, in a worker."""
    return do_one(argument, _inverse_of_batch)


def _inverse_of_batch(batch: Batch, say: Say) -> None:
    kinds = {name: batch.options[name] for name in ("parts", "bounds", "power")}
    stance = stance_of(*(batch.options[name] for name in ("stance", "stance_gap", "stance_speed")))
    task = task_of(batch)._replace(**kinds, stance=stance)
    inverse_to(load_scene(batch.scene), task, batch.out, say)
