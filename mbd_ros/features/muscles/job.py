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

OPTIMUM = "muscles"  # stands before the names of what is said of a whole frame
_AXES = [(kind, axis) for kind in ("force", "moment") for axis in "xyz"]
_UNITS = {"force": "N", "moment": "N·m"}
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
    for text in scene.robot.inertia_warnings:
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


def measured_activations(
    path: Path | None, muscles: Sequence[Muscle], stamps: NDArray[np.int64]
) -> Array | None:
    """Columns `<muscle>.activation`, linear between their rows, NaN for a muscle without one.

    Args:
        path: A table; None where nothing was measured.
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


def summary(
    solver: StaticOptimization, samples: Observations, chunks: Sequence[Shares]
) -> Iterator[str]:
    """Lines for people on how muscles shared the forces of a motion, some frames each."""
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
    """A field of all frames."""
    return np.concatenate([getattr(shares, field) for shares in chunks])


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


def muscles_batch(batch: Batch, task_file: Path | None, say: Say) -> None:
    """Do all motions.

    Args:
        batch: The motions; its options are keys of the section `muscles` of a task file.
        task_file: Its section `muscles` says what the options leave out.
        say: Is told what was done.
    """
    options = _batch_options(batch.options, task_file, load_scene(batch.scene))
    do_batch(batch._replace(options=options), _muscles_of_batch, muscles_in_worker, say)


def _batch_options(
    given: Mapping[str, Any], task_file: Path | None, scene: Scene
) -> dict[str, Any]:
    """Options of the command, and else of the task file; checked."""
    options: dict[str, Any] = {}
    if task_file is not None:
        from mbd_ros.scene.task_reader import read_task

        entry = read_task(task_file, scene).entries.get("muscles")
        if entry is None:
            raise DataError(f"--task {task_file}: has no section muscles")
        options = dict(entry)
        for key in ("emg", "reserves"):  # relative to the task file
            if isinstance(options.get(key), str):
                options[key] = str((task_file.parent / options[key]).absolute())
    options |= given
    muscles_task(scene, options, "muscles").solver(scene)
    return options


def _muscles_of_batch(batch: Batch, say: Say) -> None:
    scene = load_scene(batch.scene)
    asked = muscles_task(scene, batch.options, "muscles")
    muscles_to(scene, task_of(batch), asked, batch.options, batch.out, say)


def muscles_in_worker(argument: Mapping[str, Any]) -> Outcome:
    """One motion, in a worker."""
    return do_one(argument, _muscles_of_batch)


def share_columns(
    solver: StaticOptimization, samples: Observations, chunks: Sequence[Shares]
) -> list[Column]:
    """Motion, needed efforts, muscles and reserves.

    Args:
        chunks: Its shares, some frames each.
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
    """Excitations, and lengths of fibres beside elastic tendons."""
    pairs = zip(solver.muscles, shared.excitation.T, strict=True)
    columns = [Column(f"{part.name}.excitation", values) for part, values in pairs]
    lengths = shared.fiber_length.items()
    return [*columns, *(Column(f"{name}.fiber_length", v, "m") for name, v in lengths)]


def load_columns(
    loads: JointLoads,
    asked: MusclesTask,
    muscles: Sequence[Muscle],
    found: Sequence[tuple[Array, Array]],
) -> list[Column]:
    """Loads of joints, a row a frame.

    Args:
        loads: What found them.
        asked: Whose parts are wanted.
        muscles: In the order of the parts.
        found: Of each frame the loads of all, and by muscle.
    """
    total = np.array([each for each, _ in found])
    columns: list[Column] = []
    for row, one in enumerate(loads.joint_links):
        frame = {"child": one.link, "parent": one.parent_link, "ground": "world"}[loads.side]
        columns += _load(f"{one.link}.load", total[:, row], frame)
        for i, muscle in enumerate(muscles if asked.by_muscle else ()):
            values = np.array([parts[i, row] for _, parts in found])
            columns += _load(f"{one.link}.{muscle.name}", values, frame)
    return columns


def _load(name: str, values: Array, frame: str) -> list[Column]:
    pairs = zip(_AXES, values.T, strict=True)
    return [Column(f"{name}.{kind}_{a}", v, _UNITS[kind], frame) for (kind, a), v in pairs]


def topics(solver: StaticOptimization) -> dict[str, Any]:
    """Topics of a bag, see `files.bags.bag_writer`: the same as those of the node."""
    names = [muscle.name for muscle in solver.muscles]
    fields = {"position": "length", "velocity": "speed", "effort": "force"}
    of_muscles = {f: {n: f"{n}.{quantity}" for n in names} for f, quantity in fields.items()}
    found: dict[str, Any] = {
        "/joint_states": {"position": "position", "velocity": "velocity", "effort": "effort"},
        "/muscle_forces": of_muscles,
        "/activations": {"data": [f"{name}.activation" for name in names]},
    }
    if solver.reserves:
        reserves = {part.name: f"{part.name}.force" for part in solver.reserves}
        found["/reserve_forces"] = {"effort": reserves}
    return found


def joined(chunks: Sequence[Shares]) -> Shares:
    """Shares of all frames."""
    frames = [shares.frames for shares in chunks]
    whole = Frames(*(np.concatenate(each) for each in zip(*frames, strict=True)))
    names = [field.name for field in fields(Shares) if field.name not in ("frames", "movable")]
    movable = tuple(one for shares in chunks for one in shares.movable)
    arrays = {name: together(chunks, name) for name in names}
    return Shares(frames=whole, movable=movable, **arrays)
