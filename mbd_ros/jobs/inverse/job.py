"""Inverse dynamics of a recorded motion: `mbd-ros inverse`."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.estimation.torque_estimator import Observation, TorqueEstimator, Tuning
from mbd_ros.core.inverse.inverse_dynamics import TorqueComponents
from mbd_ros.core.state import Array, Motion
from mbd_ros.errors import DataError
from mbd_ros.files.recordings import Source, name_of, read_motion
from mbd_ros.files.replacing import check_place, refuse_overwriting
from mbd_ros.files.table import MAIN, Result, Table
from mbd_ros.files.times import TIME, time_columns
from mbd_ros.jobs.error_source import about
from mbd_ros.jobs.inverse import loops, open_chains
from mbd_ros.jobs.inverse.commands import commands_of
from mbd_ros.jobs.inverse.derivatives import (
    Derivatives,
    causal_line,
    differentiate,
    observe,
    unexplained,
)
from mbd_ros.jobs.inverse.loop_closing import close_loops
from mbd_ros.jobs.inverse.open_chains import violations
from mbd_ros.jobs.inverse.wrenches import read_loads, wrench_at
from mbd_ros.jobs.metadata import metadata_of
from mbd_ros.jobs.progress import Watch, watching
from mbd_ros.scene.built_scene import Scene

Say = Callable[[str], None]


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
    """

    motion: Source
    derivatives: Derivatives = Derivatives("given")
    wrenches: Source | None = None
    topic: str = "/joint_states"
    parts: bool = False
    bounds: bool = False


def inverse(
    scene: Scene,
    motion: Source,
    *,
    derivatives: str = "given",
    cutoff: float | None = None,
    half_width: int | None = None,
    wrenches: Source | None = None,
    topic: str = "/joint_states",
    parts: bool = False,
    bounds: bool = False,
    say: Say | None = None,
    progress: Watch = False,
) -> Result:
    """Torques and coupling forces of a motion.

    Args:
        scene: The scene.
        motion: Result, file or bag with the positions of its joints.
        derivatives: given, causal or zero-phase.
        cutoff: Half-power frequency of the filters [Hz]; None: as `Derivatives` says.
        half_width: Samples on either side of a local zero-phase fit, in place of a cut-off.
        wrenches: Result, file or bag of the external loads; a bag motion carries its own.
        topic: JointState topic of a bag.
        parts: Also give the torque components (gravity, coriolis, inertial, external).
        bounds: Efforts keep the limits of their actuators; stops, dry friction and limited
            drives are unknowns that keep their law, not parts of the efforts.
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
    with watching(progress):
        task = Task(motion, chosen, wrenches, topic, parts, bounds)
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
    sources = [s for s in (task.motion, task.wrenches) if isinstance(s, Path)]
    refuse_overwriting(out, *sources)
    check_place(out)
    result = run_inverse(scene, task, say)
    result.to(out)
    say(f"{result[MAIN].rows} samples, {task.derivatives.source} derivatives -> {out}")


def run_inverse(scene: Scene, task: Task, say: Say) -> Result:
    """See `inverse`."""
    way = loops if scene.has_loops or task.bounds else open_chains
    if task.parts and not way.HAS_CAUSES:
        raise DataError(f"{scene.name}: --parts goes with scenes without loops and --bounds only")
    where = name_of(task.motion)
    for text in scene.robot.doubts:
        say(f"warning: {text}")
    observed = _observed(scene, task, say)
    samples, wrenches = observed.samples, observed.wrenches
    asked = task.bounds if way is loops else task.parts
    columns, remarks = way.solve(scene, where, samples, wrenches, asked)
    table = Table([*time_columns(observed.stamps), *columns])
    _check_finite(where, table)
    with about(where), np.errstate(over="ignore", invalid="ignore"):
        commands, beyond = commands_of(scene, table)
    table = Table([*table.columns, *commands])
    for text in (*violations(scene, samples), *remarks, *beyond):
        say(text)
    if observed.cutoff is not None:
        for text in unexplained(observed.motion, table, observed.cutoff):
            say(text)
    about_it = metadata_of("inverse", scene, _inputs(task), _topics(way.topics(scene), task))
    return Result({MAIN: table}, {**about_it, "stamps": "recorded"})


class _Observed(NamedTuple):
    """What is solved.

    Attributes:
        motion: As it was read.
        samples: Of the independent joints, with derivatives.
        stamps: Theirs [ns], shape (n,).
        wrenches: One (n, 6) array for every load of the scene.
        cutoff: Of the low-pass of each joint [Hz]; None without one.
    """

    motion: Motion
    samples: list[Observation]
    stamps: NDArray[np.int64]
    wrenches: list[Array]
    cutoff: Array | None


def _observed(scene: Scene, task: Task, say: Say) -> _Observed:
    """Read a motion and its loads, and give it derivatives."""
    where, derivatives = name_of(task.motion), task.derivatives
    with about("--cutoff"):
        tuning = Tuning(cutoff=derivatives.causal_cutoff)
        solver = scene.inverse_dynamics()
        estimator = TorqueEstimator(scene.robot, solver, tuning)
    motion = _motion(scene, task, estimator.names, solver.needed, say)
    loads, dropped = read_loads(scene, task.motion, task.wrenches)
    if derivatives.source == "causal":
        with np.errstate(over="ignore", invalid="ignore"):  # the results are looked at
            samples, cutoff = observe(estimator, motion, dropped), None
        say(causal_line(estimator.differentiator, derivatives.causal_cutoff))
    else:
        with about(where), np.errstate(over="ignore", invalid="ignore"):
            samples, cutoff, remarks = differentiate(scene, where, motion, derivatives)
        for text in remarks:
            say(text)
    for reason, count in dropped.items():
        say(f"{count} samples left out: {reason}")
    if not samples:
        raise DataError(f"{where}: no sample can be used")
    stamps = np.array([x.stamp for x in samples], dtype=np.int64)
    wrenches = [wrench_at(name, load, stamps) for name, load in loads.items()]
    return _Observed(motion, samples, stamps, wrenches, cutoff)


def _motion(
    scene: Scene, task: Task, names: Sequence[str], needed: Sequence[str], say: Say
) -> Motion:
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
    )
    recording, remarks = close_loops(scene, where, recording)
    for text in remarks:
        say(text)
    for reason, count in recording.dropped.items():
        say(f"{where}: {count} messages left out: {reason}")
    if recording.by_log_time:
        say(f"{where}: stamps are 0, the times of the log are used")
    return recording.motion


def _inputs(task: Task) -> dict[str, object]:
    """What the metadata of the result says."""
    source, cutoff, half_width = task.derivatives
    asked = {"motion": task.motion, "wrenches": task.wrenches, "derivatives": source}
    filters = {"cutoff": cutoff, "half_width": half_width}
    return {**asked, **filters, "parts": task.parts, "bounds": task.bounds}


def _topics(topics: Mapping[str, object], task: Task) -> dict[str, object]:
    """Topics of a bag, see `files.bag_streams`."""
    causes = TorqueComponents._fields if task.parts else ()
    return {**topics, **{f"/joint_torques/{cause}": {"effort": cause} for cause in causes}}


def _check_finite(where: str, table: Table) -> None:
    """Refuse efforts and multipliers that are not."""
    kinds = ("position", "velocity", "acceleration", TIME, "stamp")
    found = [v for name, v in table.items() if name.rpartition(".")[2] not in kinds]
    bad = [int(np.flatnonzero(~np.isfinite(v))[0]) for v in found if not np.isfinite(v).all()]
    if bad:
        raise DataError(f"{where}: torques at {table[TIME][min(bad)]} s are not finite")
