"""The order of a simulation, and its start: initial state, commands and loads."""

import inspect
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.core.contracts import Load
from mbd_ros.core.kinematics.poses import configuration_of
from mbd_ros.core.loads.inputs import HeldTable, LinearTable, command_names
from mbd_ros.core.loads.inputs import Source as InputSource
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import refuse_dt
from mbd_ros.core.state import NANOSECOND, Array, Motion, State
from mbd_ros.errors import DataError
from mbd_ros.files.formats import is_bag
from mbd_ros.files.table import TIME, TIME_LIMIT
from mbd_ros.jobs.arguments import about
from mbd_ros.methods.inverse_dynamics.efforts import join_names
from mbd_ros.motion.external_loads import refuse_unused
from mbd_ros.motion.recordings import Source, name_of, read_columns, read_motion, read_wrenches
from mbd_ros.scene.built_scene import Scene, Solver
from mbd_ros.scene.runs.simulation import default_integrator
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.registry import PARTS, resolve

MOST_ROWS = 10_000_000  # some kilobytes each until they are written
_RESOLVED = 64.0  # smallest step, in rounding errors of the time


@dataclass(frozen=True)
class Run:
    """Order of a simulation.

    Attributes:
        duration: Simulated time [s].
        origin: Result, file or bag with the initial joint state at `start`; None takes the
            initial state of the scene.
        start: Time at which the simulation starts [s].
        efforts: Result, file or bag of the inputs. With actuators, their `.command`, or `.effort`
            if they take the torque of their joint, constant between samples. Without actuators,
            `.effort` of the joints, linear between samples.
        wrenches: Result, file or bag of the external loads of the scene.
        options: Keyword arguments of `Scene.simulation`.
    """

    duration: float
    origin: Source | None = None
    start: float = 0.0
    efforts: Source | None = None
    wrenches: Source | None = None
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def inputs(self) -> dict[str, Any]:
        """Entry of the order in the metadata of the result."""
        times = {"duration": self.duration, "start": self.start, **self.options}
        files = {"from": self.origin, "efforts": self.efforts, "wrenches": self.wrenches}
        return times | files


