"""Ensembles of networks, fitted side by side; each member stops early on a block it never sees."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import torch

from mbd_ros.core.state import Array
from mbd_ros.features.identification.learn.network import Weights
from mbd_ros.features.identification.learn.scales import Samples
from mbd_ros.features.identification.learn.trust import blocks_of

_DECAY = 1.0e-3  # of weights
_LOOK = 10  # steps between looks at the block that is left out


class Collocation(NamedTuple):
    """States without a measurement, at which the equations of motion hold all the same.

    Attributes:
        samples: The states.
        wanted: What the equations ask of the network there over its scale, shape (n, m).
        weight: Of this loss beside the data.
    """

    samples: Samples
    wanted: Array
    weight: float


class Plan(NamedTuple):
    """How a network is fitted.

    Attributes:
        steps: Of Adam, all samples in each.
        rank: Of the matrices that are added to frozen weights; 0 fits all weights.
        hold: Penalty on what is added.
        seed: Of the random numbers.
        rate: First learning rate.
        leaves_out: Whether members leave a block out and stop early on it; where there are few
            trials all of them learn from all, for all steps.
    """

    steps: int = 600
    rank: int = 0
    hold: float = 0.0
    seed: int = 0
    rate: float = 1.0e-2
    leaves_out: bool = True


class Trained(NamedTuple):
    """A fitted ensemble.

    Attributes:
        weights: Of all members.
        unseen: What members say of the block that they never saw, over the scale, shape (n, m).
    """

    weights: dict[str, Array]
    unseen: Array


def train(
    network: Any,
    weights: Weights,
    samples: Samples,
    wanted: Array,
    plan: Plan,
    collocation: Collocation | None = None,
    tell: Callable[[float], None] = lambda share: None,
) -> Trained:
    """Fit all members.

    Args:
        network: As in `network`.
        weights: First weights.
        samples: What is learned from.
        wanted: Torque over its scale, shape (n, m).
        plan: How.
        collocation: States at which the equations of motion are asked besides.
        tell: Is told the share that is done.
    """
    torch.manual_seed(plan.seed)
    torch.set_num_threads(1)
    members = len(weights["W1"])
    left_out = blocks_of(samples.count, members) == np.arange(members)[:, None]
    left_out &= plan.leaves_out
    x, y = network.inputs(samples), torch.as_tensor(wanted)
    states = None if collocation is None else network.inputs(collocation.samples)
    seen, unseen = (torch.as_tensor(mask)[..., None] / 1.0 for mask in (~left_out, left_out))
    fixed, moved = _started(weights, plan)
    optimizer = torch.optim.AdamW(
        list(moved.values()), lr=plan.rate, weight_decay=0.0 if plan.rank else _DECAY
    )
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, plan.steps)
    best = _Best(members)
    for step in range(plan.steps + 1):
        current = _whole(fixed, moved, plan)
        square = (network.torque(current, *x) - y) ** 2
        if step % _LOOK == 0 and (plan.leaves_out or step == plan.steps):
            best.look(_mean(square.detach(), unseen), current)
            tell(step / plan.steps)
        loss = _mean(square, seen).sum()
        if collocation is not None:
            asked = network.torque(current, *states) - torch.as_tensor(collocation.wanted)
            loss = loss + collocation.weight * (asked**2).mean(dim=(1, 2)).sum()
        if plan.hold:
            loss = loss + plan.hold * sum((value**2).sum() for value in moved.values())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    with torch.no_grad():
        kept = {key: torch.as_tensor(value) for key, value in best.weights.items()}
        said = network.torque(kept, *x).numpy()
    return Trained(best.weights, np.einsum("enm,en->nm", said, left_out.astype(np.float64)))


def _mean(square: Any, mask: Any) -> Any:
    """Mean of each member over the samples of its mask, shape (members,)."""
    return (square * mask).sum(dim=(1, 2)) / (mask.sum(dim=(1, 2)) * square.shape[2]).clamp(min=1)


def _started(weights: Weights, plan: Plan) -> tuple[dict[str, Any], dict[str, Any]]:
    """What stays, and what is fitted: all weights, or factors of what is added to matrices."""
    given = {key: torch.tensor(np.asarray(value)) for key, value in weights.items()}
    if not plan.rank:
        return {}, {key: value.requires_grad_() for key, value in given.items()}
    random, moved = np.random.default_rng(plan.seed), {}
    for key, value in given.items():
        if value.ndim != 3:
            continue
        members, after, before = value.shape
        A = random.normal(size=(members, plan.rank, before)) / np.sqrt(before)
        moved[f"{key}.A"] = torch.tensor(A, requires_grad=True)
        B = torch.zeros((members, after, plan.rank), dtype=torch.float64)
        moved[f"{key}.B"] = B.requires_grad_()
    return given, moved


def _whole(fixed: Mapping[str, Any], moved: Mapping[str, Any], plan: Plan) -> dict[str, Any]:
    """The weights of the network."""
    if not plan.rank:
        return dict(moved)
    found = dict(fixed)
    for key in fixed:
        if f"{key}.A" in moved:
            found[key] = fixed[key] + moved[f"{key}.B"] @ moved[f"{key}.A"]
    return found


class _Best:
    """The weights of each member when it did best on the block that it never saw."""

    def __init__(self, members: int) -> None:
        self.weights: dict[str, Array] = {}
        self._loss = np.full(members, np.inf)

    def look(self, loss: Any, weights: Mapping[str, Any]) -> None:
        """Keep members that do better now."""
        better = loss.numpy() < self._loss
        self._loss[better] = loss.numpy()[better]
        for key, value in weights.items():
            own = self.weights.setdefault(key, value.detach().numpy().copy())
            own[better] = value.detach().numpy()[better]
