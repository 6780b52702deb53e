"""From samples to a learned model: how much of it is to be trusted is measured, not assumed.

Each member of the ensemble leaves a block of time out. What members say of their blocks, put
together, is a prediction of all samples that none of them was fitted to. A joint gets the share
of its torque that explains most there; and none where that does not explain something in nearly
all blocks (one-sided t test, 1 %, since there are several joints).

Source: D. Wolpert, Neural Networks 5, 1992, 241 (predictions of left-out parts as a measure).
"""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from mbd_ros.core.learned.model_file import About, check_robot, numbers_of
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, install_hint
from mbd_ros.jobs.learn.recordings import thinned
from mbd_ros.jobs.learn.scales import Samples, Scales
from mbd_ros.jobs.learn.task import FREEZE, Learned, Task
from mbd_ros.scene.built_scene import Scene

if TYPE_CHECKING:
    from mbd_ros.jobs.learn.training import Collocation, Plan

MOST = 500  # samples that are learned from
_LEAST = 0.1  # of the square of what is left: a smaller gain is not worth a network
_STUDENT = {2: 31.8, 3: 6.96, 4: 4.54, 5: 3.75}  # one-sided 1 % points, by number of blocks
_NORMAL = 3.4  # of more blocks
_RANK, _HOLD = 2, 1.0e-3  # of adapters: matrices, penalty
_AROUND = 0.5  # of the scales: how far states without a measurement lie from measured ones
INFORMED = 0.3  # weight of the equations of motion beside the data
Tell = Callable[[float], None]


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
        DataError: torch is not installed, or the model to adapt is of other joints.
    """
    require_torch()
    from mbd_ros.jobs.learn.training import Plan, train

    few = thinned(samples, MOST)
    left = few.effort - few.physics
    start = task.start
    if start is not None:
        _check_start(start, joints, scene)
    scales = Scales.of(few, left) if start is None else start.scales
    kind = "structured" if task.variant == "structured" else "free"
    kind = kind if start is None else start.about.kind
    random = np.random.default_rng(task.seed)
    network = network_of(kind, scales)
    weights = (
        first_weights(kind, len(joints), task.members, random) if start is None else start.weights
    )
    wanted = left / scales.torque
    plan, around = Plan(task.rounds, seed=task.seed, rate=task.rate), None
    if start is not None:
        plan = adapting(task)
    if task.variant == "informed":
        around = collocation(few, np.zeros_like(wanted), random)
    found = train(network, weights, few, wanted, plan, around, tell)
    blocks = len(found.weights["W1"])
    trust = np.ones(len(joints))
    if start is None:
        trust = trusted(found.unseen, wanted, blocks, kind == "structured")
    said = _about(scene, kind, joints, samples, start)
    return Learned(said, scales, found.weights, trust)


def require_torch() -> None:
    """Refuse to learn without torch.

    Raises:
        DataError: With the line that installs it.
    """
    from importlib.util import find_spec

    for module in ("torch", "onnx"):
        if find_spec(module) is None:
            raise DataError(f"learning: {install_hint(module)}")


def network_of(kind: str, scales: Scales, accelerations: bool = False) -> Any:
    """The network of a kind."""
    from mbd_ros.jobs.learn.network import Free, Structured

    return Structured(scales) if kind == "structured" else Free(scales, accelerations)


def first_weights(
    kind: str, m: int, members: int, random: np.random.Generator, accelerations: bool = False
) -> Mapping[str, Array]:
    """First weights of a network."""
    from mbd_ros.jobs.learn.network import free_weights, structured_weights

    if kind == "structured":
        return structured_weights(m, members, random)
    return free_weights(m, members, (4 if accelerations else 3) * m, random)


def said_by(network: Any, weights: Mapping[str, Array], samples: Samples) -> Array:
    """Mean torque of the members [N·m or N], shape (n, m)."""
    import torch

    with torch.no_grad():
        w = {key: torch.as_tensor(value) for key, value in weights.items()}
        found: Array = network.torque(w, *network.inputs(samples)).mean(dim=0).numpy()
    return found * network.scales.torque


def adapting(task: Task) -> "Plan":
    """How a model is adapted: few trials leave no block to stop on."""
    from mbd_ros.jobs.learn.training import Plan

    if task.freeze == FREEZE[1]:
        return Plan(task.rounds, _RANK, _HOLD, task.seed, task.rate, leaves_out=False)
    return Plan(task.rounds, seed=task.seed, rate=task.rate, leaves_out=False)


def collocation(samples: Samples, wanted: Array, random: np.random.Generator) -> "Collocation":
    """States around the measured ones, with what the equations of motion ask of them.

    Args:
        samples: Measured ones.
        wanted: Over the scale, shape (n, m), where it does not depend on the state.
        random: For the states.
    """
    from mbd_ros.jobs.learn.training import Collocation

    return Collocation(around(samples, random), wanted, INFORMED)


def around(samples: Samples, random: np.random.Generator) -> Samples:
    """States without a measurement, around the measured ones."""
    moved = [
        values + _AROUND * values.std(axis=0) * random.normal(size=values.shape)
        for values in (samples.q, samples.v, samples.a)
    ]
    return samples._replace(q=moved[0], v=moved[1], a=moved[2])


def blocks_of(count: int, members: int) -> Array:
    """Which member leaves each sample out: pieces of time, shape (n,)."""
    return np.asarray(np.minimum(np.arange(count) * members // max(count, 1), members - 1))


def trusted(unseen: Array, wanted: Array, blocks: int, together: bool) -> Array:
    """Share of the torque of each joint that is to be given, 0 .. 1, shape (m,).

    Args:
        unseen: Predictions of samples that were left out, shape (n, m).
        wanted: What they should be, same shape.
        blocks: Pieces of time that were left out, one after another.
        together: One share for all joints.
    """
    u, y, block = unseen, wanted, blocks_of(len(unseen), blocks)

    def sums(values: Array) -> Array:
        of = np.array([values[block == i].sum(axis=0) for i in range(blocks)])
        return np.repeat(of.sum(axis=1)[:, None], u.shape[1], axis=1) if together else of

    share = np.clip(sums(u * y).sum(axis=0) / np.maximum(sums(u * u).sum(axis=0), 1e-300), 0, 1)
    before, after = sums(np.square(y)), sums(np.square(y - share * u))
    gain = 1.0 - after / np.maximum(before, 1e-300)
    error = gain.std(axis=0, ddof=1) / np.sqrt(blocks)
    is_sure = gain.mean(axis=0) > _STUDENT.get(blocks, _NORMAL) * error
    is_worth = after.sum(axis=0) < (1.0 - _LEAST) * before.sum(axis=0)
    return np.asarray(np.where(is_sure & is_worth, share, 0.0))


def _check_start(start: Learned, joints: tuple[str, ...], scene: Scene) -> None:
    """Refuse to go on with a model of another robot."""
    check_robot("--start", start.about, scene.robot)
    if start.about.joints != joints:
        raise DataError(
            f"--start: the model has joints {', '.join(start.about.joints)}, the recording has "
            f"efforts of {', '.join(joints)}"
        )


def _about(
    scene: Scene, kind: str, joints: tuple[str, ...], samples: Samples, start: Learned | None
) -> About:
    """What the model belongs to; an adapted one knows what it learned before, too."""
    seen = np.hstack([samples.q, samples.v])
    low, high = seen.min(axis=0), seen.max(axis=0)
    if start is not None:
        low, high = np.minimum(low, start.about.low), np.maximum(high, start.about.high)
    wide = np.maximum(high - low, 1.0e-6 * max(float((high - low).max()), 1.0e-6))
    middle = 0.5 * (low + high)
    low, high = middle - 0.5 * wide, middle + 0.5 * wide
    return About(kind, scene.name.rpartition("/")[2], joints, low, high, numbers_of(scene.robot))
