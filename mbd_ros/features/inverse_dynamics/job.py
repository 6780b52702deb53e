"""Inverse dynamics of recorded motions: `mbd-ros inverse`.

The torques come from `motion.inverse_solution`. In a result `.effort` is the torque of a joint and
`.command` the input of its actuator.
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
    """Compute the joint torques and constraint forces of a motion.

    Args:
        scene: The scene.
        motion: Result, file or bag with the positions of its joints.
        derivatives: given, causal, zero-phase or opensim.
        cutoff: Half-power frequency of the filters [Hz]; None for the default of the filter.
        half_width: Samples on either side of a local zero-phase fit, in place of a cutoff.
        wrenches: Result, file or bag of the external loads. A bag that holds the motion holds its
            loads, too.
        external: External loads of OpenSim (.xml), in place of those of the scene.
        time_range: First and last time that is solved [s]. Derivatives still come from the whole
            motion.
        wrench_axes: Recorded axis of `wrenches` along each axis of the scene, such as `x,z,-y`;
            `screen` takes them from a .c3d.
        topic: JointState topic of a bag.
        parts: Also compute the torques by cause (gravity, coriolis, inertial, external).
        bounds: Keep efforts within the limits of actuators. Forces of stops, dry friction and
            limited drives are then unknowns within their laws, not parts of the efforts.
        power: Also compute the powers of joints, parts and segments, and their balance.
        stance: `minimum-norm` or `smooth` makes forces of unmeasured contacts unknowns, and
            decides between them where the motion does not; None takes 0 for them.
        stance_gap: Largest gap of a contact that stands, as a multiple of the length L [-].
        stance_speed: Largest speed along the normal of a contact that stands, as a multiple of
            sqrt(g L) [-].
        say: Called with each line for people; without it the lines go to `metadata["remarks"]`.
        progress: True for a line on a terminal, or a function of a label and a share.

    Returns:
        Table `samples`: `time`, `<joint>.position`, `.velocity`, `.acceleration`, `.effort`,
        `<joint>.multiplier`, `<part>.<quantity>`, `<joint>.command`, with `parts` also
        `<joint>.<cause>`. The joints are the independent ones, in a scene with loops all. Free
        bodies have `<body>.position.x` and so on, and the residual force
        `<body>.residual.force_x`, which nothing carries.

    Raises:
        DataError: A file cannot be read or does not fit the scene.
        SolveError: A mechanism with loops cannot be assembled, or its actuators cannot produce
            the motion.
    """
    remarks: list[str] = []
    with watching(progress):
        task = Task(
            motion,
            Derivatives(derivatives, cutoff, half_width),
            wrenches,
            topic,
            parts=parts,
            bounds=bounds,
            external=None if external is None else Path(external),
            time_range=time_range,
            power=power,
            stance=stance_of(stance, stance_gap, stance_speed),
            wrench_axes=wrench_axes,
        )
        result = run_inverse(scene, task, say or remarks.append)
    if say is None:
        result.metadata["remarks"] = remarks
    return result


def run_inverse(scene: Scene, task: Task, say: Say) -> Result:
    """Return the result of `inverse` for a task."""
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
    """Compute the commands that produce the efforts of a table.

    Only actuators that take something else than the torque of their joint get commands, and only
    those without internal states, which a motion does not contain.

    Args:
        scene: The scene.
        table: Motion and efforts.

    Returns:
        Columns `.command`, and remarks on efforts that no command produces.

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
            names_of_states = ", ".join(z.name or "its state" for z in actuator.internal)
            remarks.append(
                f"{actuator.name}: no command, since a motion does not contain {names_of_states}"
            )
            continue
        efforts = np.column_stack([table[f"{name}.effort"] for name in actuator.joints])
        pairs = list(zip(efforts, states, strict=True))
        u = np.array([actuator.demanded(tau, x) for tau, x in pairs])
        if not np.isfinite(u).all():
            row, i = np.argwhere(~np.isfinite(u))[0]
            listed = ", ".join(f"{effort:.4g}" for effort in efforts[row])
            raise DataError(
                f"{inputs[i]}.command at {table[TIME][row]:.9g} s is not "
                f"finite: no command of its actuator produces the effort {listed}"
            )
        produced = _efforts_of_commands(scene, actuator, u, states)
        differs = np.abs(produced - efforts) > _SAME_EFFORT * np.abs(efforts).max(initial=1.0)
        for name, is_beyond in zip(actuator.joints, differs.T, strict=True):
            if is_beyond.any():
                t = table[TIME][int(np.argmax(is_beyond))]
                remarks.append(
                    f"{name}: {is_beyond.sum()} of {len(is_beyond)} efforts are beyond the limit "
                    f"of its actuator, the first at {t:.9g} s"
                )
        if actuator.takes or inputs != actuator.joints:
            names += inputs
            commands.append(u)
    return command_columns(names, np.column_stack(commands)) if names else [], remarks


