"""From recordings to a learned model: new, going on from another, or adapted by few trials.

A trained model and few trials of something new: adapters are corrections of inertias, friction and
stiffness, and matrices of low rank beside the weights of the network. Corrections come first, from
what was learned from before and from the new trials; the network stays where it predicts blocks of
the new trials better than they do alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbd_ros.core.model.couplings import IndependentCoordinates
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, install_hint
from mbd_ros.features.identification.learn.linear_corrections import Columns, fitted
from mbd_ros.features.identification.learn.task import FREEZE, Learned, Task
from mbd_ros.features.identification.learn.training_samples import (
    Samples,
    Scales,
    Tell,
    blocks_of,
    is_better,
    trusted,
)
from mbd_ros.features.identification.samples import Piece, Recorded, band_of, pieces, read
from mbd_ros.jobs.progress import Say
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import InverseDynamics
from mbd_ros.methods.learned import About, check_physics, check_robot, numbers_of
from mbd_ros.motion.samples import kept_rows
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reading.learned_entries import physics_beside

if TYPE_CHECKING:
    from mbd_ros.features.identification.learn.network import Collocation

_MEASURED = 0.99  # of the samples: a joint with fewer efforts is not learned
FEWEST = 20  # samples
_END = 0.75  # periods of the end of the band: where derivatives lack a neighbour
_INNER = 0.5  # of the samples of a piece: with fewer, or with less than `FEWEST`, ends are kept
MOST = 500  # samples that a network learns from
MANY = 5000  # samples that corrections are learned from
_BLOCKS = 5  # of time, each left out once
_RANK = 2  # of matrices beside weights
_HOLD = 1.0e-3  # penalty on them
_AROUND = 0.5  # of the scales: how far states without a measurement lie from measured ones
INFORMED = 0.3  # weight of the equations of motion beside the data


def fit(
    scene: Scene, task: Task, joints: tuple[str, ...], samples: Samples, tell: Tell
) -> Learned:
    """Learn what the torques of a scene leave of the efforts.

    Args:
        task: What is asked for.
        joints: Names of the columns.
        samples: What is learned from.
        tell: Is told the share that is done.

    Raises:
        DataError: torch is not installed, or the model to adapt is of other joints or of another
            version.
    """
    require_torch()
    if task.start is None:
        found = _new(scene, task, joints, samples, tell)
    else:
        check_start(task.start, joints, scene)
        columns = Columns(scene, joints, task.start.scales)
        if task.start.numbers.shape != columns.none().shape:
            raise DataError("--start: its weights are of another version; learn the model again")
        change = adapt if task.freeze == FREEZE[1] else _all_weights
        found = change(columns, task, samples, task.start, tell)
    return found._replace(about=_about(scene, found, samples, task.start))


def require_torch() -> None:
    """Refuse to learn without torch.

    Raises:
        DataError: With the line that installs it.
    """
    from importlib.util import find_spec

    for module in ("torch", "onnx"):
        if find_spec(module) is None:
            raise DataError(f"learning: {install_hint(module)}")


def _new(
    scene: Scene, task: Task, joints: tuple[str, ...], samples: Samples, tell: Tell
) -> Learned:
    """A network that nothing was learned with before."""
    from mbd_ros.features.identification.learn.network import (
        Plan,
        first_weights,
        network_of,
        said_by,
        train,
    )

    few, many = thinned(samples, MOST), thinned(samples, MANY)
    left = few.effort - few.physics
    scales = Scales.of(few, left)
    kind = "structured" if task.variant == "structured" else "free"
    random = np.random.default_rng(task.seed)
    network = network_of(kind, scales)
    weights = first_weights(kind, len(joints), task.members, random)
    wanted = left / scales.torque
    around = None
    if task.variant == "informed":
        around = collocation(few, np.zeros_like(wanted), random)
    plan = Plan(task.rounds, seed=task.seed, rate=task.rate)
    weights, unseen = train(network, weights, few, wanted, plan, around, tell)
    trust = trusted(unseen, wanted, len(weights["W1"]), kind == "structured")
    columns = Columns(scene, joints, scales)
    said = trust * said_by(network, weights, many)
    known = columns.known(many, said)
    wall = np.zeros(2 * len(joints))
    about = About(kind, "", joints, wall, wall, {})
    return Learned(about, scales, weights, trust, known, columns.none())


def thinned(samples: Samples, most: int) -> Samples:
    """Every so many samples: those between say little that is new."""
    return samples.at(slice(None, None, -(-samples.count // most)))


def collocation(samples: Samples, wanted: Array, random: np.random.Generator) -> Collocation:
    """States around the measured ones, with what the equations of motion ask of them.

    Args:
        wanted: Over the scale, shape (n, m), where it does not depend on the state.
        random: For the states.
    """
    from mbd_ros.features.identification.learn.network import Collocation

    return Collocation(around(samples, random), wanted, INFORMED)


def around(samples: Samples, random: np.random.Generator) -> Samples:
    """States without a measurement, around the measured ones."""
    moved = [
        values + _AROUND * values.std(axis=0) * random.normal(size=values.shape)
        for values in (samples.q, samples.v, samples.a)
    ]
    return samples._replace(q=moved[0], v=moved[1], a=moved[2])


def check_start(start: Learned, joints: tuple[str, ...], scene: Scene) -> None:
    """Refuse to go on with a model of another robot, or of other joints.

    Raises:
        DataError: Names what differs.
        ModelError: Names what differs.
    """
    check_robot("--start", start.about, scene.robot)
    if start.about.joints != joints:
        raise DataError(
            f"--start: the model has joints {', '.join(start.about.joints)}, the recording has "
            f"efforts of {', '.join(joints)}"
        )
    check_physics("--start", start.about, physics_beside(scene, start.about))


def adapt(columns: Columns, task: Task, samples: Samples, start: Learned, tell: Tell) -> Learned:
    """A model with adapters for new samples.

    Args:
        columns: Of the corrections.
        task: What is asked for.
        samples: What is learned from.
        start: The model; all its weights stay.
        tell: Is told the share that is done.
    """
    from mbd_ros.features.identification.learn.network import network_of, said_by

    many, network = thinned(samples, MANY), network_of(start.about.kind, start.scales)
    said = start.trust * said_by(network, start.weights, many)
    choice = _chosen(columns, start, many, said)
    new = columns.known(many, said)
    known = start.known.and_also(new) if choice.with_earlier else new
    numbers = columns.possible(fitted(known, choice.with_network))
    found = start._replace(known=known, numbers=numbers)
    if not choice.with_network:
        return found._replace(trust=np.zeros_like(start.trust))
    return found._replace(weights=_beside(network, columns, task, samples, found, tell))


def _chosen(columns: Columns, start: Learned, many: Samples, said: Array) -> Choice:
    """The first choice that none of those after it surely betters, on blocks left out."""
    rows, block = columns.of(many), blocks_of(many.count, _BLOCKS)
    left = many.measured - many.physics

    def unseen(choice: Choice) -> Array:
        squares = np.zeros(_BLOCKS)
        for i in range(_BLOCKS):
            out = block == i
            known = columns.known(many.at(~out), said[~out])
            known = start.known.and_also(known) if choice.with_earlier else known
            error = left[out] - rows[out] @ fitted(known, choice.with_network)
            error -= choice.with_network * said[out]
            squares[i] = np.square(error / start.known.usual).sum()
        return squares

    best = Choice(with_earlier=True, with_network=False)
    least = unseen(best)
    for choice in (Choice(True, True), Choice(False, False), Choice(False, True)):
        if choice.with_network and not start.trust.any():
            continue
        squares = unseen(choice)
        if is_better(squares, least):
            best, least = choice, squares
    return best


class Choice(NamedTuple):
    """What stands beside the corrections.

    Attributes:
        with_earlier: What the model was learned from before counts, too.
        with_network: The network acts.
    """

    with_earlier: bool
    with_network: bool


def _beside(
    network: Any, columns: Columns, task: Task, samples: Samples, model: Learned, tell: Tell
) -> dict[str, Array]:
    """Weights with matrices of low rank, for what corrections leave."""
    from mbd_ros.features.identification.learn.network import Plan, said_by, train

    few = thinned(samples, MOST)
    left = few.effort - few.physics - columns.torque(few, model.numbers)
    now = said_by(network, model.weights, few)
    wanted = np.where(model.trust > 0.0, left / np.maximum(model.trust, 1.0e-300), now)
    plan = Plan(task.rounds, _RANK, _HOLD, task.seed, task.rate, leaves_out=False)
    wanted = wanted / model.scales.torque
    weights, _ = train(network, model.weights, few, wanted, plan, None, tell)
    return weights


def _all_weights(
    columns: Columns, task: Task, samples: Samples, start: Learned, tell: Tell
) -> Learned:
    """All weights go on from where they are; few trials leave no block to stop on."""
    from mbd_ros.features.identification.learn.network import Plan, network_of, said_by, train

    few, many = thinned(samples, MOST), thinned(samples, MANY)
    network = network_of(start.about.kind, start.scales)
    left = few.effort - few.physics - columns.torque(few, start.numbers)
    wanted, around = left / start.scales.torque, None
    if task.variant == "informed":
        random = np.random.default_rng(task.seed)
        around = collocation(few, np.zeros_like(wanted), random)
    plan = Plan(task.rounds, seed=task.seed, rate=task.rate, leaves_out=False)
    weights, _ = train(network, start.weights, few, wanted, plan, around, tell)
    said = said_by(network, weights, many)
    known = start.known.and_also(columns.known(many, said))
    return start._replace(weights=weights, trust=np.ones_like(start.trust), known=known)


def _about(scene: Scene, model: Learned, samples: Samples, start: Learned | None) -> About:
    """What the model belongs to; an adapted one knows what it learned before, too."""
    seen = np.hstack([samples.q, samples.v])
    low, high = seen.min(axis=0), seen.max(axis=0)
    if start is not None:
        low, high = np.minimum(low, start.about.low), np.maximum(high, start.about.high)
    wide = np.maximum(high - low, 1.0e-6 * max(float((high - low).max()), 1.0e-6))
    middle = 0.5 * (low + high)
    said = model.about._replace(
        scene=scene.name.rpartition("/")[2],
        low=middle - 0.5 * wide,
        high=middle + 0.5 * wide,
        robot=numbers_of(scene.robot),
    )
    said = said._replace(physics=physics_beside(scene, said))
    columns = Columns(scene, said.joints, model.scales)
    return columns.written(said, model.numbers) if model.numbers.any() else said


class Recordings:
    """Recordings of a scene.

    Args:
        scene: The scene; its torques are not asked yet.
        task: What is asked for.
        say: Is told what is left out.

    Attributes:
        joints: Joints with efforts.
        band: End of the band [Hz]; None where motions have accelerations.
    """

    def __init__(self, scene: Scene, task: Task, say: Say) -> None:
        if not isinstance(scene.inverse_dynamics(), InverseDynamics):
            raise DataError(f"{scene.name}: learning takes open chains, the scene has loops")
        if task.wrenches and len(task.wrenches) != len(task.motions):
            raise DataError(
                f"--wrenches: {len(task.wrenches)} for {len(task.motions)} motions; give one each"
            )
        if not task.motions:
            raise DataError("no motion to learn from: give tables or bags")
        options = {"topic": task.topic, "derivatives": task.derivatives, "say": say}
        pairs = zip_longest(task.motions, task.wrenches)
        self.every = [read(scene, source, wrenches=load, **options) for source, load in pairs]
        self.where = ", ".join(one.where for one in self.every)
        self.joints = self._measured(scene, say)
        self.band = task.band
        if self.band is None and any(one.derivatives != "given" for one in self.every):
            found = [band_of(p.times, p.v) for one in self.every for p in pieces(scene, one, None)]
            self.band = max(found)

    def _measured(self, scene: Scene, say: Say) -> tuple[str, ...]:
        names, kept = scene.couplings.independent, []
        for i, name in enumerate(names):
            efforts = [one.motion.effort for one in self.every]
            columns = [e[:, i] for e in efforts if e is not None]
            whole = len(columns) == len(efforts) and all(
                np.isfinite(c).mean() > _MEASURED and c.any() for c in columns
            )
            if whole:
                kept.append(name)
            else:
                say(f"{name}: no effort, nothing is learned of it")
        if not kept:
            raise DataError(f"{self.where}: no effort of any of {', '.join(names)}")
        return tuple(kept)

    def samples(self, scene: Scene, recorded: Sequence[Recorded]) -> Samples:
        """Samples of recordings, one after another.

        Args:
            scene: Whose torques stand beside the efforts; of the same robot.
            recorded: Recordings, or parts of them.

        Raises:
            DataError: Too few.
        """
        found = [
            self._inner(one, self._of_piece(scene, piece))
            for one in recorded
            for piece in pieces(scene, one, self.band)
        ]
        joined = Samples(*(np.concatenate(columns) for columns in zip(*found, strict=True)))
        there = np.isfinite(np.hstack([joined.effort, joined.measured])).all(axis=1)
        joined = joined.at(there)
        if joined.count < FEWEST:
            raise DataError(
                f"{self.where}: {joined.count} samples to learn from, needed are {FEWEST}"
            )
        return joined

    def _inner(self, recorded: Recorded, samples: Samples) -> Samples:
        """Samples without the ends, where nobody can tell an acceleration from positions."""
        if recorded.derivatives == "given" or self.band is None:
            return samples
        times, end = samples.times, _END / self.band
        inner = (times >= times[0] + end) & (times <= times[-1] - end)
        is_enough = inner.mean() > _INNER and inner.sum() >= FEWEST
        return samples.at(inner) if is_enough else samples

    def _of_piece(self, scene: Scene, piece: Piece) -> Samples:
        at = IndependentCoordinates(scene.robot, scene.couplings)
        tau = scene.inverse_dynamics().batch(piece.y, piece.v, piece.a, piece.loads).tau
        names = scene.couplings.independent
        mine = [names.index(name) for name in self.joints]
        y, w = np.array(at.joint_y)[mine], np.array(at.joint_w)[mine]
        motion = piece.y[:, y], piece.v[:, w], piece.a[:, w]
        efforts = piece.effort[:, mine], piece.measured[:, mine]
        return Samples(piece.times, *motion, *efforts, tau[:, w], piece.y, piece.v, piece.a)


def first_seconds(recorded: Recorded, seconds: float) -> Recorded:
    """The beginning of a recording."""
    return recorded._replace(motion=kept_rows(recorded.motion, recorded.times <= seconds))


def share_of(prediction: Array, measured: Array) -> float:
    """Norm of an error over the norm of what was measured."""
    return float(np.linalg.norm(prediction - measured) / max(np.linalg.norm(measured), 1e-300))
