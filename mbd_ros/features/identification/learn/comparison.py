"""Comparison of five methods to predict torques over growing training times.

The command is `mbd-ros learn --compare`.

    physics          the scene as given
    identified       inertias and friction identified from the same seconds
    black box        a network of positions, velocities and accelerations, no physics
    residual         the identified scene and a network for its residual
    physics-informed the black box, whose loss also contains the identified equations of motion at
                     states within the limits of all joints

All methods see the same seconds and predict the efforts, as measured, of the end of the recording.
"""

from collections.abc import Callable, Iterator, Sequence
from io import BytesIO
from pathlib import Path

import numpy as np

from mbd_ros.core.model.couplings import IndependentCoordinates
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, MbdError
from mbd_ros.features.identification.job import run_identify
from mbd_ros.features.identification.learn.fitting import (
    FEWEST,
    INFORMED,
    MOST,
    Recordings,
    first_seconds,
    fit,
    relative_error,
    thin_out,
)
from mbd_ros.features.identification.learn.job import prediction, refuse_sources, without_model
from mbd_ros.features.identification.learn.task import Task
from mbd_ros.features.identification.learn.training_samples import (
    Samples,
    Scales,
    blocks_of,
    trusted_share,
)
from mbd_ros.features.identification.outcome import csv_bytes
from mbd_ros.features.identification.regressor import limits_of
from mbd_ros.features.identification.samples import Recorded, split_recording
from mbd_ros.features.identification.task import Task as IdentifyTask
from mbd_ros.files.output_folder import write_files
from mbd_ros.files.table import Column, Table
from mbd_ros.jobs.progress import Say
from mbd_ros.scene.built_scene import Scene

METHODS = ("physics", "identified", "black box", "residual", "physics-informed")
_MARKS = ("s", "D", "o", "^", "v")  # of the methods in the figure
SECONDS = (0.5, 1.0, 2.0, 3.0, 5.0, 10.0)
_LEAST_SHARE = 0.1  # of a recording: identification accepts no less
_RIDGE = 1.0e-2  # of the size of a column: friction from few samples stays small
_BLOCKS = 5  # of time, each left out once
_WIDE = 1.5  # times the RMS velocity and acceleration: size of collocation states
_MORE = 2  # times the steps of a residual: a black box has more to learn
TorqueModel = Callable[[Samples], Array]
StateGenerator = Callable[[Scales, np.random.Generator], tuple[Samples, Array]]


def compare_to(scene: Scene, task: Task, folder: Path, say: Say, *, seeds: int = 3) -> None:
    """Compare, and write `comparison.csv`, `runs.csv` and `comparison.png`; all, or none.

    Args:
        scene: The scene.
        task: Options of learning.
        folder: Folder of the files.
        say: Function that is called with each line for people.
        seeds: Number of seeds that are compared.
    """
    if not 1 <= seeds <= 100:
        raise DataError(f"--seeds {seeds}: accepted are 1 .. 100")
    refuse_sources(folder, task, None)
    runs, summary = compare(scene, task, range(task.seed, task.seed + seeds), say)
    files = {
        "comparison.csv": csv_bytes(summary),
        "runs.csv": csv_bytes(runs),
        "comparison.png": picture(summary),
    }
    write_files(folder, files)
    say(f"{folder}: {', '.join(files)}")


