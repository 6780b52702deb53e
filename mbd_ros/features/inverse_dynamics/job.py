"""Inverse dynamics of a recorded motion: `mbd-ros inverse`."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.contracts import Actuator
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.kinematics.poses import configuration_of
from mbd_ros.core.loads.inputs import command_names
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.state import NANOSECOND, Array, Motion, State
from mbd_ros.errors import DataError
from mbd_ros.files.body_columns import POSE, TWIST, names_of
from mbd_ros.files.formats import is_bag
from mbd_ros.files.output_file import check_place, refuse_overwriting
from mbd_ros.files.table import MAIN, TIME, Column, Result, Table, stamps_of, time_columns
from mbd_ros.jobs.arguments import about
from mbd_ros.jobs.progress import Say, Watch, watching
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import TorqueComponents
from mbd_ros.motion import inverse_solution as loops
from mbd_ros.motion import inverse_solution as open_chains
from mbd_ros.motion.columns import command_columns
from mbd_ros.motion.derivatives import Derivatives
from mbd_ros.motion.filters import Rows, low_passed
from mbd_ros.motion.inverse_solution import Violations, power_columns, solve_motion
from mbd_ros.motion.long_stamps import Windows
from mbd_ros.motion.recordings import Source, name_of
from mbd_ros.motion.result_metadata import metadata_of
from mbd_ros.motion.samples import Task
from mbd_ros.motion.unmeasured_contacts import stance_of
from mbd_ros.scene.built_scene import Scene

if TYPE_CHECKING:
    pass


# ---- unexplained ------------------------------------------------------------------------------
# How far torques are off the measured ones, both behind the low-pass of the motion.


def unexplained(motion: Motion, table: Table, cutoff: Array) -> Iterator[str]:
    """A line, where the motion has measured efforts.

    Args:
        motion: With the measured efforts; joints without are left out.
        table: With the torques.
        cutoff: Of the low-pass of each of the first joints of the motion [Hz].
    """
    effort = motion.effort
    if effort is None or table.rows != len(motion.stamps):
        return
    pairs = driven(motion.names[: len(cutoff)], list(table), np.isfinite(effort).all(axis=0))
    if not pairs:
        return
    tau = [*(effort[:, j] for j, _ in pairs), *(table[name] for _, name in pairs)]
    windows, own = Windows(motion.stamps, cutoff), cutoff[[j for j, _ in pairs]]
    yield from off_the_effort(windows, np.column_stack(tau), own)


def driven(
    joints: Sequence[str], columns: Sequence[str], measured: NDArray[np.bool_]
) -> list[tuple[int, str]]:
    """Joints whose effort is measured, by their place, and the columns of their torque."""
    ours = [name for name in columns if name.endswith(".effort")]
    pairs = [(name.removesuffix(".effort"), name) for name in ours]
    found = [(joints.index(joint), name) for joint, name in pairs if joint in joints]
    return [(j, name) for j, name in found if measured[j]]


def off_the_effort(windows: Windows, tau: Rows, cutoff: Array) -> Iterator[str]:
    """A line, where measured efforts are not 0.

    Args:
        windows: Of all stamps and the cut-offs.
        tau: Measured efforts, then torques, of the same m joints, shape (n, 2 m).
        cutoff: Of the low-pass of each joint [Hz], shape (m,).
    """
    total, off = 0.0, 0.0
    for passed, step in low_passed(windows, tau, np.tile(cutoff, 2)):
        known, found = np.split(passed, 2, axis=1)
        unit = max(np.abs(known).max(initial=0.0), np.abs(found).max(initial=0.0))
        if not np.isfinite(unit):
            return
        if unit > 0.0:  # squares may overflow
            known, found, weight = known / unit, found / unit, unit * math.sqrt(step)
            total = math.hypot(total, weight * math.sqrt(np.square(known).sum()))
            off = math.hypot(off, weight * math.sqrt(np.square(found - known).sum()))
    if total > 0.0 and math.isfinite(off):
        yield (
            f"off the measured effort by {100.0 * off / total:.3g} % (norm of differences over "
            "norm of efforts, all behind the same low-pass)"
        )


# ---- outcome ----------------------------------------------------------------------------------
# What every result of inverse dynamics says of itself, and what it must be.


def about_result(scene: Scene, task: Task, topics: Mapping[str, object]) -> dict[str, Any]:
    """Metadata of the result, `topics` those of the way it was found."""
    about_it = metadata_of("inverse", scene, _inputs(task), _topics(topics, task))
    return {**about_it, "stamps": "recorded"}


def _inputs(task: Task) -> dict[str, object]:
    """What the metadata of the result says."""
    source, cutoff, half_width = task.derivatives
    asked = {"motion": task.motion, "wrenches": task.wrenches, "derivatives": source}
    between = task.time_range and list(task.time_range)
    filters = {
        "time_range": between,
        "external": task.external,
        "cutoff": cutoff,
        "half_width": half_width,
    }
    also = {name: getattr(task, name) for name in ("parts", "bounds", "power", "wrench_axes")}
    stance = None if task.stance is None else task.stance.method
    return {**asked, **filters, **also, "stance": stance}


def _topics(topics: Mapping[str, object], task: Task) -> dict[str, object]:
    """Topics of a bag, see `files.bags.bag_writer`."""
    causes = TorqueComponents._fields if task.parts else ()
    return {**topics, **{f"/joint_torques/{cause}": {"effort": cause} for cause in causes}}


def check_finite(where: str, table: Table) -> None:
    """Refuse efforts and multipliers that are not."""
    kinds = ("position", "velocity", "acceleration", TIME, "stamp")
    found = [v for name, v in table.items() if name.rpartition(".")[2] not in kinds]
    bad = [int(np.flatnonzero(~np.isfinite(v))[0]) for v in found if not np.isfinite(v).all()]
    if bad:
        raise DataError(f"{where}: torques at {table[TIME][min(bad)]} s are not finite")


# ---- job --------------------------------------------------------------------------------------
# Inverse dynamics of a recorded motion: `mbd-ros inverse`.


# Efforts of joints to commands: `.effort` is joint torque, `.command` what an actuator takes.

_SAME = 1e-9  # of the largest effort


def commands_of(scene: Scene, table: Table) -> tuple[list[Column], list[str]]:
    """Commands that give the efforts of a table, and which efforts no command gives.

    Commands are those of actuators that take something else than the torque of their joint, and
    whose torque follows from a motion: internal states are not in it.

    Args:
        scene: The scene.
        table: Motion and efforts.

    Raises:
        DataError: A command beyond the finite numbers.
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
        short = np.abs(given - wanted) > _SAME * np.abs(wanted).max(initial=1.0)
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


def _states(scene: Scene, table: Table) -> list[State]:
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
        scene: The scene.
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


def inverse_to(scene: Scene, task: Task, out: Path, say: Say) -> None:
    """Read a motion, write its torques.

    Args:
        scene: The scene.
        task: What is asked for.
        out: Its suffix chooses the format.
        say: Is told what was done and left out, a line each.

    Raises:
        MbdError: As `inverse`, or a place that cannot be written to.
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
    from mbd_ros.features.inverse_dynamics.streamed import stream  # loads rosbags

    return stream(scene, task, task.motion, out, say)


def run_inverse(scene: Scene, task: Task, say: Say) -> Result:
    """See `inverse`."""
    where, solved = name_of(task.motion), solve_motion(scene, task, say)
    scene, observed, ground = solved.scene, solved.observed, solved.ground
    columns, remarks, explained = solved.way
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
        for text in unexplained(observed.motion, table, observed.cutoff):
            say(text)
    done = task._replace(derivatives=observed.derivatives)
    contacts = () if ground is None else ground.contacts
    topics = loops.loop_topics(scene, contacts) if solved.has_loops else open_chains.topics(scene)
    return Result({MAIN: table}, about_result(scene, done, topics))
