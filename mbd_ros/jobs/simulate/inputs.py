"""What a simulation is asked for on the command line, and what it reads from files."""

import inspect
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.core.inverse.loop_torques import listed
from mbd_ros.core.parts import ForceTerm
from mbd_ros.core.simulation.simulation import Commands
from mbd_ros.core.state import NANOSECOND, Array, Motion, State
from mbd_ros.errors import DataError
from mbd_ros.files.formats import is_bag
from mbd_ros.files.recordings import read_motion, read_wrenches
from mbd_ros.files.times import TIME_LIMIT
from mbd_ros.jobs.error_source import about
from mbd_ros.jobs.inverse.wrenches import refuse_unused
from mbd_ros.scene import schema
from mbd_ros.scene.built_scene import DEFAULT_INTEGRATOR, Scene, refuse_dt
from mbd_ros.scene.part_entries import Solver
from mbd_ros.scene.registry import PARTS, resolve

MOST_ROWS = 10_000_000  # some kilobytes each until they are written
_RESOLVED = 64.0  # rounding errors of the time that a step must be longer than


@dataclass(frozen=True)
class Run:
    """What to simulate.

    Attributes:
        duration: [s].
        out: Table or bag to write.
        origin: Table or bag whose joint state at `start` is the initial one; None takes that of
            the scene.
        start: Time at which the simulation begins [s].
        efforts: Table or bag. With actuators `.command`, what they take, or `.effort` of those
            that take the torque of their joint, held between samples. Without actuators `.effort`
            of the joints, linear in between.
        wrenches: Table or bag of the external loads of the scene.
        options: Keyword arguments of `Scene.simulation`.
    """

    duration: float
    out: Path
    origin: Path | None
    start: float
    efforts: Path | None
    wrenches: Path | None
    options: dict[str, Any]


def check_words(scene: Scene, run: Run) -> None:
    """Refuse what no simulation can be asked for, before anything is read.

    Raises:
        MbdError: Names the option, what is wrong with it and what is accepted.
    """
    if scene.robot.floating:
        raise DataError(f"{scene.name}: robot.base: files carry no pose of a floating base")
    _check_times(scene, run)
    if "solver" in run.options:
        schema.call(Solver, run.options["solver"], "--solver")


def _check_times(scene: Scene, run: Run) -> None:
    """Every output time must be a stamp of its own."""
    dt = run.options.get("dt", scene.dt)
    refuse_dt(run.duration, "-t", DataError)
    refuse_dt(dt, "--dt", DataError)
    end = run.start + run.duration
    if not max(abs(run.start), abs(end)) <= TIME_LIMIT:
        raise DataError(
            f"--start: {run.start:g} s must be finite, the simulation within {TIME_LIMIT:g} s"
        )
    shown = f"--dt: {dt:g} s" if "dt" in run.options else f"{scene.name}: dt: {dt:g} s"
    if dt < _RESOLVED * math.ulp(max(abs(run.start), abs(end))):
        raise DataError(f"{shown} is lost in rounding between {run.start:g} and {end:g} s")
    if run.duration / dt > MOST_ROWS:
        raise DataError(
            f"{shown}: {run.duration / dt:.3g} rows in -t {run.duration:g} s, accepted are "
            f"{MOST_ROWS:g}; with --tolerance, dt is no more than the interval of the output"
        )
    if is_bag(run.out) and run.start < 0:
        raise DataError(f"--start: {run.start:g} s: the stamps of a bag are >= 0")
    if is_bag(run.out) and run.start == 0 and dt < 1.5 * NANOSECOND:
        raise DataError(f"{shown}: the stamps of a bag begin with 1 ns, so it must be >= 2e-09 s")


def method_entry(
    scene: Scene, integrator: str | None, tolerance: float | None
) -> dict[str, Any] | None:
    """Entry of the integrator that the options ask for; None leaves that of the scene.

    Args:
        scene: The scene.
        integrator: Value of `--integrator`.
        tolerance: Value of `--tolerance`, for that integrator or else for that of the scene.

    Raises:
        MbdError: There is no such integrator, or it does not take that tolerance.
    """
    if integrator is None and tolerance is None:
        return None
    entry = dict(scene.integrator_entry or DEFAULT_INTEGRATOR)
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
        entry["tolerance"] = tolerance
    schema.call(kind, {key: v for key, v in entry.items() if key != "type"}, where)
    return entry


def _with_tolerance() -> list[str]:
    kinds = {name: resolve("integrators", name, "") for name in PARTS["integrators"]}
    return [name for name, k in kinds.items() if "tolerance" in inspect.signature(k).parameters]