def _states(scene: Scene, table: Table) -> list[State]:
    """Return the states of all rows of a table."""
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


def _efforts_of_commands(
    scene: Scene, actuator: Actuator, commands: Array, states: Sequence[State]
) -> Array:
    """Return the efforts of the joints of an actuator under its commands, one row per state."""
    k, idle = Kinematics(scene.robot), Loads(scene.robot.model.nv, (), scene.actuators).idle
    at = [scene.robot.joint(name).v for name in actuator.joints]
    efforts = np.empty((len(states), len(at)))
    for row, (u, x) in enumerate(zip(commands, states, strict=True)):
        every = idle.copy()
        every[actuator.u] = u
        k.refresh(x.q, x.v, actuator.reads)
        efforts[row] = actuator.force(k, x, every)[at]
    return efforts


def inverse_to(scene: Scene, task: Task, out: Path, say: Say) -> None:
    """Read a motion, and write its torques.

    Args:
        task: The motion, and what is computed.
        out: Path whose suffix chooses the format.
        say: Called with each line for people.
    """
    sources = [s for s in (task.motion, task.wrenches, task.external) if isinstance(s, Path)]
    refuse_overwriting(out, *sources)
    check_place(out)
    rows, source = _stream(scene, task, out, say), task.derivatives.source
    if rows is None:
        result = run_inverse(scene, task, say)
        result.to(out)
        rows, source = result[MAIN].rows, result.metadata["inputs"]["derivatives"]
    say(f"{rows} samples, {source} derivatives -> {out}")


def _stream(scene: Scene, task: Task, out: Path, say: Say) -> int | None:
    """Write from bag to bag; return the number of samples, or None if this is not possible."""
    if not (isinstance(task.motion, Path) and is_bag(task.motion) and is_bag(out)):
        return None
    if (task.external, task.time_range, task.wrench_axes) != (None, None, None):
        return None
    from mbd_ros.features.inverse_dynamics.bag_stream import stream  # loads rosbags

    return stream(scene, task, task.motion, out, say)


def inverse_batch(batch: Batch, say: Say) -> None:
    """Solve all motions; the options are `parts`, `bounds`, `power` and those of the stance."""

    def check() -> None:
        refuse_unused(load_scene(batch.scene), batch.wrenches)

    do_batch(batch, _inverse_of_batch, inverse_in_worker, say, check)


def inverse_in_worker(argument: Mapping[str, Any]) -> Outcome:
    """Solve one motion in a worker process."""
    return do_one(argument, _inverse_of_batch)


def _inverse_of_batch(batch: Batch, say: Say) -> None:
    outputs = {name: batch.options[name] for name in ("parts", "bounds", "power")}
    stance = stance_of(*(batch.options[name] for name in ("stance", "stance_gap", "stance_speed")))
    task = task_of(batch)._replace(**outputs, stance=stance)
    inverse_to(load_scene(batch.scene), task, batch.out, say)
