"""Training of a torque model: a new one, or an adapted or continued earlier one.

With an earlier model and few new recordings, adapters are fitted: corrections of inertias,
friction and stiffness, and low-rank matrices that are added to the weights of the network.
Corrections come first and use earlier and new samples. The network is used only where it predicts
blocks of the new samples better than corrections alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbd_ros.core.model.couplings import IndependentCoordinates
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, install_hint
from mbd_ros.features.identification.learn.linear_corrections import Columns, solve_corrections
from mbd_ros.features.identification.learn.task import FREEZE, LearnedModel, Task
from mbd_ros.features.identification.learn.training_samples import (
    ReportProgress,
    Samples,
    Scales,
    blocks_of,
    is_better,
    trusted_share,
)
from mbd_ros.features.identification.samples import (
    Piece,
    Recorded,
    band_of,
    load_recording,
    pieces,
)
from mbd_ros.jobs.progress import Say
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import InverseDynamics
from mbd_ros.methods.learned_model import About, check_physics, check_robot, numbers_of
from mbd_ros.motion.samples import select_rows
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reading.learned_entries import physics_beside

if TYPE_CHECKING:
    from mbd_ros.features.identification.learn.network import Collocation

_MEASURED = 0.99  # of the samples: a joint with fewer efforts is left out
FEWEST = 20  # samples
_END = 0.75  # periods of the end of the band: at ends, derivatives lack a neighbour
_INNER = 0.5  # of a piece: with fewer inner samples, or fewer than `FEWEST`, ends are used
MOST = 500  # samples for the training of a network
MANY = 5000  # samples for corrections
_BLOCKS = 5  # of time, each left out once
_RANK = 2  # of the matrices that are added to weights
_HOLD = 1.0e-3  # penalty on these matrices
_AROUND = 0.5  # of the scales: distance of collocation states from measured ones
INFORMED = 0.3  # weight of the equations of motion relative to the data


def fit(
    scene: Scene, task: Task, joints: tuple[str, ...], samples: Samples, tell: ReportProgress
) -> LearnedModel:
    """Train a model for the difference between measured efforts and the torques of a scene.

    Args:
        task: Options of learning.
        joints: Names of the columns.
        samples: Training samples.
        tell: Receives the share of the work that is done.

    Raises:
        DataError: torch is not installed, or the model to adapt has other joints or another
            version.
    """
    require_torch()
    if task.start is None:
        model = _train_new(scene, task, joints, samples, tell)
    else:
        check_start(task.start, joints, scene)
        columns = Columns(scene, joints, task.start.scales)
        if task.start.numbers.shape != columns.none().shape:
            raise DataError("--start: this model is of another version; train it again")
        change = adapt if task.freeze == FREEZE[1] else _all_weights
        model = change(columns, task, samples, task.start, tell)
    return model._replace(about=_describe(scene, model, samples, task.start))


def require_torch() -> None:
    """Refuse to learn without torch and onnx.

    Raises:
        DataError: One of them is not installed; the message tells how to install it.
    """
    from importlib.util import find_spec

    for module in ("torch", "onnx"):
        if find_spec(module) is None:
            raise DataError(f"learning: {install_hint(module)}")


def _train_new(
    scene: Scene, task: Task, joints: tuple[str, ...], samples: Samples, tell: ReportProgress
) -> LearnedModel:
    """Train a new network."""
    from mbd_ros.features.identification.learn.network import (
        TrainingPlan,
        first_weights,
        make_network,
        mean_torque,
        train,
    )

    few, many = thin_out(samples, MOST), thin_out(samples, MANY)
    residual = few.effort - few.physics
    scales = Scales.of(few, residual)
    kind = "structured" if task.variant == "structured" else "free"
    random = np.random.default_rng(task.seed)
    network = make_network(kind, scales)
    weights = first_weights(kind, len(joints), task.members, random)
    target = residual / scales.torque
    states = None
    if task.variant == "informed":
        states = collocation(few, np.zeros_like(target), random)
    plan = TrainingPlan(task.optimization_steps, seed=task.seed, rate=task.rate)
    weights, unseen = train(network, weights, few, target, plan, states, tell)
    trust = trusted_share(unseen, target, len(weights["W1"]), kind == "structured")
    columns = Columns(scene, joints, scales)
    statistics = columns.statistics(many, trust * mean_torque(network, weights, many))
    wall = np.zeros(2 * len(joints))
    about = About(kind, "", joints, wall, wall, {})
    return LearnedModel(about, scales, weights, trust, statistics, columns.none())


def thin_out(samples: Samples, most: int) -> Samples:
    """Return evenly spaced samples, at most `most`."""
    return samples.at(slice(None, None, -(-samples.count // most)))


def collocation(samples: Samples, target: Array, random: np.random.Generator) -> Collocation:
    """Return states near the measured ones at which a network must satisfy the dynamics.

    Args:
        target: Required torque over its scale, shape (n, m), if it does not depend on the state.
        random: Generator for the states.
    """
    from mbd_ros.features.identification.learn.network import Collocation

    return Collocation(perturb_states(samples, random), target, INFORMED)


def perturb_states(samples: Samples, random: np.random.Generator) -> Samples:
    """Return states without a measurement near the measured ones."""
    q, v, a = (
        values + _AROUND * values.std(axis=0) * random.normal(size=values.shape)
        for values in (samples.q, samples.v, samples.a)
    )
    return samples._replace(q=q, v=v, a=a)


def check_start(start: LearnedModel, joints: tuple[str, ...], scene: Scene) -> None:
    """Refuse to adapt a model of another robot, or of other joints.

    Raises:
        DataError: Joints differ.
        ModelError: Robot or physics differ.
    """
    check_robot("--start", start.about, scene.robot)
    if start.about.joints != joints:
        raise DataError(
            f"--start: the model has joints {', '.join(start.about.joints)}, but the recording "
            f"has efforts of {', '.join(joints)}; train a new model or record "
            "these joints"
        )
    check_physics("--start", start.about, physics_beside(scene, start.about))


def adapt(
    columns: Columns, task: Task, samples: Samples, start: LearnedModel, tell: ReportProgress
) -> LearnedModel:
    """Adapt a model to new samples.

    Args:
        columns: Columns of the corrections.
        task: Options of learning.
        samples: New training samples.
        start: Earlier model, whose weights are frozen.
        tell: Receives the share of the work that is done.
    """
    from mbd_ros.features.identification.learn.network import make_network, mean_torque

    many, network = thin_out(samples, MANY), make_network(start.about.kind, start.scales)
    torque = start.trust * mean_torque(network, start.weights, many)
    choice = _choose_adapters(columns, start, many, torque)
    new = columns.statistics(many, torque)
    statistics = start.known.merge(new) if choice.uses_earlier_samples else new
    numbers = columns.limit(solve_corrections(statistics, choice.uses_network))
    model = start._replace(known=statistics, numbers=numbers)
    if not choice.uses_network:
        return model._replace(trust=np.zeros_like(start.trust))
    return model._replace(weights=_train_low_rank(network, columns, task, samples, model, tell))


def _choose_adapters(
    columns: Columns, start: LearnedModel, many: Samples, torque: Array
) -> AdapterChoice:
    """Return the first choice that no later one improves significantly, on left-out blocks."""
    rows, block = columns.of(many), blocks_of(many.count, _BLOCKS)
    residual = many.measured - many.physics

    def squared_errors(choice: AdapterChoice) -> Array:
        squares = np.zeros(_BLOCKS)
        for i in range(_BLOCKS):
            out = block == i
            statistics = columns.statistics(many.at(~out), torque[~out])
            statistics = (
                start.known.merge(statistics) if choice.uses_earlier_samples else statistics
            )
            error = residual[out] - rows[out] @ solve_corrections(statistics, choice.uses_network)
            error -= choice.uses_network * torque[out]
            squares[i] = np.square(error / start.known.usual).sum()
        return squares

    best = AdapterChoice(uses_earlier_samples=True, uses_network=False)
    least = squared_errors(best)
    for choice in (
        AdapterChoice(True, True),
        AdapterChoice(False, False),
        AdapterChoice(False, True),
    ):
        if choice.uses_network and not start.trust.any():
            continue
        squares = squared_errors(choice)
        if is_better(squares, least):
            best, least = choice, squares
    return best


class AdapterChoice(NamedTuple):
    """Statistics that an adapted model uses beside the corrections.

    Attributes:
        uses_earlier_samples: Whether corrections are fitted to samples of the earlier model too.
        uses_network: Whether the torque of the network is added.
    """

    uses_earlier_samples: bool
    uses_network: bool


def _train_low_rank(
    network: Any,
    columns: Columns,
    task: Task,
    samples: Samples,
    model: LearnedModel,
    tell: ReportProgress,
) -> dict[str, Array]:
    """Train low-rank matrices that are added to the weights, for the residual of corrections."""
    from mbd_ros.features.identification.learn.network import TrainingPlan, mean_torque, train

    few = thin_out(samples, MOST)
    residual = few.effort - few.physics - columns.torque(few, model.numbers)
    torque = mean_torque(network, model.weights, few)
    target = np.where(model.trust > 0.0, residual / np.maximum(model.trust, 1.0e-300), torque)
    plan = TrainingPlan(
        task.optimization_steps, _RANK, _HOLD, task.seed, task.rate, leaves_out=False
    )
    target = target / model.scales.torque
    weights, _ = train(network, model.weights, few, target, plan, None, tell)
    return weights


def _all_weights(
    columns: Columns, task: Task, samples: Samples, start: LearnedModel, tell: ReportProgress
) -> LearnedModel:
    """Continue the training of all weights; few samples leave no block for early stopping."""
    from mbd_ros.features.identification.learn.network import (
        TrainingPlan,
        make_network,
        mean_torque,
        train,
    )

    few, many = thin_out(samples, MOST), thin_out(samples, MANY)
    network = make_network(start.about.kind, start.scales)
    residual = few.effort - few.physics - columns.torque(few, start.numbers)
    target, states = residual / start.scales.torque, None
    if task.variant == "informed":
        random = np.random.default_rng(task.seed)
        states = collocation(few, np.zeros_like(target), random)
    plan = TrainingPlan(task.optimization_steps, seed=task.seed, rate=task.rate, leaves_out=False)
    weights, _ = train(network, start.weights, few, target, plan, states, tell)
    new = columns.statistics(many, mean_torque(network, weights, many))
    statistics = start.known.merge(new)
    return start._replace(weights=weights, trust=np.ones_like(start.trust), known=statistics)


def _describe(
    scene: Scene, model: LearnedModel, samples: Samples, start: LearnedModel | None
) -> About:
    """Return the description of a model; that of an adapted model covers the earlier data."""
    states = np.hstack([samples.q, samples.v])
    low, high = states.min(axis=0), states.max(axis=0)
    if start is not None:
        low, high = np.minimum(low, start.about.low), np.maximum(high, start.about.high)
    wide = np.maximum(high - low, 1.0e-6 * max(float((high - low).max()), 1.0e-6))
    middle = 0.5 * (low + high)
    about = model.about._replace(
        scene=scene.name.rpartition("/")[2],
        low=middle - 0.5 * wide,
        high=middle + 0.5 * wide,
        robot=numbers_of(scene.robot),
    )
    about = about._replace(physics=physics_beside(scene, about))
    columns = Columns(scene, about.joints, model.scales)
    return columns.describe(about, model.numbers) if model.numbers.any() else about


class Recordings:
    """Recordings for the training of a model.

    Args:
        scene: The scene.
        task: Options of learning.
        say: Receives a line for joints without efforts.

    Attributes:
        every: All recordings.
        where: Their names.
        joints: Joints with efforts.
        band: End of the frequency band [Hz]; None where motions have accelerations.
    """

    def __init__(self, scene: Scene, task: Task, say: Say) -> None:
        if not isinstance(scene.inverse_dynamics(), InverseDynamics):
            raise DataError(
                f"{scene.name}: the scene has loops, but learning supports open chains only"
            )
        if task.wrenches and len(task.wrenches) != len(task.motions):
            raise DataError(
                f"--wrenches: there are {len(task.wrenches)} tables for {len(task.motions)} "
                "motions; give one table for each motion"
            )
        if not task.motions:
            raise DataError("there is no motion to learn from; give tables or bags")
        options = {"topic": task.topic, "derivatives": task.derivatives, "say": say}
        pairs = zip_longest(task.motions, task.wrenches)
        self.every = [
            load_recording(scene, source, wrenches=load, **options) for source, load in pairs
        ]
        self.where = ", ".join(recorded.where for recorded in self.every)
        self.joints = self._measured(scene, say)
        self.band = task.band
        if self.band is None and any(r.derivatives != "given" for r in self.every):
            parts = (piece for r in self.every for piece in pieces(scene, r, None))
            self.band = max(band_of(piece.times, piece.v) for piece in parts)

    def _measured(self, scene: Scene, say: Say) -> tuple[str, ...]:
        """Return the joints with efforts in all recordings."""
        names, measured = scene.couplings.independent, []
        for i, name in enumerate(names):
            efforts = [r.motion.effort for r in self.every]
            columns = [e[:, i] for e in efforts if e is not None]
            is_measured = len(columns) == len(efforts) and all(
                np.isfinite(c).mean() > _MEASURED and c.any() for c in columns
            )
            if is_measured:
                measured.append(name)
            else:
                say(f"{name}: left out, since there is no effort of this joint")
        if not measured:
            raise DataError(
                f"{self.where}: no effort of any of {', '.join(names)}; learning needs the "
                "measured effort of at least one of these joints"
            )
        return tuple(measured)

    def samples(self, scene: Scene, recorded: Sequence[Recorded]) -> Samples:
        """Return the samples of recordings, one after another.

        Args:
            scene: Scene that predicts the torques; it has the same robot.
            recorded: Recordings, or parts of them.

        Raises:
            DataError: There are too few samples.
        """
        parts = [
            self._without_ends(part, self._of_piece(scene, piece))
            for part in recorded
            for piece in pieces(scene, part, self.band)
        ]
        joined = Samples(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
        is_finite = np.isfinite(np.hstack([joined.effort, joined.measured])).all(axis=1)
        joined = joined.at(is_finite)
        if joined.count < FEWEST:
            raise DataError(
                f"{self.where}: there are {joined.count} samples for the training, but at least "
                f"{FEWEST} are needed; record for longer"
            )
        return joined

    def _without_ends(self, recorded: Recorded, samples: Samples) -> Samples:
        """Return samples without the ends, where positions do not determine accelerations."""
        if recorded.derivatives == "given" or self.band is None:
            return samples
        times, end = samples.times, _END / self.band
        inner = (times >= times[0] + end) & (times <= times[-1] - end)
        is_enough = inner.mean() > _INNER and inner.sum() >= FEWEST
        return samples.at(inner) if is_enough else samples

    def _of_piece(self, scene: Scene, piece: Piece) -> Samples:
        coordinates = IndependentCoordinates(scene.robot, scene.couplings)
        tau = scene.inverse_dynamics().batch(piece.y, piece.v, piece.a, piece.loads).tau
        names = scene.couplings.independent
        joints = [names.index(name) for name in self.joints]
        y, w = np.array(coordinates.joint_y)[joints], np.array(coordinates.joint_w)[joints]
        motion = piece.y[:, y], piece.v[:, w], piece.a[:, w]
        efforts = piece.effort[:, joints], piece.measured[:, joints]
        return Samples(piece.times, *motion, *efforts, tau[:, w], piece.y, piece.v, piece.a)


def first_seconds(recorded: Recorded, seconds: float) -> Recorded:
    """Return the beginning of a recording."""
    return recorded._replace(motion=select_rows(recorded.motion, recorded.times <= seconds))


def relative_error(prediction: Array, measured: Array) -> float:
    """Return the norm of an error over the norm of the measured values."""
    return float(np.linalg.norm(prediction - measured) / max(np.linalg.norm(measured), 1e-300))
