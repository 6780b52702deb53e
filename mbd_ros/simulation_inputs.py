"""What a simulation is asked for on the command line, and what it reads from files."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.built_scene import Scene
from mbd_ros.core.parts import ForceTerm
from mbd_ros.core.simulation import Commands
from mbd_ros.core.state import NANOSECOND, Array, Motion, State
from mbd_ros.errors import DataError
from mbd_ros.recordings import read_motion, read_wrenches
from mbd_ros.registry import resolve


@dataclass(frozen=True)
class Run:
    """What to simulate.

    Attributes:
        duration: [s].
        out: Table or bag to write.
        origin: Table or bag whose joint state at `start` is the initial one; None takes that of
            the scene.
        start: Time at which the simulation begins [s].
        efforts: Table or bag with the efforts of the actuators, held between samples, or, without
            actuators, of the joints, linear in between.
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


def initial_state(scene: Scene, run: Run) -> State:
    """State of all joints at the start, from the scene or a file.

    Raises:
        DataError: The file has no sample at that time.
    """
    if run.origin is None:
        return scene.initial._replace(t=run.start)
    names = [joint.name for joint in scene.robot.joints]
    motion = read_motion(run.origin, names, required=scene.couplings.independent).motion
    stamp = round(run.start / NANOSECOND)
    row = int(np.argmin(np.abs(motion.stamps - stamp)))
    if abs(int(motion.stamps[row]) - stamp) > 1000:
        first, last = motion.stamps[0] * NANOSECOND, motion.stamps[-1] * NANOSECOND
        raise DataError(
            f"{run.origin}: no sample at {run.start:g} s; it holds {first:g} .. {last:g} s"
        )
    velocity = np.zeros(len(names)) if motion.velocity is None else motion.velocity[row]
    q, v = scene.robot.neutral(), np.zeros(scene.robot.model.nv)
    for joint, position, rate in zip(
        scene.robot.joints, motion.position[row], velocity, strict=True
    ):
        q[joint.q], v[joint.v] = position, 0.0 if np.isnan(rate) else rate
    scene.couplings.expand(q, v, np.zeros(scene.robot.model.nv))
    return State(run.start, q, v)


def drives(scene: Scene, run: Run) -> tuple[Commands | None, list[ForceTerm]]:
    """Commands of the actuators, and force terms that come from files.

    Raises:
        DataError: A file that cannot be read, or that lacks a column or topic.
    """
    forces = _load_terms(scene, run)
    commanded = tuple(joint for actuator in scene.actuators for joint in actuator.joints)
    if run.efforts is None:
        return None, forces
    names = commanded or tuple(joint.name for joint in scene.robot.joints)
    motion = read_motion(run.efforts, names, required=()).motion
    if motion.effort is None:
        raise DataError(f"{run.efforts}: no column <joint>.effort of {', '.join(names)}")
    times, effort = motion.stamps * NANOSECOND, np.nan_to_num(motion.effort)
    if commanded:
        return _held(times, motion), forces
    part = resolve("forces", "prescribed_torque", "--efforts")
    return None, [part(scene.robot, joints=names, times=times, torque=effort), *forces]


def _held(times: Array, motion: Motion) -> Commands:
    effort = motion.effort
    assert effort is not None
    if np.isnan(effort).any():
        lacking = [n for n, bad in zip(motion.names, np.isnan(effort).any(0), strict=True) if bad]
        raise DataError(f"commands of {', '.join(lacking)} are missing")

    def commands(t: float) -> Array:
        return effort[max(int(np.searchsorted(times, t + NANOSECOND, side="right")) - 1, 0)]

    return commands


def _load_terms(scene: Scene, run: Run) -> list[ForceTerm]:
    if not scene.wrenches or run.wrenches is None:
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
