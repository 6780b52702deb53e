"""Five ways to predict torques, from more and more seconds: `mbd-ros learn --compare`.

    physics          the scene as given
    identified       inertias and friction identified from the same seconds
    black box        a network of positions, velocities and accelerations, no physics
    residual         the identified scene and a network for what it leaves
    physics-informed the black box, whose loss asks the identified equations of motion, too, at
                     states within the limits of all joints

All of them see the same seconds and are asked for the efforts, as measured, of what comes last.
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
    share_of,
    thinned,
)
from mbd_ros.features.identification.learn.job import prediction, refuse_sources, without_model
from mbd_ros.features.identification.learn.task import Task
from mbd_ros.features.identification.learn.training_samples import (
    Samples,
    Scales,
    blocks_of,
    trusted,
)
from mbd_ros.features.identification.outcome import csv
from mbd_ros.features.identification.regressor import limits_of
from mbd_ros.features.identification.samples import Recorded, split
from mbd_ros.features.identification.task import Task as IdentifyTask
from mbd_ros.files.output_folder import write_files
from mbd_ros.files.table import Column, Table
from mbd_ros.jobs.progress import Say
from mbd_ros.scene.built_scene import Scene

WAYS = ("physics", "identified", "black box", "residual", "physics-informed")
_MARKS = ("s", "D", "o", "^", "v")  # of the ways in the picture
SECONDS = (0.5, 1.0, 2.0, 3.0, 5.0, 10.0)
_LEAST_SHARE = 0.1  # of a recording: identification takes no less
_RIDGE = 1.0e-2  # of the size of a column: friction of few samples stays small
_BLOCKS = 5  # of time, each left out once
_WIDE = 1.5  # times the usual velocity and acceleration: states of which nothing is measured
_MORE = 2  # times the steps of a residual: a black box has more to learn
Torque = Callable[[Samples], Array]
Asked = Callable[[Scales, np.random.Generator], tuple[Samples, Array]]


def compare_to(scene: Scene, task: Task, folder: Path, seeds: int, say: Say) -> None:
    """Write `comparison.csv`, `runs.csv` and `comparison.png`; all, or none."""
    if not 1 <= seeds <= 100:
        raise DataError(f"--seeds {seeds}: accepted are 1 .. 100")
    refuse_sources(folder, task, None)
    runs, summary = compare(scene, task, range(task.seed, task.seed + seeds), say)
    files = {
        "comparison.csv": csv(summary),
        "runs.csv": csv(runs),
        "comparison.png": picture(summary),
    }
    write_files(folder, files)
    say(f"{folder}: {', '.join(files)}")


def picture(summary: Table) -> bytes:
    """Error over seconds of each way, the seeds as bars."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for way, mark in zip(WAYS, _MARKS, strict=True):
        own = summary["way"] == way
        mean, least, most = (summary[name][own] for name in ("mean", "least", "largest"))
        bars = (mean - least, most - mean)
        axes.errorbar(summary["seconds"][own], mean, bars, marker=mark, capsize=3, label=way)
    axes.set(xscale="log", yscale="log", xlabel="learned from [s]")
    axes.set_ylabel("error on what comes last [% of the torque]")
    axes.grid(visible=True, which="both", alpha=0.3)
    axes.legend()
    target = BytesIO()
    figure.savefig(target, format="png", dpi=110)
    return target.getvalue()


def compare(scene: Scene, task: Task, seeds: Sequence[int], say: Say) -> tuple[Table, Table]:
    """Ask all ways for torques of what comes last.

    Args:
        task: What is asked for; of one recording.
        seeds: Of the networks.
        say: Is told each amount of data.

    Returns:
        Errors with a run a row, and with a way and an amount of data a row: mean, least and
        largest error of the seeds.

    Raises:
        DataError: There are several recordings, they cannot be read, or nothing is left for the
            test.
    """
    task.check()
    if len(task.motions) != 1 or task.learned >= 1.0:
        raise DataError("--compare takes one recording, and --learned less than 1")
    scene = without_model(scene)
    recordings = Recordings(scene, task, lambda line: None)
    first, rest = split(recordings.every[0], task.learned)
    assert rest is not None
    longest = float(first.times[-1])
    enough = [s for s in SECONDS if s < 0.9 * longest and (first.times <= s).sum() >= FEWEST]
    amounts = [*enough, longest]
    rows = []
    for seconds in amounts:
        said = _ways(scene, task, recordings, (first_seconds(first, seconds), rest), seeds)
        some = [(seconds, way, seed, error) for way, seed, error in said]
        rows += some
        means = {way: np.mean([e for _, w, _, e in some if w == way]) for way in WAYS}
        texts = (f"{way} {100 * mean:.2f} %" for way, mean in means.items())
        say(f"{seconds:.3g} s: {', '.join(texts)}")
    return _table(rows), _summary(rows, amounts)


def _ways(
    scene: Scene,
    task: Task,
    recordings: Recordings,
    parts: tuple[Recorded, Recorded],
    seeds: Sequence[int],
) -> Iterator[tuple[str, int, float]]:
    """Way, seed and error, from so many seconds."""
    learned, rest = parts
    better = _identified(scene, task, recordings, float(learned.times[-1]))
    given, plain = (recordings.samples(scene, [part]) for part in (learned, rest))
    if better is None:
        train, test, add = given, plain, _friction(given)
    else:
        train, test = (recordings.samples(better, [part]) for part in (learned, rest))
        add = _nothing
    train = train._replace(physics=train.physics + add(train))
    test = test._replace(physics=test.physics + add(test))
    for seed in seeds:
        yield "physics", seed, share_of(plain.physics, plain.measured)
        yield "identified", seed, share_of(test.physics, test.measured)
        own = task._replace(seed=seed)
        yield "black box", seed, _black_box(own, train, test, None)
        model = fit(scene, own, recordings.joints, train, lambda share: None)
        yield "residual", seed, share_of(prediction(scene, model, test), test.measured)
        asked = _asked(scene if better is None else better, recordings, add)
        yield "physics-informed", seed, _black_box(own, train, test, asked)