def initial_state(scene: Scene, run: Run) -> tuple[State, list[str]]:
    """State of all joints at the start, from the scene or a file, and what there is to say.

    Raises:
        DataError: The file has no sample at that time.
    """
    if run.origin is None:
        return scene.initial._replace(t=run.start), []
    names = [joint.name for joint in scene.robot.joints]
    motion = read_motion(run.origin, names, required=scene.couplings.independent).motion
    stamp = round(run.start / NANOSECOND)
    row = int(np.argmin(np.abs(motion.stamps - stamp)))
    if abs(int(motion.stamps[row]) - stamp) > 1000:
        first, last = motion.stamps[0] * NANOSECOND, motion.stamps[-1] * NANOSECOND
        raise DataError(
            f"{run.origin}: no sample at {run.start:g} s; it holds {first:g} .. {last:g} s"
        )
    velocity = np.full(len(names), np.nan)
    if motion.velocity is not None:
        velocity = motion.velocity[row]
    q, v = scene.robot.neutral(), np.zeros(scene.robot.model.nv)
    for joint, position, rate in zip(
        scene.robot.joints, motion.position[row], velocity, strict=True
    ):
        q[joint.q], v[joint.v] = position, 0.0 if np.isnan(rate) else rate
    scene.couplings.expand(q, v, np.zeros(scene.robot.model.nv))
    free = scene.couplings.independent
    lacking = [n for n, rate in zip(names, velocity, strict=True) if n in free and np.isnan(rate)]
    said = [f"{run.origin}: no velocity of {listed(lacking)}: at rest there"] if lacking else []
    return State(run.start, q, v), said


def drives(scene: Scene, run: Run) -> tuple[Commands | None, list[ForceTerm], list[str]]:
    """Commands of the actuators, force terms that come from files, and what there is to say.

    Raises:
        DataError: A file that cannot be read, or that lacks a column or topic.
    """
    forces = _load_terms(scene, run)
    commanded = tuple(joint for actuator in scene.actuators for joint in actuator.joints)
    if run.efforts is None:
        return None, forces, []
    names = commanded or tuple(joint.name for joint in scene.robot.joints)
    motion = read_motion(run.efforts, names, required=()).motion
    if commanded:
        return _held(motion.stamps * NANOSECOND, _commands(scene, run.efforts, motion)), forces, []
    if motion.effort is None:
        raise DataError(f"{run.efforts}: no column <joint>.effort of {', '.join(names)}")
    times, effort = motion.stamps * NANOSECOND, np.nan_to_num(motion.effort)
    gaps = np.isnan(motion.effort).any(axis=0)
    lacking = [name for name, gap in zip(names, gaps, strict=True) if gap]
    part = resolve("forces", "prescribed_torque", "--efforts")
    said = [f"{run.efforts}: no effort of {listed(lacking)}: 0 there"] if lacking else []
    with about(run.efforts):
        torque = part(scene.robot, joints=names, times=times, torque=effort)
    return None, [torque, *forces], said


def _commands(scene: Scene, path: Path, motion: Motion) -> Array:
    """What the actuators take, from `.command`; from `.effort` where that is the same.

    Raises:
        DataError: Commands that are not there, and why an effort is none.
    """
    unknown = np.full((len(motion.stamps), len(motion.names)), np.nan)
    given = unknown.copy() if motion.command is None else motion.command.copy()
    effort = unknown if motion.effort is None else motion.effort
    for actuator in scene.actuators:
        for name in actuator.joints:
            i = motion.names.index(name)
            if not np.isnan(given[:, i]).all():
                continue
            if not actuator.takes:
                given[:, i] = effort[:, i]
            elif not np.isnan(effort[:, i]).all():
                raise DataError(
                    f"{path}: no column {name}.command: its actuator takes the {actuator.takes}, "
                    f"{name}.effort is the torque of the joint; simulate and inverse write both "
                    "into tables"
                )
    lacking = [name for name, u in zip(motion.names, given.T, strict=True) if np.isnan(u).any()]
    if lacking:
        raise DataError(
            f"{path}: commands of {', '.join(lacking)} are missing: no column <joint>.command, "
            "nor <joint>.effort for an actuator that takes the torque of its joint"
        )
    return given


def _held(times: Array, effort: Array) -> Commands:
    def commands(t: float) -> Array:
        return effort[max(int(np.searchsorted(times, t + NANOSECOND, side="right")) - 1, 0)]

    return commands


def _load_terms(scene: Scene, run: Run) -> list[ForceTerm]:
    refuse_unused(scene, run.wrenches)
    if run.wrenches is None:
        return []
    topics = {name: wrench.topic for name, wrench in scene.wrenches.items()}
    part = resolve("forces", "prescribed_wrench", "--wrenches")
    terms: list[ForceTerm] = []
    for name, samples in read_wrenches(run.wrenches, topics).items():
        load = scene.wrenches[name].load
        terms.append(
            part(
                scene.robot,
                frame=load.frame,
                expressed_in=load.expressed_in,
                point=load.point,
                threshold=load.threshold,
                times=samples.stamps * NANOSECOND,
                wrenches=samples.wrench,
            )
        )
    return terms
