"""What inverse dynamics is asked for, and the samples that it is asked at."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mbd_ros.core.inverse_dynamics.reach import listed
from mbd_ros.core.inverse_dynamics.torque_estimator import Observations, TorqueEstimator, Tuning
from mbd_ros.core.state import NANOSECOND, Array, Motion, WrenchSamples
from mbd_ros.errors import DataError
from mbd_ros.files.recording import Recording
from mbd_ros.jobs.error_source import about
from mbd_ros.jobs.lines import Say
from mbd_ros.motion.causal import causal_line, observe
from mbd_ros.motion.derivatives import OPENSIM, Derivatives, differentiate
from mbd_ros.motion.loop_closing import close_loops
from mbd_ros.motion.recordings import Source, name_of, read_motion
from mbd_ros.motion.wrenches import read_loads, wrench_at
from mbd_ros.scene.built_scene import Scene

if TYPE_CHECKING:
    from mbd_ros.motion.external_loads import ExternalLoads
    from mbd_ros.motion.unmeasured_contacts import StanceTask

_NEAR = 0.01  # steps of the motion: times that were resampled are a little off


class Task(NamedTuple):
    """What is asked for.

    Attributes:
        motion: Result, file or bag.
        derivatives: Where velocity and acceleration come from.
        wrenches: Result, file or bag of the external loads; a bag motion carries its own.
        topic: JointState topic of a bag.
        parts: Also give the torques by cause; not for scenes with loops, where a cause alone may
            be out of reach of the actuators.
        bounds: Keep the bounds of efforts and multipliers.
        external: External loads of a laboratory (.xml), in place of `wrenches`.
        time_range: First and last time of the samples that are solved [s]; None for all.
        power: Also give powers and their balance.
        stance: Forces of contacts that nobody measured are unknowns; None for none of them.
        wrench_axes: Recorded axis of `wrenches` along each axis of the scene; None: the same.
    """

    motion: Source
    derivatives: Derivatives = Derivatives("given")
    wrenches: Source | None = None
    topic: str = "/joint_states"
    parts: bool = False
    bounds: bool = False
    external: Path | None = None
    time_range: tuple[float, float] | None = None
    power: bool = False
    stance: "StanceTask | None" = None
    wrench_axes: str | None = None


class Observed(NamedTuple):
    """What is solved.

    Attributes:
        motion: As it was read.
        samples: Of the independent joints, with derivatives.
        wrenches: One (n, 6) array for every load of the scene.
        cutoff: Of the low-pass of each joint [Hz]; None without one.
        derivatives: Where velocity and acceleration came from.
    """

    motion: Motion
    samples: Observations
    wrenches: list[Array]
    cutoff: Array | None
    derivatives: Derivatives


def loads_of_laboratory(scene: Scene, task: Task) -> "ExternalLoads | None":
    """The external loads that a motion names, and the scene that carries them; None without.

    Raises:
        DataError: As `ExternalLoads`, or wrenches beside them.
    """
    if task.external is None:
        return None
    if task.wrenches is not None:
        raise DataError(f"--external {task.external}: --wrenches gives the loads already")
    if task.wrench_axes is not None:
        raise DataError(f"--external {task.external}: --wrench-axes turns --wrenches alone")
    from mbd_ros.motion.external_loads import ExternalLoads  # reads XML, loads scipy

    return ExternalLoads(scene, task.external)


def observe_motion(
    scene: Scene, task: Task, say: Say, external: "ExternalLoads | None" = None
) -> Observed:
    """Read a motion and its loads, and give it derivatives."""
    where, derivatives = name_of(task.motion), task.derivatives
    solver = scene.inverse_dynamics()
    with about("--cutoff"):
        tuning = Tuning(cutoff=derivatives.causal_cutoff)
        estimator = TorqueEstimator(scene.robot, solver, tuning)
    recording = read_recording(scene, task, estimator.names, solver.needed, say)
    motion = recording.motion
    loads, dropped = dict[str, WrenchSamples](), Counter[str]()
    if external is None:
        loads, dropped = read_loads(scene, task.motion, task.wrenches, task.wrench_axes)
    if recording.of_laboratory and derivatives.source == "given" and motion.velocity is None:
        derivatives = derivatives._replace(source="zero-phase" if motion.bodies else OPENSIM)
        say(f"positions alone: {derivatives.source} derivatives")
    if derivatives.source == "causal":
        with np.errstate(over="ignore", invalid="ignore"):  # the results are looked at
            samples, cutoff = observe(estimator, motion, dropped), None
        remarks = [causal_line(estimator.differentiator, derivatives.causal_cutoff)]
    else:
        with about(where), np.errstate(over="ignore", invalid="ignore"):
            samples, cutoff, remarks = differentiate(scene, where, motion, derivatives)
    for text in remarks:
        say(text)
    for reason, count in dropped.items():
        say(f"{count} samples left out: {reason}")
    if not len(samples.stamps):
        raise DataError(f"{where}: no sample can be used")
    samples = _within(where, samples, task.time_range)
    wrenches = [wrench_at(name, load, samples.stamps) for name, load in loads.items()]
    if external is not None:
        wrenches = external.at(samples.stamps)
    return Observed(motion, samples, wrenches, cutoff, derivatives)


def _within(
    where: str, samples: Observations, time_range: tuple[float, float] | None
) -> Observations:
    """The samples of a time, those at its ends among them."""
    if time_range is None:
        return samples
    times = samples.stamps * NANOSECOND
    margin = _NEAR * float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    inside = (times >= time_range[0] - margin) & (times <= time_range[1] + margin)
    if not inside.any():
        raise DataError(
            f"{where}: --time-range {time_range[0]:g} {time_range[1]:g}: no sample is there, the "
            f"motion is at {times[0]:.6g} to {times[-1]:.6g} s"
        )
    return Observations(*(field[inside] for field in samples))


def read_recording(
    scene: Scene, task: Task, names: Sequence[str], needed: Sequence[str], say: Say
) -> Recording:
    """The motion, with what loops give of it."""
    where = name_of(task.motion)
    bodies = {base.name: base.frame for base in scene.robot.bases}
    recording = read_motion(
        task.motion,
        names,
        topic=task.topic,
        required=needed,
        bodies=bodies,
        members=scene.robot.members,
        sliding=scene.robot.sliding,
        assumed=lambda name: float(scene.initial.q[scene.robot.joint(name).q]),
    )
    for text in _storage_lines(where, recording, scene.robot.locked):
        say(text)
    recording, remarks = close_loops(scene, where, recording)
    for text in remarks:
        say(text)
    for reason, count in recording.dropped.items():
        say(f"{where}: {count} messages left out: {reason}")
    if recording.by_log_time:
        say(f"{where}: stamps are 0, the times of the log are used")
    return recording


def _storage_lines(where: str, recording: Recording, locked: Mapping[str, float]) -> Iterator[str]:
    """What a storage of a laboratory has besides joints, and which of them it lacks."""
    motion = recording.motion
    yield from (f"{where}: {text}" for text in recording.remarks)
    if recording.assumed:
        start = [motion.position[0, motion.names.index(name)] for name in recording.assumed]
        there = [f"{n} = {q:.6g}" for n, q in zip(recording.assumed, start, strict=True)]
        said = f"{where}: no column of some joints, they stay where the scene starts"
        yield f"{said}: {', '.join(there)}"
    unused = recording.unused or ()
    if held := [label for label in unused if label in locked]:
        yield f"{where}: columns of joints that the model locks, not used: {listed(held)}"
    if others := [label for label in unused if label not in locked]:
        yield f"{where}: columns of no joint, not used: {listed(others)}"