def picture(summary: Table) -> bytes:
    """Return a figure of errors over training times, with bars for the seeds."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for method, mark in zip(METHODS, _MARKS, strict=True):
        rows = summary["way"] == method
        mean, least, most = (summary[name][rows] for name in ("mean", "least", "largest"))
        bars = (mean - least, most - mean)
        axes.errorbar(summary["seconds"][rows], mean, bars, marker=mark, capsize=3, label=method)
    axes.set(xscale="log", yscale="log", xlabel="training time [s]")
    axes.set_ylabel("error in the test [% of the torque]")
    axes.grid(visible=True, which="both", alpha=0.3)
    axes.legend()
    target = BytesIO()
    figure.savefig(target, format="png", dpi=110)
    return target.getvalue()


def compare(scene: Scene, task: Task, seeds: Sequence[int], say: Say) -> tuple[Table, Table]:
    """Train all methods with growing training times, and test them.

    Args:
        task: Options of learning, with one recording.
        seeds: Seeds of the networks.
        say: Receives a line for each training time.

    Returns:
        Errors with one run per row; and mean, least and largest error over the seeds, with one
        method and one training time per row.

    Raises:
        DataError: There are several recordings, they cannot be read, or no time remains for the
            test.
    """
    task.check()
    if len(task.motions) != 1 or task.learned >= 1.0:
        raise DataError("--compare: give exactly one recording, and --learned less than 1")
    scene = without_model(scene)
    recordings = Recordings(scene, task, lambda line: None)
    first, second = split_recording(recordings.every[0], task.learned)
    assert second is not None
    longest = float(first.times[-1])
    enough = [s for s in SECONDS if s < 0.9 * longest and (first.times <= s).sum() >= FEWEST]
    amounts = [*enough, longest]
    rows = []
    for seconds in amounts:
        results = _errors_of_methods(
            scene, task, recordings, (first_seconds(first, seconds), second), seeds
        )
        new_rows = [(seconds, method, seed, error) for method, seed, error in results]
        rows += new_rows
        means = {m: np.mean([e for _, w, _, e in new_rows if w == m]) for m in METHODS}
        texts = (f"{method} {100 * mean:.2f} %" for method, mean in means.items())
        say(f"{seconds:.3g} s: {', '.join(texts)}")
    return _table(rows), _summary(rows, amounts)


def _errors_of_methods(
    scene: Scene,
    task: Task,
    recordings: Recordings,
    parts: tuple[Recorded, Recorded],
    seeds: Sequence[int],
) -> Iterator[tuple[str, int, float]]:
    """Yield method, seed and error for one training time."""
    training = parts[0]
    identified = _identify_first_seconds(scene, task, recordings, float(training.times[-1]))
    given, plain = (recordings.samples(scene, [part]) for part in parts)
    if identified is None:
        train, test, add = given, plain, _friction_model(given)
    else:
        train, test = (recordings.samples(identified, [part]) for part in parts)
        add = _no_friction
    train = train._replace(physics=train.physics + add(train))
    test = test._replace(physics=test.physics + add(test))
    for seed in seeds:
        yield "physics", seed, relative_error(plain.physics, plain.measured)
        yield "identified", seed, relative_error(test.physics, test.measured)
        seeded = task._replace(seed=seed)
        yield "black box", seed, _black_box(seeded, train, test, None)
        model = fit(scene, seeded, recordings.joints, train, lambda share: None)
        yield "residual", seed, relative_error(prediction(scene, model, test), test.measured)
        states = _dynamics_states(scene if identified is None else identified, recordings, add)
        yield "physics-informed", seed, _black_box(seeded, train, test, states)


def _identify_first_seconds(
    scene: Scene, task: Task, recordings: Recordings, seconds: float
) -> Scene | None:
    """Return the scene identified from the first seconds; None where they are too few."""
    duration = float(recordings.every[0].times[-1])
    if seconds / duration < _LEAST_SHARE:
        return None
    identify_task = IdentifyTask(
        task.motions,
        task.wrenches,
        task.topic,
        task.derivatives,
        recordings.band,
        learned=seconds / duration,
        partial=True,
    )
    try:
        return run_identify(scene, identify_task, lambda line: None).scene
    except MbdError:
        return None


def _friction_model(samples: Samples) -> TorqueModel:
    """Return dry and viscous friction of each joint, for too few seconds to identify masses.

    The torque of each joint is scaled by the factor that holds in blocks that were left out.
    """
    residual = samples.effort - samples.physics
    scales = Scales.of(samples, residual)
    curves = np.stack([np.tanh(samples.v / scales.slow), samples.v / scales.v], axis=-1)
    block = blocks_of(samples.count, _BLOCKS)

    def solve(rows: Array) -> Array:
        A, b = curves[rows], residual[rows]
        square = np.einsum("nmi,nmj->mij", A, A) + _RIDGE * len(b) * np.eye(2)
        return np.linalg.solve(square, np.einsum("nmi,nm->mi", A, b)[..., None])[..., 0]

    unseen = np.zeros_like(residual)
    for i in range(_BLOCKS):
        unseen[block == i] = np.einsum("nmi,mi->nm", curves[block == i], solve(block != i))
    factors = trusted_share(unseen, residual, _BLOCKS, together=False)[:, None] * solve(block >= 0)

    def torque(samples: Samples) -> Array:
        curves = np.stack([np.tanh(samples.v / scales.slow), samples.v / scales.v], axis=-1)
        return np.asarray(np.einsum("nmi,mi->nm", curves, factors))

    return torque


def _no_friction(samples: Samples) -> Array:
    return np.zeros_like(samples.q)


def _black_box(
    task: Task, training: Samples, test: Samples, generate: StateGenerator | None
) -> float:
    """Return the error of a network without physics, or with physics in its loss only."""
    from mbd_ros.features.identification.learn.network import (
        Collocation,
        TrainingPlan,
        first_weights,
        make_network,
        mean_torque,
        train,
    )

    few = thin_out(training, MOST)
    scales, random = Scales.of(few, few.effort), np.random.default_rng(task.seed)
    network = make_network("free", scales, accelerations=True)
    weights = first_weights("free", few.q.shape[1], task.members, random, accelerations=True)
    states = None
    if generate is not None:
        samples, torque = generate(scales, random)
        states = Collocation(samples, torque / scales.torque, INFORMED)
    plan = TrainingPlan(_MORE * task.optimization_steps, seed=task.seed, rate=task.rate)
    weights, _ = train(network, weights, few, few.effort / scales.torque, plan, states)
    return relative_error(mean_torque(network, weights, test), test.measured)


def _dynamics_states(scene: Scene, recordings: Recordings, add: TorqueModel) -> StateGenerator:
    """Return a generator of unmeasured states with the torques of the equations of motion."""
    solver, joints = scene.inverse_dynamics(), recordings.joints
    limits = np.array([limits_of(scene.robot, name) for name in joints]).T
    indices = [scene.couplings.independent.index(name) for name in joints]
    coordinates = IndependentCoordinates(scene.robot, scene.couplings)
    joint_y = np.array(coordinates.joint_y)[indices]
    joint_w = np.array(coordinates.joint_w)[indices]

    def generate(scales: Scales, random: np.random.Generator) -> tuple[Samples, Array]:
        n, m = MOST, len(joints)
        q = random.uniform(*limits, (n, m))
        v, a = (_WIDE * size * random.normal(size=(n, m)) for size in (scales.v, scales.a))
        y = np.tile(scene.robot.neutral()[scene.couplings.q_index], (n, 1))
        w, push = np.zeros((2, n, len(scene.couplings.v_index)))
        y[:, joint_y], w[:, joint_w], push[:, joint_w] = q, v, a
        zero = np.zeros_like(q)
        states = Samples(np.arange(1.0 * n), q, v, a, zero, zero, zero, y, w, push)
        return states, solver.batch(y, w, push).tau[:, joint_w] + add(states)

    return generate


def _table(rows: Sequence[tuple[float, str, int, float]]) -> Table:
    seconds, methods, seeds, errors = (np.array(column) for column in zip(*rows, strict=True))
    columns = [Column("way", methods), Column("seconds", seconds, "s")]
    return Table([*columns, Column("seed", 1.0 * seeds), Column("error", 100.0 * errors, "%")])


def _summary(rows: Sequence[tuple[float, str, int, float]], amounts: Sequence[float]) -> Table:
    values = []
    for method in METHODS:
        for amount in amounts:
            errors = [100.0 * e for s, w, _, e in rows if (s, w) == (amount, method)]
            values.append((method, amount, float(np.mean(errors)), min(errors), max(errors)))
    methods, seconds, mean, least, most = (np.array(c) for c in zip(*values, strict=True))
    columns = [Column("way", methods), Column("seconds", seconds, "s")]
    named = (("mean", mean), ("least", least), ("largest", most))
    return Table([*columns, *(Column(name, values, "%") for name, values in named)])
