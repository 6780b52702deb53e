"""From samples to a learned model: a new one, or one that goes on from another."""

from typing import TYPE_CHECKING

import numpy as np

from mbd_ros.core.learned.model_file import About, numbers_of
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.features.identification.learn.adapting import MANY, MOST, adapt, check_start
from mbd_ros.features.identification.learn.correcting import Columns
from mbd_ros.features.identification.learn.ensembles import (
    Tell,
    first_weights,
    network_of,
    require_torch,
    said_by,
)
from mbd_ros.features.identification.learn.recordings import thinned
from mbd_ros.features.identification.learn.scales import Samples, Scales
from mbd_ros.features.identification.learn.task import FREEZE, Learned, Task
from mbd_ros.features.identification.learn.trust import trusted
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reading.learned_entries import physics_beside

if TYPE_CHECKING:
    from mbd_ros.features.identification.learn.training import Collocation

_AROUND = 0.5  # of the scales: how far states without a measurement lie from measured ones
INFORMED = 0.3  # weight of the equations of motion beside the data


def fit(
    scene: Scene, task: Task, joints: tuple[str, ...], samples: Samples, tell: Tell
) -> Learned:
    """Learn what the torques of a scene leave of the efforts.

    Args:
        scene: The scene.
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


def _new(
    scene: Scene, task: Task, joints: tuple[str, ...], samples: Samples, tell: Tell
) -> Learned:
    """A network that nothing was learned with before."""
    from mbd_ros.features.identification.learn.training import Plan, train

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
    found = train(network, weights, few, wanted, plan, around, tell)
    trust = trusted(found.unseen, wanted, len(found.weights["W1"]), kind == "structured")
    columns = Columns(scene, joints, scales)
    said = trust * said_by(network, found.weights, many)
    known = columns.known(many, said)
    wall = np.zeros(2 * len(joints))
    about = About(kind, "", joints, wall, wall, {})
    return Learned(about, scales, found.weights, trust, known, columns.none())


def _all_weights(
    columns: Columns, task: Task, samples: Samples, start: Learned, tell: Tell
) -> Learned:
    """All weights go on from where they are; few trials leave no block to stop on."""
    from mbd_ros.features.identification.learn.training import Plan, train

    few, many = thinned(samples, MOST), thinned(samples, MANY)
    network = network_of(start.about.kind, start.scales)
    left = few.effort - few.physics - columns.torque(few, start.numbers)
    wanted, around = left / start.scales.torque, None
    if task.variant == "informed":
        random = np.random.default_rng(task.seed)
        around = collocation(few, np.zeros_like(wanted), random)
    plan = Plan(task.rounds, seed=task.seed, rate=task.rate, leaves_out=False)
    weights = train(network, start.weights, few, wanted, plan, around, tell).weights
    said = said_by(network, weights, many)
    known = start.known.and_also(columns.known(many, said))
    return start._replace(weights=weights, trust=np.ones_like(start.trust), known=known)


def collocation(samples: Samples, wanted: Array, random: np.random.Generator) -> "Collocation":
    """States around the measured ones, with what the equations of motion ask of them.

    Args:
        samples: Measured ones.
        wanted: Over the scale, shape (n, m), where it does not depend on the state.
        random: For the states.
    """
    from mbd_ros.features.identification.learn.training import Collocation

    return Collocation(around(samples, random), wanted, INFORMED)


def around(samples: Samples, random: np.random.Generator) -> Samples:
    """States without a measurement, around the measured ones."""
    moved = [
        values + _AROUND * values.std(axis=0) * random.normal(size=values.shape)
        for values in (samples.q, samples.v, samples.a)
    ]
    return samples._replace(q=moved[0], v=moved[1], a=moved[2])


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
