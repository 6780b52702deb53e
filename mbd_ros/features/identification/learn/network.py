"""Networks as functions of their weights, and their training; no other module imports torch.

Weights of all members of an ensemble are stacked along their first axis.

    free:       r = T N(x),  x = [(q - c) / s, v / v_s, tanh(v / v_0)], with (a / a_s) where
                accelerations are inputs, too
    structured: r = M(q) a + C(q, v) v + dV/dq + friction, with separate friction of each joint

M = D (L L' + e E) D is positive definite. The lower triangular L and the energy V are networks of
sin q and cos q, of which inertias of hinges are made. C v = M' v - 1/2 d(v' M v)/dq is that of
Christoffel, so v' (M' - 2 C) v = 0.

All members are trained at once; each of them stops early on a block of time that it never sees.

Source: M. Lutter, C. Ritter, J. Peters, Deep Lagrangian Networks, ICLR 2019 (L L').
"""

from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import torch

from mbd_ros.core.state import Array
from mbd_ros.features.identification.learn.training_samples import (
    CURVES,
    LEAST_INERTIA,
    Samples,
    Scales,
    blocks_of,
    energy_scale,
    friction_curves,
    inertia_scale,
)

Weights = Mapping[str, Any]
HIDDEN = 32
_FIRST_OUTPUT = 0.1  # of the scale: size of the outputs of untrained networks
_DECAY = 1.0e-3  # of weights
_VALIDATION_INTERVAL = 10  # steps between evaluations of the block that is left out


class Structured:
    """A network of a Lagrangian and of friction.

    Args:
        scales: Sizes of inputs and outputs.
    """

    def __init__(self, scales: Scales) -> None:
        self.scales = scales
        m = len(scales.q)
        self._rows, self._columns = np.tril_indices(m)
        self.inertia = torch.as_tensor(inertia_scale(scales))
        self._lever = torch.as_tensor(scales.torque)
        self.energy = energy_scale(scales)

    def inputs(self, samples: Samples) -> tuple[Any, ...]:
        """Return the arguments of `torque` at samples."""
        return tuple(map(torch.as_tensor, (samples.q, samples.v, samples.a)))

    def torque(self, w: Weights, q: Any, v: Any, a: Any) -> Any:
        """Return the torque of each member over its scale, shape (members, n, m)."""
        D, m = self.inertia, len(self.scales.q)
        sine, cosine = torch.sin(q), torch.cos(q)
        x = torch.cat([sine, cosine], dim=1)
        h = torch.tanh(torch.einsum("ehx,nx->enh", w["W1"], x) + w["b1"][:, None])
        J = w["W1"][:, None, :, :m] * cosine[:, None] - w["W1"][:, None, :, m:] * sine[:, None]
        J = (1.0 - h * h)[..., None] * J
        g = torch.tanh(torch.einsum("ekh,enh->enk", w["W2"], h) + w["b2"][:, None])
        J = (1.0 - g * g)[..., None] * torch.einsum("ekh,enhx->enkx", w["W2"], J)
        out = torch.einsum("eok,enk->eno", w["W3"], g) + w["b3"][:, None]
        slope = torch.einsum("eok,enkx->enox", w["W3"], J)
        L, dL = self._matrix(out[..., :-1]), self._matrix(slope[..., :-1, :])
        u, b = D * v, D * a
        Lt_u = torch.einsum("enij,ni->enj", L, u)  # L' u
        Ldot = torch.einsum("enijk,nk->enij", dL, v)
        inertial = torch.einsum("enij,enj->eni", L, torch.einsum("enij,ni->enj", L, b))
        inertial = inertial + LEAST_INERTIA * b
        rate = torch.einsum("enij,enj->eni", Ldot, Lt_u)
        rate = rate + torch.einsum("enij,enj->eni", L, torch.einsum("enij,ni->enj", Ldot, u))
        half = torch.einsum("enijk,ni,enj->enk", dL, u, Lt_u)
        total = D * (inertial + rate) - half + self.energy * slope[..., -1, :]
        return total / self._lever + self._friction(w, v)

    def _matrix(self, entries: Any) -> Any:
        """Return lower triangular matrices from their entries along the third axis."""
        m = len(self.scales.q)
        L = torch.zeros((*entries.shape[:2], m, m, *entries.shape[3:]), dtype=entries.dtype)
        L[:, :, self._rows, self._columns] = entries
        return L

    def _friction(self, w: Weights, v: Any) -> Any:
        weights = torch.nn.functional.softplus(w["friction"])
        curves = torch.as_tensor(friction_curves(v.numpy(), self.scales))
        return torch.einsum("emc,nmc->enm", weights, curves) + w["offset"][:, None]