def options_of(
    scene: Scene,
    dt: float | None = None,
    integrator: str | Mapping[str, Any] | None = None,
    tolerance: float | None = None,
    solver: str | Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Return keyword arguments of `Scene.simulation`; None leaves those of the scene.

    Args:
        dt: Step, and interval of the output [s].
        integrator: Type of the integrator, or its entry.
        tolerance: Tolerance of that integrator, or without one of that of the scene.
        solver: Type of the solver, or its entry.

    Raises:
        MbdError: There is no such integrator, or it does not take that tolerance.
    """
    options: dict[str, Any] = {} if dt is None else {"dt": dt}
    if isinstance(integrator, Mapping):
        change = {} if tolerance is None else {"tolerance": tolerance}
        method: Mapping[str, Any] | None = {**integrator, **change}
    else:
        method = method_entry(scene, integrator, tolerance)
    if method is not None:
        options["integrator"] = method
    if solver:
        options["solver"] = dict(solver) if isinstance(solver, Mapping) else {"type": solver}
    return options


def method_entry(
    scene: Scene, integrator: str | None, tolerance: float | None
) -> dict[str, Any] | None:
    """Return the entry of the integrator for two options; None leaves that of the scene.

    Args:
        integrator: Value of `--integrator`.
        tolerance: Value of `--tolerance`, for that integrator or without one that of the scene.

    Raises:
        MbdError: There is no such integrator, or it does not take that tolerance.
    """
    if integrator is None and tolerance is None:
        return None
    entry = dict(scene.integrator_entry or default_integrator(scene))
    where, whose = "--tolerance", f"of {scene.name}" if scene.integrator else "by default"
    if integrator is not None:
        entry, where, whose = {"type": integrator}, f"--integrator {integrator}", "you chose"
    kind = resolve("integrators", entry["type"], where.partition(" ")[0])
    if tolerance is not None:
        if "tolerance" not in inspect.signature(kind).parameters:
            raise DataError(
                f"--tolerance: the integrator {entry['type']} {whose} takes steps of dt and has "
                f"none; --integrator takes {', '.join(_with_tolerance())}, which have one"
            )
        if not math.isfinite(tolerance):
            raise DataError(f"--tolerance: {tolerance:g} is not finite")
        entry["tolerance"] = tolerance
    schema.call(kind, {key: v for key, v in entry.items() if key != "type"}, where)
    return entry


def _with_tolerance() -> list[str]:
    kinds = {name: resolve("integrators", name, "") for name in PARTS["integrators"]}
    return [name for name, k in kinds.items() if "tolerance" in inspect.signature(k).parameters]


def check_run(scene: Scene, run: Run) -> None:
    """Refuse an impossible order before anything is read.

    Raises:
        MbdError: An option is not accepted; the message names it and accepted values.
    """
    _check_times(scene, run)
    if "solver" in run.options:
        schema.call(Solver, run.options["solver"], "--solver")


def _check_times(scene: Scene, run: Run) -> None:
    """Refuse output times that would share a stamp."""
    dt = run.options.get("dt", scene.dt)
    refuse_dt(run.duration, "-t", DataError)
    refuse_dt(dt, "--dt", DataError)
    end = run.start + run.duration
    if not max(abs(run.start), abs(end)) <= TIME_LIMIT:
        raise DataError(
            f"--start: {run.start:g} s must be finite, and the end within {TIME_LIMIT:g} s"
        )
    step = _step_text(scene, run)
    if dt < _RESOLVED * math.ulp(max(abs(run.start), abs(end))):
        raise DataError(f"{step} is lost in rounding between {run.start:g} and {end:g} s")
    if run.duration / dt > MOST_ROWS:
        raise DataError(
            f"{step}: {run.duration / dt:.3g} rows in -t {run.duration:g} s, accepted are "
            f"{MOST_ROWS:g}; with --tolerance, dt is no more than the interval of the output"
        )


def _step_text(scene: Scene, run: Run) -> str:
    """Return origin and value of the step for messages."""
    if "dt" in run.options:
        return f"--dt: {run.options['dt']:g} s"
    return f"{scene.name}: dt: {scene.dt:g} s"


def check_stamps(scene: Scene, run: Run, out: Path) -> None:
    """Refuse times that the stamps of a bag cannot hold.

    Raises:
        DataError: A time does not fit; the message names its option.
    """
    dt = run.options.get("dt", scene.dt)
    if is_bag(out) and run.start < 0:
        raise DataError(f"--start: {run.start:g} s: the stamps of a bag are >= 0")
    if is_bag(out) and run.start == 0 and dt < 1.5 * NANOSECOND:
        raise DataError(
            f"{_step_text(scene, run)}: must be >= 2e-09 s, the stamps of a bag start with 1 ns"
        )


def initial_state(scene: Scene, run: Run) -> tuple[State, list[str]]:
    """Return the initial state of all joints, from the scene or a file, and remarks.

    Raises:
        DataError: The file has no sample at that time.
    """
    if run.origin is None:
        return scene.initial._replace(t=run.start), []
    names = [joint.name for joint in scene.robot.joints]
    bodies = {base.name: base.frame for base in scene.robot.bases}
    members = scene.robot.members
    required = scene.couplings.independent
    motion = read_motion(
        run.origin,
        names,
        required=required,
        bodies=bodies,
        members=members,
        sliding=scene.robot.prismatic_joints,
    ).motion
    stamp = round(run.start / NANOSECOND)
    row = int(np.argmin(np.abs(motion.stamps - stamp)))
    if abs(int(motion.stamps[row]) - stamp) > 1000:
        where = name_of(run.origin)
        first, last = motion.stamps[0] * NANOSECOND, motion.stamps[-1] * NANOSECOND
        raise DataError(f"{where}: no sample at {run.start:g} s; it holds {first:g} .. {last:g} s")
    velocity = np.full(len(names), np.nan)
    if motion.velocity is not None:
        velocity = motion.velocity[row]
    q, v = scene.robot.neutral(), np.zeros(scene.robot.model.nv)
    for joint, position, rate in zip(
        scene.robot.joints, motion.position[row], velocity, strict=True
    ):
        q[joint.q], v[joint.v] = position, 0.0 if np.isnan(rate) else rate
    scene.couplings.expand(q, v, np.zeros(scene.robot.model.nv))
    resting = _place_bodies(scene.robot, motion, row, q, v)
    free = scene.couplings.independent
    missing = [n for n, rate in zip(names, velocity, strict=True) if n in free and np.isnan(rate)]
    missing += resting
    where = f"{name_of(run.origin)}: no velocity of"
    remarks = [f"{where} {join_names(missing)}: they start at rest"] if missing else []
    z, more = _internal_states(scene, run.origin, row)
    return State(run.start, q, v, z), remarks + more


def _place_bodies(robot: Robot, motion: Motion, row: int, q: Array, v: Array) -> list[str]:
    """Write the free bodies of a sample into q and v; return those without a velocity."""
    resting = []
    for base, body in zip(robot.bases, motion.bodies, strict=True):
        q[base.q] = configuration_of(robot, body.pose[row])
        if body.twist is None or np.isnan(body.twist[row]).any():
            resting.append(base.name)
        else:
            v[base.v] = body.twist[row]
    return resting


def _internal_states(scene: Scene, origin: Source, row: int) -> tuple[Array, list[str]]:
    """Return the internal states of a sample, or else those of the scene, and remarks."""
    first, names = scene.initial.z, scene.internals.names
    columns = read_columns(origin, names)
    z = first if columns is None else np.where(np.isnan(columns[row]), first, columns[row])
    missing = names if columns is None else np.array(names)[np.isnan(columns[row])].tolist()
    where = f"{name_of(origin)}: no column {join_names(missing)}"
    return z, [f"{where}: they start as in the scene"] if missing else []


def read_inputs(scene: Scene, run: Run) -> tuple[dict[str, InputSource], list[Load], list[str]]:
    """Read the sources of inputs by part, the forces that come from files, and remarks.

    Raises:
        DataError: A file cannot be read, or has no column or topic that is needed.
    """
    sources, remarks = _wrenches(scene, run), list[str]()
    if run.efforts is not None and scene.muscles:
        excitations, remarks = _excitations(scene, run.efforts)
        sources |= excitations
        if not scene.actuators:
            return sources, [], remarks
    commanded = tuple(name for names in command_names(scene.actuators) for name in names)
    if run.efforts is None:
        return sources, [], []
    names = commanded or tuple(joint.name for joint in scene.robot.joints)
    members, sliding = scene.robot.members, scene.robot.prismatic_joints
    motion = read_motion(run.efforts, names, required=(), members=members, sliding=sliding).motion
    where = name_of(run.efforts)
    if commanded:
        with about(where):
            commands = _command_sources(scene, motion, _commands(scene, where, motion))
            return sources | commands, [], remarks
    if motion.effort is None:
        raise DataError(f"{where}: no column <joint>.effort of {', '.join(names)}")
    times, effort = motion.stamps * NANOSECOND, np.nan_to_num(motion.effort)
    gaps = np.isnan(motion.effort).any(axis=0)
    missing = [name for name, gap in zip(names, gaps, strict=True) if gap]
    part = resolve("forces", "prescribed_torque", "--efforts")
    remarks = [f"{where}: no effort of {join_names(missing)}: it is 0"] if missing else []
    with about(where):
        torque = part(scene.robot, joints=names, times=times, torque=effort)
    return sources, [torque], remarks


def _wrenches(scene: Scene, run: Run) -> dict[str, InputSource]:
    """Return the sources of external loads by name, linear between samples."""
    refuse_unused(scene, run.wrenches)
    if run.wrenches is None:
        return {}
    topics = {name: wrench.topic for name, wrench in scene.wrenches.items()}
    samples = read_wrenches(run.wrenches, topics)
    with about(name_of(run.wrenches)):
        return {
            name: LinearTable(load.stamps * NANOSECOND, load.wrench)
            for name, load in samples.items()
        }


def _excitations(scene: Scene, origin: Source) -> tuple[dict[str, InputSource], list[str]]:
    """Return the excitations of muscles by name, constant between samples, and remarks.

    Raises:
        DataError: The file has no excitation of any muscle.
    """
    names, where = [f"{part.name}.excitation" for part in scene.muscles], name_of(origin)
    columns = read_columns(origin, (TIME, *names))
    if columns is None or np.isnan(columns[:, 1:]).all():
        raise DataError(f"{where}: no column {join_names(names)}")
    times, values = columns[:, 0], columns[:, 1:]
    has_values = ~np.isnan(values).any(axis=0)
    with about(where):
        sources: dict[str, InputSource] = {
            part.name: HeldTable(times, values[:, [i]])
            for i, part in enumerate(scene.muscles)
            if has_values[i]
        }
    missing = [name for name, has in zip(names, has_values, strict=True) if not has]
    remark = f"{where}: no {join_names(missing)}: the least excitation is used"
    return sources, [remark] if missing else []


def _command_sources(scene: Scene, motion: Motion, commands: Array) -> dict[str, InputSource]:
    """Return the sources of actuators by name, from all commands in their order."""
    times = motion.stamps * NANOSECOND
    return {part.name: HeldTable(times, commands[:, part.u]) for part in scene.actuators}


def _commands(scene: Scene, where: str, motion: Motion) -> Array:
    """Return the commands of actuators, from `.command`, or from `.effort` if that is the same.

    Raises:
        DataError: Commands are missing, and efforts cannot replace them.
    """
    unknown = np.full((len(motion.stamps), len(motion.names)), np.nan)
    commands = unknown.copy() if motion.command is None else motion.command.copy()
    effort = unknown if motion.effort is None else motion.effort
    for actuator, names in zip(scene.actuators, command_names(scene.actuators), strict=True):
        for name in names:
            i = motion.names.index(name)
            if not np.isnan(commands[:, i]).all():
                continue
            if not actuator.takes and name in actuator.joints:
                commands[:, i] = effort[:, i]
            elif not np.isnan(effort[:, i]).all():
                raise DataError(
                    f"{where}: no column {name}.command: its actuator takes the {actuator.takes}, "
                    f"{name}.effort is the torque of the joint; simulate and inverse write both "
                    "into tables"
                )
    missing = [n for n, u in zip(motion.names, commands.T, strict=True) if np.isnan(u).any()]
    if missing:
        raise DataError(
            f"{where}: commands of {', '.join(missing)} are missing: no column <joint>.command, "
            "nor <joint>.effort for an actuator that takes the torque of its joint"
        )
    return commands
