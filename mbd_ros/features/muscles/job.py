"""Forces of muscles in recorded motions: `mbd-ros muscles`."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.model.couplings import IndependentCoordinates
from mbd_ros.core.muscles.muscle import Muscle
from mbd_ros.core.state import NANOSECOND, Array, State
from mbd_ros.errors import DataError
from mbd_ros.features.muscles.muscle_frames import Frames
from mbd_ros.features.muscles.static_optimization import Shares, StaticOptimization
from mbd_ros.features.muscles.task import MusclesTask, muscles_task
from mbd_ros.features.muscles.trial import Shared, shared_trial
from mbd_ros.files.table import (
    MAIN,
    Column,
    Result,
    Table,
    motion_stamps,
    read_result,
    time_columns,
)
from mbd_ros.files.text_file import check_place, refuse_overwriting
from mbd_ros.jobs.progress import Say, Watch, progress, watching
from mbd_ros.methods.inverse_dynamics.reactions import JointLoads
from mbd_ros.methods.inverse_dynamics.reserves import CoordinateReserve
from mbd_ros.methods.inverse_dynamics.torque_estimator import Observations
from mbd_ros.motion.batch import Batch, Outcome, do_batch, do_one, task_of
from mbd_ros.motion.columns import body_columns, joint_columns
from mbd_ros.motion.derivatives import Derivatives
from mbd_ros.motion.recordings import Source, metadata_of, name_of
from mbd_ros.motion.samples import Task, loads_of_laboratory, observe_motion
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.describe.scene_summary import coordinate_names
from mbd_ros.scene.reader import load_scene

OPTIMUM = "muscles"  # prefix of columns that describe a frame as a whole
_AXES = [(kind, axis) for kind in ("force", "moment") for axis in "xyz"]
_UNITS = {"force": "N", "moment": "N·m"}
_MOST_NAMED = 5  # frames, coordinates or parts that a line names
_RESIDUAL = 1.0e-6  # of the largest force: a residual force that is reported
_CHUNK = 256  # frames between two updates of the progress


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
    """Compute activations and forces of the muscles of a scene in a motion, and joint loads.

    Args:
        scene: A scene with muscles, without loops.
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
        say: Called with each line for people; without it the lines go to `metadata["remarks"]`.
        progress: True for a line on a terminal, or a function of a label and a share.
        **options: Keys of the section `muscles` of a task file, which are the keyword arguments
            of `mbd_ros.features.muscles.task.task_of_keys`.

    Returns:
        Table `samples`: `time`, `<joint>.position`, `.velocity`, `.effort` (the force that the
        motion needs), `.lacking` (its part that nothing can exert); `<muscle>.activation`,
        `.force`, `.max_force`, `.length`, `.speed`; `<reserve>.force`; `muscles.objective`,
        `.residual`, `.null_space`, `.is_unique`, `.is_feasible`. With reactions also
        `<link>.load.force_x` and so on, by muscle `<link>.<muscle>.force_x`.

    Raises:
        DataError: A file cannot be read or does not fit the scene.
        SolveError: A frame cannot be solved; the message names its time.
    """
    remarks: list[str] = []
    with watching(progress):
        loads = None if external is None else Path(external)
        chosen = Derivatives(derivatives, cutoff, half_width)
        more: dict[str, Any] = {"time_range": time_range, "wrench_axes": wrench_axes}
        task = Task(motion, chosen, wrenches, topic, external=loads, **more)
        order = muscles_task(scene, options, "muscles")
        result = run_muscles(scene, task, order, options, say or remarks.append)
    if say is None:
        result.metadata["remarks"] = remarks
    return result


def muscles_to(
    scene: Scene, task: Task, order: MusclesTask, options: Mapping[str, Any], out: Path, say: Say
) -> None:
    """Read a motion, and write the forces of muscles in it.

    Args:
        task: The motion, as inverse dynamics takes it.
        order: How muscles share the forces, and which loads are computed.
        options: The keys that `order` was built from, for the metadata.
        out: Path whose suffix chooses the format.
        say: Called with each line for people.
    """
    files = task.motion, task.wrenches, task.external, order.emg
    refuse_overwriting(out, *(source for source in files if isinstance(source, Path)))
    check_place(out)
    result = run_muscles(scene, task, order, options, say)
    result.to(out)
    source = result.metadata["inputs"]["derivatives"]
    say(f"{result[MAIN].rows} frames, {source} derivatives -> {out}")


def run_muscles(
    scene: Scene, task: Task, order: MusclesTask, options: Mapping[str, Any], say: Say
) -> Result:
    """Return the result of `muscles` for a task."""
    external = loads_of_laboratory(scene, task)
    if external is not None:
        scene = external.scene
        for text in external.remarks:
            say(text)
    for text in scene.robot.inertia_warnings:
        say(f"warning: {text}")
    solver = order.solver(scene)
    observed = observe_motion(scene, task, say, external)
    samples, wrenches = observed.samples, observed.wrenches
    emg = measured_activations(order.emg, solver.muscles, samples.stamps)
    chunks, motions = [], []
    for shares in _shares(solver, samples, wrenches, emg):
        chunks.append(shares)
        motions.append([values.T for values in solver.motion])
    motion = [np.concatenate(each) for each in zip(*motions, strict=True)]
    trial_values: list[Column] = []
    if order.dynamics is not None:
        shared = _over_time(solver, order, observed, joined(chunks))
        chunks, trial_values = [shared.shares], trial_columns(solver, shared)
        for text in shared.remarks:
            say(text)
    columns = [*share_columns(solver, samples, chunks), *trial_values]
    joint_loads = order.loads(scene)
    if joint_loads is not None:
        frame_loads = list(_loads(joint_loads, motion, wrenches, chunks))
        columns += load_columns(joint_loads, order, solver.muscles, frame_loads)
    for text in summary(solver, samples, chunks):
        say(text)
    table = Table([*time_columns(samples.stamps), *columns])
    _check_finite(name_of(task.motion), table)
    done = task._replace(derivatives=observed.derivatives)
    return Result({MAIN: table}, _metadata(scene, done, options, solver))


def measured_activations(
    path: Path | None, muscles: Sequence[Muscle], stamps: NDArray[np.int64]
) -> Array | None:
    """Interpolate measured activations at the frames; NaN for a muscle without a column.

    Args:
        path: Table with columns `<muscle>.activation`; None without measurements.
        stamps: Times of the frames [ns], shape (frames,).

    Raises:
        DataError: The file cannot be read, has a column of no muscle, values outside 0 .. 1, or
            does not cover the motion.
    """
    if path is None:
        return None
    table = read_result(path)[MAIN]
    known = [i for i, muscle in enumerate(muscles) if f"{muscle.name}.activation" in table]
    if not known:
        names = ", ".join(f"{muscle.name}.activation" for muscle in muscles)
        raise DataError(f"{path}: has no column of a muscle, accepted: {names}")
    at = motion_stamps(table, str(path))
    if not (len(at) and at[0] <= stamps[0] and stamps[-1] <= at[-1]):
        covered = " to ".join(f"{t * NANOSECOND:.6g}" for t in at[[0, -1]]) if len(at) else "no"
        needed = " to ".join(f"{t * NANOSECOND:.6g}" for t in stamps[[0, -1]])
        raise DataError(
            f"{path}: activations at {covered} s do not cover the motion at {needed} s"
        )
    activations = np.full((len(stamps), len(muscles)), np.nan)
    for i in known:
        values = table[f"{muscles[i].name}.activation"]
        outside = np.flatnonzero(~((values >= 0.0) & (values <= 1.0)))
        if len(outside):
            row = int(outside[0])
            raise DataError(
                f"{path}: {muscles[i].name}.activation at {at[row] * NANOSECOND:.6g} s is "
                f"{values[row]:.6g}, accepted: 0 .. 1"
            )
        activations[:, i] = np.interp(
            (stamps - at[0]) * NANOSECOND, (at - at[0]) * NANOSECOND, values
        )
    return activations


def _shares(
    solver: StaticOptimization, samples: Observations, wrenches: list[Array], emg: Array | None
) -> Iterator[Shares]:
    """Yield the shares of the frames, `_CHUNK` frames at a time."""
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
    solver: StaticOptimization, order: MusclesTask, observed: Any, static: Shares
) -> Shared:
    """Return the shares with dynamics of the muscles."""
    assert order.dynamics is not None

    def measured(stamps: NDArray[np.int64]) -> Array | None:
        return measured_activations(order.emg, solver.muscles, stamps)

    samples, wrenches = observed.samples, observed.wrenches
    return shared_trial(solver, order.dynamics, samples, wrenches, static, measured)


def _loads(
    joint_loads: JointLoads, motion: list[Array], wrenches: list[Array], chunks: list[Shares]
) -> Iterator[tuple[Array, Array]]:
    """Yield the joint loads of each frame: in total and by muscle."""
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


def summary(
    solver: StaticOptimization, samples: Observations, chunks: Sequence[Shares]
) -> Iterator[str]:
    """Yield lines for people about how the muscles share the forces of a motion."""
    criterion, reserves = solver.sharing.criterion, solver.reserves
    passive = "takes part" if solver.sharing.passive else "is left out"
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


def together(chunks: Sequence[Shares], field: str) -> Array:
    """Return a field of the shares of all frames."""
    return np.concatenate([getattr(shares, field) for shares in chunks])


def _listed(texts: Sequence[str]) -> str:
    more = f", .. ({len(texts)})" if len(texts) > _MOST_NAMED else ""
    return ", ".join(texts[:_MOST_NAMED]) + more


def _reserve_lines(solver: StaticOptimization, chunks: Sequence[Shares]) -> Iterator[str]:
    """Yield the largest force of each reserve, and its share of the force of its coordinate."""
    forces, needed = together(chunks, "reserve"), together(chunks, "needed")
    at = {int(v): i for i, v in enumerate(solver.known.couplings.v_index)}
    for reserve, force in zip(solver.reserves, forces.T, strict=True):
        line = f"reserve {reserve.name}: at most {np.abs(force).max():.4g} {reserve.unit}"
        if isinstance(reserve, CoordinateReserve):
            need = _rms(needed[:, at[reserve.at]])
            share = 100.0 * _rms(force) / need if need > 0.0 else 0.0
            line += f", {share:.3g} % of what its coordinate needs (rms)"
        yield line


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _lacking_lines(
    solver: StaticOptimization, samples: Observations, chunks: Sequence[Shares]
) -> Iterator[str]:
    """Yield warnings about frames that muscles and reserves cannot produce."""
    short_frames = np.flatnonzero(~together(chunks, "is_feasible"))
    if not len(short_frames):
        return
    needed, lacking = together(chunks, "needed"), together(chunks, "lacking")
    names = coordinate_names(solver.robot, solver.known.couplings)
    times = [f"{samples.stamps[i] * NANOSECOND:.6g}" for i in short_frames]
    yield (
        f"warning: {len(short_frames)} of {len(needed)} frames need more than muscles "
        f"and reserves can give, at {_listed(times)} s"
    )
    most = np.abs(lacking).max(axis=0)
    order = np.argsort(-most)
    scale = _RESIDUAL * np.abs(needed).max(initial=0.0)
    texts = []
    for i in (i for i in order if most[i] > scale):
        row = int(np.abs(lacking[:, i]).argmax())
        time = samples.stamps[row] * NANOSECOND
        texts.append(f"{names[i]} lacks {lacking[row, i]:.4g} at {time:.6g} s")
    yield f"warning: at most: {_listed(texts)}"


def muscles_batch(batch: Batch, task_file: Path | None, say: Say) -> None:
    """Solve all motions of a batch.

    Args:
        batch: The motions; its options are keys of the section `muscles` of a task file.
        task_file: Task file with the keys that the options leave out.
        say: Called with each line for people.
    """
    options = _batch_options(batch.options, task_file, load_scene(batch.scene))
    do_batch(batch._replace(options=options), _muscles_of_batch, muscles_in_worker, say)


def _batch_options(
    options_of_command: Mapping[str, Any], task_file: Path | None, scene: Scene
) -> dict[str, Any]:
    """Return the keys of the task file, replaced by those of the command; all are checked."""
    options: dict[str, Any] = {}
    if task_file is not None:
        from mbd_ros.scene.task_reader import read_task

        entry = read_task(task_file, scene).entries.get("muscles")
        if entry is None:
            raise DataError(f"--task {task_file}: has no section 'muscles'")
        options = dict(entry)
        for key in ("emg", "reserves"):  # relative to the task file
            if isinstance(options.get(key), str):
                options[key] = str((task_file.parent / options[key]).absolute())
    options |= options_of_command
    muscles_task(scene, options, "muscles").solver(scene)
    return options


def _muscles_of_batch(batch: Batch, say: Say) -> None:
    scene = load_scene(batch.scene)
    order = muscles_task(scene, batch.options, "muscles")
    muscles_to(scene, task_of(batch), order, batch.options, batch.out, say)


def muscles_in_worker(argument: Mapping[str, Any]) -> Outcome:
    """Solve one motion in a worker process."""
    return do_one(argument, _muscles_of_batch)


def share_columns(
    solver: StaticOptimization, samples: Observations, chunks: Sequence[Shares]
) -> list[Column]:
    """Return the columns of the motion, of muscles and of reserves.

    Args:
        chunks: The shares, some frames each.
    """
    muscles, reserves = solver.muscles, solver.reserves
    columns = _motion(solver, samples, chunks)
    frames = [shares.frames for shares in chunks]
    of_muscles = {
        ("activation", ""): together(chunks, "activation"),
        ("force", "N"): together(chunks, "force"),
        ("max_force", "N"): np.concatenate([each.active for each in frames]),
        ("length", "m"): np.concatenate([each.length for each in frames]),
        ("speed", "m/s"): np.concatenate([each.speed for each in frames]),
    }
    for (quantity, unit), values in of_muscles.items():
        pairs = zip(muscles, values.T, strict=True)
        columns += [Column(f"{part.name}.{quantity}", column, unit) for part, column in pairs]
    forces = zip(reserves, together(chunks, "reserve").T, strict=True)
    columns += [Column(f"{part.name}.force", column, part.unit) for part, column in forces]
    unique = [not movable for shares in chunks for movable in shares.movable]
    of_frames = {
        "objective": together(chunks, "objective"),
        "residual": together(chunks, "residual"),
        "null_space": together(chunks, "null_space").astype(np.float64),
        "is_unique": np.array(unique, dtype=np.float64),
        "is_feasible": together(chunks, "is_feasible").astype(np.float64),
    }
    return [*columns, *(Column(f"{OPTIMUM}.{name}", v) for name, v in of_frames.items())]


def _motion(
    solver: StaticOptimization, samples: Observations, chunks: Sequence[Shares]
) -> list[Column]:
    robot, couplings = solver.robot, solver.known.couplings
    at = IndependentCoordinates(robot, couplings)
    free = [robot.joint(name) for name in couplings.independent]
    z, v, a = samples[1:4]
    columns = joint_columns(free, "position", z[:, at.joint_y])
    columns += joint_columns(free, "velocity", v[:, at.joint_w])
    columns += joint_columns(free, "effort", together(chunks, "needed")[:, at.joint_w])
    columns += joint_columns(free, "lacking", together(chunks, "lacking")[:, at.joint_w])
    bodies = [(z[:, y], v[:, w], a[:, w]) for y, w in zip(at.body_y, at.body_w, strict=True)]
    return [*columns, *body_columns(robot, bodies)]


def trial_columns(solver: StaticOptimization, shared: Shared) -> list[Column]:
    """Return the columns of excitations, and of fibre lengths beside elastic tendons."""
    pairs = zip(solver.muscles, shared.excitation.T, strict=True)
    columns = [Column(f"{part.name}.excitation", values) for part, values in pairs]
    lengths = shared.fiber_length.items()
    return [*columns, *(Column(f"{name}.fiber_length", v, "m") for name, v in lengths)]


def load_columns(
    loads: JointLoads,
    order: MusclesTask,
    muscles: Sequence[Muscle],
    frame_loads: Sequence[tuple[Array, Array]],
) -> list[Column]:
    """Return the columns of joint loads.

    Args:
        loads: Solver of the joint loads.
        order: Whether the loads of each muscle are columns, too.
        muscles: Muscles in the order of their loads.
        frame_loads: Loads of each frame, in total and by muscle.
    """
    total = np.array([each for each, _ in frame_loads])
    columns: list[Column] = []
    for row, joint in enumerate(loads.joint_links):
        frame = {"child": joint.link, "parent": joint.parent_link, "ground": "world"}[loads.side]
        columns += _load(f"{joint.link}.load", total[:, row], frame)
        for i, muscle in enumerate(muscles if order.by_muscle else ()):
            values = np.array([parts[i, row] for _, parts in frame_loads])
            columns += _load(f"{joint.link}.{muscle.name}", values, frame)
    return columns


def _load(name: str, values: Array, frame: str) -> list[Column]:
    pairs = zip(_AXES, values.T, strict=True)
    return [Column(f"{name}.{kind}_{a}", v, _UNITS[kind], frame) for (kind, a), v in pairs]


def topics(solver: StaticOptimization) -> dict[str, Any]:
    """Return the topics of a bag, which are those of the node `muscle_forces`."""
    names = [muscle.name for muscle in solver.muscles]
    fields = {"position": "length", "velocity": "speed", "effort": "force"}
    of_muscles = {f: {n: f"{n}.{quantity}" for n in names} for f, quantity in fields.items()}
    topics_of_result: dict[str, Any] = {
        "/joint_states": {"position": "position", "velocity": "velocity", "effort": "effort"},
        "/muscle_forces": of_muscles,
        "/activations": {"data": [f"{name}.activation" for name in names]},
    }
    if solver.reserves:
        reserves = {part.name: f"{part.name}.force" for part in solver.reserves}
        topics_of_result["/reserve_forces"] = {"effort": reserves}
    return topics_of_result


def joined(chunks: Sequence[Shares]) -> Shares:
    """Join the shares of all frames."""
    frames = [shares.frames for shares in chunks]
    all_frames = Frames(*(np.concatenate(each) for each in zip(*frames, strict=True)))
    names = [field.name for field in fields(Shares) if field.name not in ("frames", "movable")]
    movable = tuple(movable_names for shares in chunks for movable_names in shares.movable)
    arrays = {name: together(chunks, name) for name in names}
    return Shares(frames=all_frames, movable=movable, **arrays)