class Free:
    """A network without structure.

    Args:
        scales: Sizes of inputs and outputs.
        accelerations: Whether accelerations are inputs.
    """

    def __init__(self, scales: Scales, accelerations: bool = False) -> None:
        self.scales = scales
        self.accelerations = accelerations

    def inputs(self, samples: Samples) -> tuple[Any, ...]:
        """Return the arguments of `torque` at samples."""
        s = self.scales
        parts = [(samples.q - s.centre) / s.q, samples.v / s.v, np.tanh(samples.v / s.slow)]
        if self.accelerations:
            parts.append(samples.a / s.a)
        return (torch.as_tensor(np.hstack(parts)),)

    def torque(self, w: Weights, x: Any) -> Any:
        """Return the torque of each member over its scale, shape (members, n, m)."""
        h = torch.tanh(torch.einsum("ehx,nx->enh", w["W1"], x) + w["b1"][:, None])
        h = torch.tanh(torch.einsum("ekh,enh->enk", w["W2"], h) + w["b2"][:, None])
        return torch.einsum("emk,enk->enm", w["W3"], h) + w["b3"][:, None]


def make_network(kind: str, scales: Scales, accelerations: bool = False) -> "Structured | Free":
    """Return a network of a kind: structured or free."""
    return Structured(scales) if kind == "structured" else Free(scales, accelerations)


def first_weights(
    kind: str, m: int, members: int, random: np.random.Generator, accelerations: bool = False
) -> Mapping[str, Array]:
    """Return the initial weights of all members of a network of a kind."""
    if kind == "structured":
        return structured_weights(m, members, random)
    return free_weights(m, members, (4 if accelerations else 3) * m, random)


def structured_weights(joints: int, members: int, random: np.random.Generator) -> Weights:
    """Return the initial weights of a network with structure."""
    outputs = joints * (joints + 1) // 2 + 1  # of L, and V
    weights = dict(_layers(members, (2 * joints, HIDDEN, HIDDEN, outputs), random))
    weights["friction"] = np.full((members, joints, len(CURVES) + 1), -3.0)  # before softplus
    weights["offset"] = np.zeros((members, joints))
    return weights


def _layers(members: int, sizes: tuple[int, ...], random: np.random.Generator) -> dict[str, Array]:
    weights = {}
    for i, (before, after) in enumerate(pairwise(sizes), 1):
        size = np.sqrt(1.0 / before) * (_FIRST_OUTPUT if i == len(sizes) - 1 else 1.0)
        weights[f"W{i}"] = size * random.normal(size=(members, after, before))
        weights[f"b{i}"] = np.zeros((members, after))
    return weights


def free_weights(joints: int, members: int, inputs: int, random: np.random.Generator) -> Weights:
    """Return the initial weights of a network without structure."""
    return _layers(members, (inputs, HIDDEN, HIDDEN, joints), random)


def mean_torque(network: Any, weights: Mapping[str, Array], samples: Samples) -> Array:
    """Return the mean torque of the members [N·m or N], shape (n, m)."""
    with torch.no_grad():
        w = {key: torch.as_tensor(value) for key, value in weights.items()}
        mean: Array = network.torque(w, *network.inputs(samples)).mean(dim=0).numpy()
    return mean * network.scales.torque


class TrainingPlan(NamedTuple):
    """Options of the training of a network.

    Attributes:
        steps: Steps of Adam, with all samples in each.
        rank: Rank of the matrices that are added to frozen weights; 0 trains all weights.
        hold: Penalty on what is added.
        seed: Seed of the random numbers.
        rate: Initial learning rate.
        leaves_out: Whether members leave a block out and stop early on it. With few samples, all
            members are trained with all samples for all steps.
    """

    steps: int = 600
    rank: int = 0
    hold: float = 0.0
    seed: int = 0
    rate: float = 1.0e-2
    leaves_out: bool = True


class Collocation(NamedTuple):
    """States without a measurement at which the network must satisfy the equations of motion.

    Attributes:
        samples: The states.
        target: Required torque of the network over its scale, shape (n, m).
        weight: Weight of this loss relative to that of the data.
    """

    samples: Samples
    target: Array
    weight: float


