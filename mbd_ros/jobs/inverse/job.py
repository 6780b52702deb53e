"""Inverse dynamics of a recorded motion: `mbd-ros inverse`."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from mbd_ros.core.estimation.torque_estimator import Observation, TorqueEstimator, Tuning
from mbd_ros.core.inverse.inverse_dynamics import InverseDynamics, TorqueComponents
from mbd_ros.core.state import WrenchSamples
from mbd_ros.errors import DataError
from mbd_ros.files.formats import is_bag
from mbd_ros.files.recordings import read_motion
from mbd_ros.files.records import Recording, TorqueRecord
from mbd_ros.files.replacing import refuse_overwriting
from mbd_ros.files.results import write_torques
from mbd_ros.jobs.error_source import about
from mbd_ros.jobs.inverse.commands import with_commands
from mbd_ros.jobs.inverse.derivatives import (
    Derivatives,
    causal_line,
    differentiate,
    observe,
    unexplained,
)
from mbd_ros.jobs.inverse.loops import close_loops, solve_loops
from mbd_ros.jobs.inverse.wrenches import read_loads, wrench_at
from mbd_ros.jobs.progress import progress
from mbd_ros.scene.built_scene import Scene

_CHUNK = 1000  # samples between two signs of progress


def inverse_dynamics_of(
    scene: Scene,
    motion: Path,
    out: Path,
    *,
    derivatives: Derivatives,
    wrenches: Path | None = None,
    topic: str = "/joint_states",
    with_parts: bool = False,
) -> Iterator[str]:
    """Read a motion, write its torques.

    Args:
        scene: The scene.
        motion: Table or bag.
        out: Table or bag to write.
        derivatives: Where velocity and acceleration come from.
        wrenches: Table or bag of the external loads; a bag motion carries its own.
        topic: JointState topic of a bag.
        with_parts: Also write the torques by cause; not for scenes with loops, where a cause
            alone may be out of reach of the actuators.

    Yields:
        What was done and what was left out, a line each.

    Raises:
        DataError: Something cannot be read, does not fit the scene, or cannot be written.
        SolveError: A mechanism with loops cannot be assembled, or its actuators cannot produce
            the motion.
    """
    is_bag(out)
    refuse_overwriting(out, motion, wrenches)
    if with_parts and scene.has_loops:
        raise DataError(f"{scene.name}: --parts goes with scenes without loops only")
    needed = () if scene.has_loops else scene.couplings.independent
    if scene.robot.floating:
        raise DataError(f"{scene.name}: robot.base: files carry no pose of a floating base")
    inverse = scene.inverse_dynamics()
    yield from (f"warning: {text}" for text in scene.robot.doubts)
    with about("--cutoff"):
        estimator = TorqueEstimator(scene.robot, inverse, Tuning(cutoff=derivatives.causal_cutoff))
    recording = read_motion(motion, estimator.names, topic=topic, required=needed)
    if scene.has_loops:
        recording, remarks = close_loops(scene, motion, recording)
        yield from remarks
    yield from _left_out(motion, recording)
    loads, dropped = read_loads(scene, motion, wrenches)
    cutoff = None
    if derivatives.source == "causal":
        with np.errstate(over="ignore", invalid="ignore"):  # the results are looked at
            samples = observe(estimator, recording.motion, dropped)
        yield causal_line(estimator.differentiator, derivatives.causal_cutoff)
    else:
        with about(motion), np.errstate(over="ignore", invalid="ignore"):
            samples, cutoff, remarks = differentiate(scene, motion, recording.motion, derivatives)
        yield from remarks
    yield from (f"{count} samples left out: {reason}" for reason, count in dropped.items())
    if not samples:
        raise DataError(f"{motion}: no sample can be used")
    remarks = []
    if scene.has_loops:
        stamps = np.array([x.stamp for x in samples], dtype=np.int64)
        wrenches_at = [wrench_at(name, load, stamps) for name, load in loads.items()]
        record, remarks = solve_loops(scene, motion, samples, wrenches_at)
    else:
        record = _solve(inverse, samples, loads, with_parts)
    numbers = np.column_stack([record.effort, record.multiplier, *record.parts.values()])
    if not np.isfinite(numbers).all():
        row = int(np.flatnonzero(~np.isfinite(numbers).all(axis=1))[0])
        raise DataError(f"{motion}: torques at {record.stamps[row] / 1e9} s are not finite")
    with about(motion), np.errstate(over="ignore", invalid="ignore"):
        record, beyond = with_commands(scene, record)
    said = [*_violations(scene, samples), *remarks, *beyond]
    if cutoff is not None:
        said += unexplained(recording.motion, record, cutoff)
    write_torques(out, record)  # nothing fails after it
    yield from said
    yield f"{len(samples)} samples, {derivatives.source} derivatives -> {out}"


def _left_out(motion: Path, recording: Recording) -> Iterator[str]:
    for reason, count in recording.dropped.items():
        yield f"{motion}: {count} messages left out: {reason}"
    if recording.by_log_time:
        yield f"{motion}: stamps are 0, the times of the log are used"


def _solve(
    inverse: InverseDynamics,
    samples: Sequence[Observation],
    loads: dict[str, WrenchSamples],
    with_parts: bool,
) -> TorqueRecord:
    stamps = np.array([x.stamp for x in samples], dtype=np.int64)
    z, v, a = (
        np.array([getattr(x, field) for x in samples])
        for field in ("position", "velocity", "acceleration")
    )
    wrenches = [wrench_at(name, load, stamps) for name, load in loads.items()]
    chunks = [slice(i, i + _CHUNK) for i in range(0, len(stamps), _CHUNK)]
    solved = [
        inverse.batch(z[part], v[part], a[part], [w[part] for w in wrenches])
        for part in progress(chunks, len(chunks), "solving")
    ]
    tau, multipliers = (np.concatenate(rows) for rows in zip(*solved, strict=True))
    parts = {}
    if with_parts:
        rows = zip(z, v, a, *wrenches, strict=True)
        causes = [inverse.parts(*row[:3], row[3:]) for row in progress(rows, len(stamps), "parts")]
        parts = {
            name: np.array([c[i] for c in causes])
            for i, name in enumerate(TorqueComponents._fields)
        }
    couplings = inverse.couplings
    return TorqueRecord(
        stamps, couplings.independent, z, v, a, tau, couplings.dependent, multipliers, parts
    )


def _violations(scene: Scene, samples: Sequence[Observation]) -> Iterator[str]:
    couplings = scene.couplings
    if not couplings.dependent:
        return
    q = np.zeros((scene.robot.model.nq, len(samples)))
    q[couplings.q_index] = np.array([x.position for x in samples]).T
    couplings.expand(q, np.zeros_like(q), np.zeros_like(q))
    for i, name in enumerate(couplings.dependent):
        measured = np.array([x.dependent[i] for x in samples])
        if np.isfinite(measured).all():
            off = np.abs(measured - q[scene.robot.joint(name).q]).max()
            yield f"{name} is off its coupling by at most {off:.3g}"
        else:
            yield f"{name} is reconstructed from {scene.coupling_kinds[name]}"