def _identified(scene: Scene, task: Task, recordings: Recordings, seconds: float) -> Scene | None:
    """The scene identified from the first seconds; None where they are too few."""
    whole = float(recordings.every[0].times[-1])
    if seconds / whole < _LEAST_SHARE:
        return None
    asked = IdentifyTask(
        task.motions,
        task.wrenches,
        task.topic,
        task.derivatives,
        recordings.band,
        learned=seconds / whole,
        partial=True,
    )
    try:
        return run_identify(scene, asked, lambda line: None).scene
    except MbdError:
        return None


def _friction(samples: Samples) -> Torque:
    """Dry and viscous friction of each joint, where too few seconds tell the masses.

    As for networks, a joint gets the share that holds in blocks that were left out.
    """
    left = samples.effort - samples.physics
    scales = Scales.of(samples, left)
    curves = np.stack([np.tanh(samples.v / scales.slow), samples.v / scales.v], axis=-1)
    block = blocks_of(samples.count, _BLOCKS)

    def fitted(rows: Array) -> Array:
        A, b = curves[rows], left[rows]
        square = np.einsum("nmi,nmj->mij", A, A) + _RIDGE * len(b) * np.eye(2)
        return np.linalg.solve(square, np.einsum("nmi,nm->mi", A, b)[..., None])[..., 0]

    unseen = np.zeros_like(left)
    for i in range(_BLOCKS):
        unseen[block == i] = np.einsum("nmi,mi->nm", curves[block == i], fitted(block != i))
    factors = trusted(unseen, left, _BLOCKS, together=False)[:, None] * fitted(block >= 0)

    def torque(of: Samples) -> Array:
        shown = np.stack([np.tanh(of.v / scales.slow), of.v / scales.v], axis=-1)
        return np.asarray(np.einsum("nmi,mi->nm", shown, factors))

    return torque


def _nothing(samples: Samples) -> Array:
    return np.zeros_like(samples.q)


def _black_box(task: Task, learned: Samples, test: Samples, asked: Asked | None) -> float:
    """Error of a network without physics, or with physics in its loss alone."""
    from mbd_ros.features.identification.learn.network import (
        Collocation,
        Plan,
        first_weights,
        network_of,
        said_by,
        train,
    )

    few = thinned(learned, MOST)
    scales, random = Scales.of(few, few.effort), np.random.default_rng(task.seed)
    network = network_of("free", scales, accelerations=True)
    weights = first_weights("free", few.q.shape[1], task.members, random, accelerations=True)
    states = None
    if asked is not None:
        at, torque = asked(scales, random)
        states = Collocation(at, torque / scales.torque, INFORMED)
    plan = Plan(_MORE * task.rounds, seed=task.seed, rate=task.rate)
    weights, _ = train(network, weights, few, few.effort / scales.torque, plan, states)
    return share_of(said_by(network, weights, test), test.measured)


def _asked(scene: Scene, recordings: Recordings, add: Torque) -> Asked:
    """Gives states of which nothing is measured, with what the equations of motion ask there."""
    solver, joints = scene.inverse_dynamics(), recordings.joints
    limits = np.array([limits_of(scene.robot, name) for name in joints]).T
    mine = [scene.couplings.independent.index(name) for name in joints]
    at = IndependentCoordinates(scene.robot, scene.couplings)
    y_at, w_at = np.array(at.joint_y)[mine], np.array(at.joint_w)[mine]

    def asked(scales: Scales, random: np.random.Generator) -> tuple[Samples, Array]:
        n, m = MOST, len(joints)
        q = random.uniform(*limits, (n, m))
        v, a = (_WIDE * size * random.normal(size=(n, m)) for size in (scales.v, scales.a))
        y = np.tile(scene.robot.neutral()[scene.couplings.q_index], (n, 1))
        w, push = np.zeros((2, n, len(scene.couplings.v_index)))
        y[:, y_at], w[:, w_at], push[:, w_at] = q, v, a
        zero = np.zeros_like(q)
        states = Samples(np.arange(1.0 * n), q, v, a, zero, zero, zero, y, w, push)
        return states, solver.batch(y, w, push).tau[:, w_at] + add(states)

    return asked


def _table(rows: Sequence[tuple[float, str, int, float]]) -> Table:
    seconds, ways, seeds, errors = (np.array(column) for column in zip(*rows, strict=True))
    columns = [Column("way", ways), Column("seconds", seconds, "s")]
    return Table([*columns, Column("seed", 1.0 * seeds), Column("error", 100.0 * errors, "%")])


def _summary(rows: Sequence[tuple[float, str, int, float]], amounts: Sequence[float]) -> Table:
    found = []
    for way in WAYS:
        for amount in amounts:
            own = [100.0 * e for s, w, _, e in rows if (s, w) == (amount, way)]
            found.append((way, amount, float(np.mean(own)), min(own), max(own)))
    ways, seconds, mean, least, most = (np.array(column) for column in zip(*found, strict=True))
    columns = [Column("way", ways), Column("seconds", seconds, "s")]
    named = (("mean", mean), ("least", least), ("largest", most))
    return Table([*columns, *(Column(name, values, "%") for name, values in named)])
