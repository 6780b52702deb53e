"""Forces of muscles in a recorded motion: `mbd-ros muscles`."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.inverse_dynamics.joint_loads import JointLoads
from mbd_ros.core.inverse_dynamics.torque_estimator import Observations
from mbd_ros.core.state import NANOSECOND, Array, State
from mbd_ros.errors import DataError
from mbd_ros.features.muscles.columns import (
    joined,
    load_columns,
    share_columns,
    topics,
    trial_columns,
)
from mbd_ros.features.muscles.measured_activations import measured_activations
from mbd_ros.features.muscles.static_optimization import Shares, StaticOptimization
from mbd_ros.features.muscles.summary import summary
from mbd_ros.features.muscles.task import MusclesTask, muscles_task
from mbd_ros.features.muscles.trial import Shared, shared_trial
from mbd_ros.files.replacing import check_place, refuse_overwriting
from mbd_ros.files.table import MAIN, Column, Result, Table
from mbd_ros.files.times import time_columns
from mbd_ros.jobs.lines import Say
from mbd_ros.jobs.progress import Watch, progress, watching
from mbd_ros.motion.derivatives import Derivatives
from mbd_ros.motion.recordings import Source, name_of
from mbd_ros.motion.result_metadata import metadata_of
from mbd_ros.motion.samples import Task, loads_of_laboratory, observe_motion
from mbd_ros.scene.built_scene import Scene

_CHUNK = 256  # frames between two signs of progress
_NO_OPTIONS: Mapping[str, Any] = {}


class Sharing(NamedTuple):
    """Order of the job.

    Attributes:
        motion: As inverse dynamics takes it.
        asked: What is asked of the muscles.
        options: The same as it was given, for the metadata.
    """

    motion: Task
    asked: MusclesTask
    options: Mapping[str, Any] = _NO_OPTIONS


def muscles(
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
    say: Say | None = None,
    progress: Watch = False,
    **options: Any,
) -> Result:
    """Activations and forces of the muscles of a scene in a motion, and loads of joints.

    Args:
        scene: A scene with muscles, without loops.
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
        say: Is called with each line for people; without it the lines are
            `metadata["remarks"]`.
        progress: True for a line on a terminal, or a function of a label and a share.
        **options: Keys of the section `muscles` of a task file: objective, exponent, passive,
            reserves, residuals, rise, fall, emg, emg_use, emg_weight, reactions, links,
            by_muscle, dynamics, interval, degree, tolerance.

    Returns:
        Table `samples`: `time`, `<joint>.position`, `.velocity`, `.effort` (what the motion
        needs), `.lacking`; `<muscle>.activation`, `.force`, `.max_force`, `.length`, `.speed`;
        `<reserve>.force`; `muscles.objective`, `.residual`, `.null_space`, `.is_unique`,
        `.is_feasible`; perhaps `<link>.load.force_x` and `<link>.<muscle>.force_x`, ..

    Raises:
        DataError: Something cannot be read or does not fit the scene.
        SolveError: A frame that cannot be solved, by its time.
    """
    remarks: list[str] = []
    with watching(progress):
        loads = None if external is None else Path(external)
        chosen = Derivatives(derivatives, cutoff, half_width)
        more: dict[str, Any] = {"time_range": time_range, "wrench_axes": wrench_axes}
        task = Task(motion, chosen, wrenches, topic, external=loads, **more)
        asked = muscles_task(scene, options, "muscles")
        result = run_muscles(scene, Sharing(task, asked, options), say or remarks.append)
    if say is None:
        result.metadata["remarks"] = remarks
    return result


def muscles_to(scene: Scene, order: Sharing, out: Path, say: Say) -> None:
    """Read a motion, write what muscles do in it.

    Args:
        scene: The scene.
        order: What is asked for.
        out: Its suffix chooses the format.
        say: Is told what was done and left out, a line each.

    Raises:
        MbdError: As `muscles`, or a place that cannot be written to.
    """
    task = order.motion
    files = task.motion, task.wrenches, task.external, order.asked.emg
    refuse_overwriting(out, *(source for source in files if isinstance(source, Path)))
    check_place(out)
    result = run_muscles(scene, order, say)
    result.to(out)
    source = result.metadata["inputs"]["derivatives"]
    say(f"{result[MAIN].rows} frames, {source} derivatives -> {out}")


def run_muscles(scene: Scene, order: Sharing, say: Say) -> Result:
    """See `muscles`."""
    task, external = order.motion, loads_of_laboratory(scene, order.motion)
    if external is not None:
        scene = external.scene
        for text in external.remarks:
            say(text)
    for text in scene.robot.doubts:
        say(f"warning: {text}")
    solver = order.asked.solver(scene)
    observed = observe_motion(scene, task, say, external)
    samples, wrenches = observed.samples, observed.wrenches
    emg = measured_activations(order.asked.emg, solver.muscles, samples.stamps)
    chunks, motions = [], []
    for shares in _shares(solver, samples, wrenches, emg):
        chunks.append(shares)
        motions.append([values.T for values in solver.motion])
    motion = [np.concatenate(each) for each in zip(*motions, strict=True)]
    lasting: list[Column] = []
    if order.asked.dynamics is not None:
        shared = _over_time(solver, order.asked, observed, joined(chunks))
        chunks, lasting = [shared.shares], trial_columns(solver, shared)
        for text in shared.remarks:
            say(text)
    columns = [*share_columns(solver, samples, chunks), *lasting]
    joint_loads = order.asked.loads(scene)
    if joint_loads is not None:
        found = list(_loads(joint_loads, motion, wrenches, chunks))
        columns += load_columns(joint_loads, order.asked, solver.muscles, found)
    for text in summary(solver, samples, chunks):
        say(text)
    table = Table([*time_columns(samples.stamps), *columns])
    _check_finite(name_of(task.motion), table)
    done = order._replace(motion=task._replace(derivatives=observed.derivatives))
    return Result({MAIN: table}, _about(scene, done, solver))


def _over_time(
    solver: StaticOptimization, asked: MusclesTask, observed: Any, static: Shares
) -> Shared:
    """With dynamics of muscles."""
    assert asked.dynamics is not None

    def measured(stamps: NDArray[np.int64]) -> Array | None:
        return measured_activations(asked.emg, solver.muscles, stamps)

    given = observed.samples, observed.wrenches, static, measured
    return shared_trial(solver, asked.dynamics, *given)


def _shares(
    solver: StaticOptimization, samples: Observations, wrenches: list[Array], emg: Array | None
) -> Iterator[Shares]:
    """Shares of frames, some at a time."""
    count = len(samples.stamps)
    times = (samples.stamps - samples.stamps[0]) * NANOSECOND
    begin = float(samples.stamps[0] * NANOSECOND)
    starts = range(0, count, _CHUNK)
    for i in progress(starts, len(starts), "sharing"):
        some = slice(i, i + _CHUNK)
        motion = (values[some] for values in samples[1:4])
        loads = [wrench[some] for wrench in wrenches]
        yield solver.solve(begin + times[some], *motion, loads, None if emg is None else emg[some])


def _loads(
    joint_loads: JointLoads, motion: list[Array], wrenches: list[Array], chunks: list[Shares]
) -> Iterator[tuple[Array, Array]]:
    """Loads of each frame, of all and by muscle."""
    force = np.concatenate([shares.force for shares in chunks])
    reserve = np.concatenate([shares.reserve for shares in chunks])
    rows = zip(*motion, force, reserve, *wrenches, strict=True)
    for q_now, v_now, a_now, tension, help_, *loads in progress(rows, len(force), "joint loads"):
        yield joint_loads.solve(State(0.0, q_now, v_now), a_now, tension, help_, loads)


def _check_finite(where: str, table: Table) -> None:
    for name, values in table.items():
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values))[0])
            raise DataError(f"{where}: {name} at {table['time'][row]:.9g} s is not finite")


def _about(scene: Scene, order: Sharing, solver: StaticOptimization) -> dict[str, Any]:
    task = order.motion
    source, cutoff, half_width = task.derivatives
    inputs: dict[str, Any] = {
        "motion": task.motion,
        "wrenches": task.wrenches,
        "external": task.external,
        "time_range": task.time_range and list(task.time_range),
        "wrench_axes": task.wrench_axes,
        "derivatives": source,
        "cutoff": cutoff,
        "half_width": half_width,
        **order.options,
    }
    about = metadata_of("muscles", scene, inputs, topics(solver))
    return {**about, "stamps": "recorded"}
