"""A trained model and few trials of something new: what changes, and what stays.

Adapters are corrections of inertias, friction and stiffness, and matrices of low rank beside the
weights of the network. Corrections come first, from what was learned from before and from the
new trials; the network stays where it predicts blocks of the new trials better than they do alone.
"""

from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.learned.known_physics import check_physics
from mbd_ros.core.learned.model_file import check_robot
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.features.identification.learn.correcting import Columns, fitted
from mbd_ros.features.identification.learn.ensembles import Tell, network_of, said_by
from mbd_ros.features.identification.learn.recordings import thinned
from mbd_ros.features.identification.learn.scales import Samples
from mbd_ros.features.identification.learn.task import Learned, Task
from mbd_ros.features.identification.learn.trust import blocks_of, is_better
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reading.learned_entries import physics_beside

MOST = 500  # samples that a network learns from
MANY = 5000  # samples that corrections are learned from
_BLOCKS = 5  # of time, each left out once
_RANK, _HOLD = 2, 1.0e-3  # of matrices beside weights, and the penalty on them


class Choice(NamedTuple):
    """What stands beside the corrections.

    Attributes:
        with_earlier: What the model was learned from before counts, too.
        with_network: The network acts.
    """

    with_earlier: bool
    with_network: bool


_CHOICES = (Choice(True, False), Choice(True, True), Choice(False, False), Choice(False, True))


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

    best, least = _CHOICES[0], unseen(_CHOICES[0])
    for choice in _CHOICES[1:]:
        if choice.with_network and not start.trust.any():
            continue
        squares = unseen(choice)
        if is_better(squares, least):
            best, least = choice, squares
    return best


def _beside(
    network: Any, columns: Columns, task: Task, samples: Samples, model: Learned, tell: Tell
) -> dict[str, Array]:
    """Weights with matrices of low rank, for what corrections leave."""
    from mbd_ros.features.identification.learn.training import Plan, train

    few = thinned(samples, MOST)
    left = few.effort - few.physics - columns.torque(few, model.numbers)
    now = said_by(network, model.weights, few)
    wanted = np.where(model.trust > 0.0, left / np.maximum(model.trust, 1.0e-300), now)
    plan = Plan(task.rounds, _RANK, _HOLD, task.seed, task.rate, leaves_out=False)
    wanted = wanted / model.scales.torque
    return train(network, model.weights, few, wanted, plan, None, tell).weights
