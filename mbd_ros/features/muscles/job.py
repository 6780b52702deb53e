"""Forces of muscles in a recorded motion: `mbd-ros muscles`."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.muscles.muscle import Muscle
from mbd_ros.core.state import NANOSECOND, Array, State
from mbd_ros.errors import DataError
from mbd_ros.features.muscles.columns import (
    joined,
    load_columns,
    share_columns,
    together,
    topics,
    trial_columns,
)
from mbd_ros.features.muscles.static_optimization import Shares, StaticOptimization
from mbd_ros.features.muscles.task import MusclesTask, muscles_task
from mbd_ros.features.muscles.trial import Shared, shared_trial
from mbd_ros.files.output_file import check_place, refuse_overwriting
from mbd_ros.files.table import (
    MAIN,
    Column,
    Result,
    Table,
    motion_stamps,
    read_result,
    time_columns,
)
from mbd_ros.jobs.progress import Say, Watch, progress, watching
from mbd_ros.methods.inverse_dynamics.reactions import JointLoads
from mbd_ros.methods.inverse_dynamics.reserves import CoordinateReserve
from mbd_ros.methods.inverse_dynamics.torque_estimator import Observations
from mbd_ros.motion.derivatives import Derivatives
from mbd_ros.motion.recordings import Source, name_of
from mbd_ros.motion.result_metadata import metadata_of
from mbd_ros.motion.samples import Task, loads_of_laboratory, observe_motion
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.describe.scene_summary import coordinate_names

_SHOWN = 5  # frames, coordinates or parts that a line names
_LACKING = 1.0e-6  # of the largest need: what counts as lacking
_CHUNK = 256  # frames between two signs of progress


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
        result = run_muscles(scene, task, asked, options, say or remarks.append)
    if say is None:
        result.metadata["remarks"] = remarks
    return result


def muscles_to(
    scene: Scene, task: Task, asked: MusclesTask, options: Mapping[str, Any], out: Path, say: Say
) -> None:
    """Read a motion, write what muscles do in it.

    Args:
        scene: The scene.
        task: The motion, as inverse dynamics takes it.
        asked: What is asked of the muscles.
        options: The same as it was given, for the metadata.
        out: Its suffix chooses the format.
        say: Is told what was done and left out, a line each.
    """
    files = task.motion, task.wrenches, task.external, asked.emg
    refuse_overwriting(out, *(source for source in files if isinstance(source, Path)))
    check_place(out)
    result = run_muscles(scene, task, asked, options, say)
    result.to(out)
    source = result.metadata["inputs"]["derivatives"]
    say(f"{result[MAIN].rows} frames, {source} derivatives -> {out}")


def run_muscles(
    scene: Scene, task: Task, asked: MusclesTask, options: Mapping[str, Any], say: Say
) -> Result:
    """Do the task of `muscles`."""
    external = loads_of_laboratory(scene, task)
    if external is not None:
        scene = external.scene
        for text in external.remarks:
            say(text)
    for text in scene.robot.doubts:
        say(f"warning: {text}")
    solver = asked.solver(scene)
    observed = observe_motion(scene, task, say, external)
    samples, wrenches = observed.samples, observed.wrenches
    emg = measured_activations(asked.emg, solver.muscles, samples.stamps)
    chunks, motions = [], []
    for shares in _shares(solver, samples, wrenches, emg):
        chunks.append(shares)
        motions.append([values.T for values in solver.motion])
    motion = [np.concatenate(each) for each in zip(*motions, strict=True)]
    lasting: list[Column] = []
    if asked.dynamics is not None:
        shared = _over_time(solver, asked, observed, joined(chunks))
        chunks, lasting = [shared.shares], trial_columns(solver, shared)
        for text in shared.remarks:
            say(text)
    columns = [*share_columns(solver, samples, chunks), *lasting]
    joint_loads = asked.loads(scene)
    if joint_loads is not None:
        found = list(_loads(joint_loads, motion, wrenches, chunks))
        columns += load_columns(joint_loads, asked, solver.muscles, found)
    for text in summary(solver, samples, chunks):
        say(text)
    table = Table([*time_columns(samples.stamps), *columns])
    _check_finite(name_of(task.motion), table)
    done = task._replace(derivatives=observed.derivatives)
    return Result({MAIN: table}, _metadata(scene, done, options, solver))


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


def _over_time(
    solver: StaticOptimization, asked: MusclesTask, observed: Any, static: Shares
) -> Shared:
    """The shares with dynamics of muscles."""
    assert asked.dynamics is not None

    def measured(stamps: NDArray[np.int64]) -> Array | None:
        return measured_activations(asked.emg, solver.muscles, stamps)

    samples, wrenches = observed.samples, observed.wrenches
    return shared_trial(solver, asked.dynamics, samples, wrenches, static, measured)


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


def _metadata(
    scene: Scene, task: Task, options: Mapping[str, Any], solver: StaticOptimization
) -> dict[str, Any]:
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
        **options,
    }
    about = metadata_of("muscles", scene, inputs, topics(solver))
    return {**about, "stamps": "recorded"}


def measured_activations(
    path: Path | None, muscles: Sequence[Muscle], stamps: NDArray[np.int64]
) -> Array | None:
    """Columns `<muscle>.activation`, linear between their rows, NaN for a muscle without one.

    Args:
        path: A table; None where nothing was measured.
        muscles: The muscles.
        stamps: Of the frames [ns], shape (frames,).

    Raises:
        DataError: A file that cannot be read, has none of the muscles, values outside 0 .. 1, or
            does not cover the motion.
    """
    if path is None:
        return None
    table = read_result(path)[MAIN]
    known = [i for i, muscle in enumerate(muscles) if f"{muscle.name}.activation" in table]
    if not known:
        names = ", ".join(f"{muscle.name}.activation" for muscle in muscles)
        raise DataError(f"{path}: no column of a muscle, accepted: {names}")
    at = motion_stamps(table, str(path))
    if not (len(at) and at[0] <= stamps[0] and stamps[-1] <= at[-1]):
        covered = " to ".join(f"{t * NANOSECOND:.6g}" for t in at[[0, -1]]) if len(at) else "no"
        asked = " to ".join(f"{t * NANOSECOND:.6g}" for t in stamps[[0, -1]])
        raise DataError(f"{path}: activations at {covered} s do not cover the motion at {asked} s")
    found = np.full((len(stamps), len(muscles)), np.nan)
    for i in known:
        values = table[f"{muscles[i].name}.activation"]
        outside = np.flatnonzero(~((values >= 0.0) & (values <= 1.0)))
        if len(outside):
            row = int(outside[0])
            raise DataError(
                f"{path}: {muscles[i].name}.activation at {at[row] * NANOSECOND:.6g} s is "
                f"{values[row]:.6g}, accepted: 0 .. 1"
            )
        found[:, i] = np.interp((stamps - at[0]) * NANOSECOND, (at - at[0]) * NANOSECOND, values)
    return found


def summary(
    solver: StaticOptimization, samples: Observations, chunks: Sequence[Shares]
) -> Iterator[str]:
    """Lines for people on how muscles shared the forces of a motion, some frames each."""
    criterion, reserves = solver.wishes.criterion, solver.reserves
    passive = "takes part" if solver.wishes.passive else "is left out"
    yield (
        f"objective: {criterion.kind}, exponent {criterion.exponent:g}, {len(solver.muscles)} "
        f"muscles and {len(reserves)} reserves; passive force of the fibres {passive}"
    )
    null, movable = together(chunks, "null_space"), [m for s in chunks for m in s.movable]
    free = f"{null.min()}" if null.min() == null.max() else f"{null.min()} to {null.max()}"
    yield (
        f"optimum: largest residual {together(chunks, 'residual').max():.1e}; {free} of "
        f"{len(solver.names)} unknowns are free to share"
    )
    several = [i for i, each in enumerate(movable) if each]
    if several:
        names = sorted({solver.names[i] for each in movable for i in each})
        yield f"not unique in {len(several)} of {len(movable)} frames: {_listed(names)}"
    yield from _reserve_lines(solver, chunks)
    yield from _lacking_lines(solver, samples, chunks)


def _listed(texts: Sequence[str]) -> str:
    more = f", .. ({len(texts)})" if len(texts) > _SHOWN else ""
    return ", ".join(texts[:_SHOWN]) + more


def _reserve_lines(solver: StaticOptimization, chunks: Sequence[Shares]) -> Iterator[str]:
    """What each reserve exerts, and its share of what its coordinate needs."""
    forces, needed = together(chunks, "reserve"), together(chunks, "needed")
    at = {int(v): i for i, v in enumerate(solver.known.couplings.v_index)}
    for reserve, force in zip(solver.reserves, forces.T, strict=True):
        line = f"reserve {reserve.name}: at most {np.abs(force).max():.4g} {reserve.unit}"
        if isinstance(reserve, CoordinateReserve):
            whole = _rms(needed[:, at[reserve.at]])
            share = 100.0 * _rms(force) / whole if whole > 0.0 else 0.0
            line += f", {share:.3g} % of what its coordinate needs (rms)"
        yield line


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _lacking_lines(
    solver: StaticOptimization, samples: Observations, chunks: Sequence[Shares]
) -> Iterator[str]:
    """Frames whose forces muscles and reserves cannot produce, and what lacks most."""
    lacks = np.flatnonzero(~together(chunks, "is_feasible"))
    if not len(lacks):
        return
    needed, lacking = together(chunks, "needed"), together(chunks, "lacking")
    names = coordinate_names(solver.robot, solver.known.couplings)
    times = [f"{samples.stamps[i] * NANOSECOND:.6g}" for i in lacks]
    yield (
        f"warning: {len(lacks)} of {len(needed)} frames need more than muscles and reserves can "
        f"give, at {_listed(times)} s"
    )
    most = np.abs(lacking).max(axis=0)
    order = np.argsort(-most)
    scale = _LACKING * np.abs(needed).max(initial=0.0)
    texts = []
    for i in (i for i in order if most[i] > scale):
        row = int(np.abs(lacking[:, i]).argmax())
        time = samples.stamps[row] * NANOSECOND
        texts.append(f"{names[i]} lacks {lacking[row, i]:.4g} at {time:.6g} s")
    yield f"warning: at most: {_listed(texts)}"