def train(
    network: Any,
    weights: Weights,
    samples: Samples,
    target: Array,
    plan: TrainingPlan,
    collocation: Collocation | None = None,
    tell: Callable[[float], None] = lambda share: None,
) -> tuple[dict[str, Array], Array]:
    """Train all members.

    Args:
        network: `Free` or `Structured`.
        samples: Training samples.
        target: Torque over its scale, shape (n, m).
        collocation: States at which the equations of motion must hold; None for none.
        tell: Receives the share of the work that is done.

    Returns:
        Weights of all members, and the predictions of members for the blocks that they never saw,
        over the scale, shape (n, m).
    """
    torch.manual_seed(plan.seed)
    torch.set_num_threads(1)
    members = len(weights["W1"])
    left_out = blocks_of(samples.count, members) == np.arange(members)[:, None]
    left_out &= plan.leaves_out
    x, y = network.inputs(samples), torch.as_tensor(target)
    states = None if collocation is None else network.inputs(collocation.samples)
    training_mask, validation_mask = (
        torch.as_tensor(mask)[..., None] / 1.0 for mask in (~left_out, left_out)
    )
    fixed, moved = _initial_parameters(weights, plan)
    optimizer = torch.optim.AdamW(
        list(moved.values()), lr=plan.rate, weight_decay=0.0 if plan.rank else _DECAY
    )
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, plan.steps)
    best = _EarlyStopping(members)
    for step in range(plan.steps + 1):
        current = _network_weights(fixed, moved, plan)
        square = (network.torque(current, *x) - y) ** 2
        if step % _VALIDATION_INTERVAL == 0 and (plan.leaves_out or step == plan.steps):
            best.update(_mean(square.detach(), validation_mask), current)
            tell(step / plan.steps)
        loss = _mean(square, training_mask).sum()
        if collocation is not None:
            error = network.torque(current, *states) - torch.as_tensor(collocation.target)
            loss = loss + collocation.weight * (error**2).mean(dim=(1, 2)).sum()
        if plan.hold:
            loss = loss + plan.hold * sum((value**2).sum() for value in moved.values())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    with torch.no_grad():
        w = {key: torch.as_tensor(value) for key, value in best.weights.items()}
        predicted = network.torque(w, *x).numpy()
    return best.weights, np.einsum("enm,en->nm", predicted, left_out.astype(np.float64))


def _initial_parameters(
    weights: Weights, plan: TrainingPlan
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return frozen and trained parameters: all weights, or low-rank factors of an addition."""
    all_weights = {key: torch.tensor(np.asarray(value)) for key, value in weights.items()}
    if not plan.rank:
        return {}, {key: value.requires_grad_() for key, value in all_weights.items()}
    random, moved = np.random.default_rng(plan.seed), {}
    for key, value in all_weights.items():
        if value.ndim != 3:
            continue
        members, after, before = value.shape
        A = random.normal(size=(members, plan.rank, before)) / np.sqrt(before)
        moved[f"{key}.A"] = torch.tensor(A, requires_grad=True)
        B = torch.zeros((members, after, plan.rank), dtype=torch.float64)
        moved[f"{key}.B"] = B.requires_grad_()
    return all_weights, moved


class _EarlyStopping:
    """Weights of each member when its error on the block that it never saw was smallest."""

    def __init__(self, members: int) -> None:
        self.weights: dict[str, Array] = {}
        self._loss = np.full(members, np.inf)

    def update(self, loss: Any, weights: Mapping[str, Any]) -> None:
        """Store the weights of members that have improved."""
        better = loss.numpy() < self._loss
        self._loss[better] = loss.numpy()[better]
        for key, value in weights.items():
            stored = self.weights.setdefault(key, value.detach().numpy().copy())
            stored[better] = value.detach().numpy()[better]


def _network_weights(
    fixed: Mapping[str, Any], moved: Mapping[str, Any], plan: TrainingPlan
) -> dict[str, Any]:
    """Return the weights of the network."""
    if not plan.rank:
        return dict(moved)
    weights = dict(fixed)
    for key in fixed:
        if f"{key}.A" in moved:
            weights[key] = fixed[key] + moved[f"{key}.B"] @ moved[f"{key}.A"]
    return weights


def _mean(square: Any, mask: Any) -> Any:
    """Return the mean of each member over the samples of its mask, shape (members,)."""
    return (square * mask).sum(dim=(1, 2)) / (mask.sum(dim=(1, 2)) * square.shape[2]).clamp(min=1)
