"""Networks as functions of their weights; torch is imported here and in `training` only.

Weights of all members of an ensemble stand side by side: their first axis is the member.

    free:       r = T N(x),  x = [(q - c) / s, v / v_s, tanh(v / v_0)], with (a / a_s) where
                accelerations are seen, too
    structured: r = M(q) a + C(q, v) v + dV/dq + friction, each joint with friction of its own

with M = D (L L' + e E) D positive definite, L lower triangular and a network of sin q and cos q
(of which inertias of hinges are made) as V is, and C v = M' v - 1/2 d(v' M v)/dq, which is that of
Christoffel: v' (M' - 2 C) v = 0.

Source: M. Lutter, C. Ritter, J. Peters, Deep Lagrangian Networks, ICLR 2019 (L L').
"""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import torch

from mbd_ros.core.state import Array
from mbd_ros.features.identification.learn.curves import (
    CURVES,
    LEAST_INERTIA,
    curves_of,
    usual_energy,
    usual_inertia,
)
from mbd_ros.features.identification.learn.scales import Samples, Scales

Weights = Mapping[str, Any]
HIDDEN = 32
_FEW = 0.1  # of the usual size: what networks say before they have learned


def free_weights(joints: int, members: int, inputs: int, random: np.random.Generator) -> Weights:
    """First weights of a network without structure."""
    return _layers(members, (inputs, HIDDEN, HIDDEN, joints), random)


def structured_weights(joints: int, members: int, random: np.random.Generator) -> Weights:
    """First weights of a network with structure."""
    outputs = joints * (joints + 1) // 2 + 1  # of L, and V
    found = dict(_layers(members, (2 * joints, HIDDEN, HIDDEN, outputs), random))
    found["friction"] = np.full((members, joints, len(CURVES) + 1), -3.0)  # before softplus
    found["offset"] = np.zeros((members, joints))
    return found


def _layers(members: int, sizes: tuple[int, ...], random: np.random.Generator) -> dict[str, Array]:
    found = {}
    for i, (before, after) in enumerate(pairwise(sizes), 1):
        size = np.sqrt(1.0 / before) * (_FEW if i == len(sizes) - 1 else 1.0)
        found[f"W{i}"] = size * random.normal(size=(members, after, before))
        found[f"b{i}"] = np.zeros((members, after))
    return found


class Free:
    """A network without structure.

    Args:
        scales: Sizes of inputs and outputs.
        accelerations: Whether it sees them.
    """

    def __init__(self, scales: Scales, accelerations: bool = False) -> None:
        self.scales, self.accelerations = scales, accelerations

    def inputs(self, samples: Samples) -> tuple[Any, ...]:
        """What `torque` takes of samples."""
        s = self.scales
        parts = [(samples.q - s.centre) / s.q, samples.v / s.v, np.tanh(samples.v / s.slow)]
        if self.accelerations:
            parts.append(samples.a / s.a)
        return (torch.as_tensor(np.hstack(parts)),)

    def torque(self, w: Weights, x: Any) -> Any:
        """Torque over its scale of each member, shape (members, n, m)."""
        h = torch.tanh(torch.einsum("ehx,nx->enh", w["W1"], x) + w["b1"][:, None])
        h = torch.tanh(torch.einsum("ekh,enh->enk", w["W2"], h) + w["b2"][:, None])
        return torch.einsum("emk,enk->enm", w["W3"], h) + w["b3"][:, None]


class Structured:
    """A network of friction and of a Lagrangian.

    Args:
        scales: Sizes of inputs and outputs.
    """

    def __init__(self, scales: Scales) -> None:
        self.scales = scales
        m = len(scales.q)
        self._rows, self._columns = np.tril_indices(m)
        self.inertia = torch.as_tensor(usual_inertia(scales))
        self._lever = torch.as_tensor(scales.torque)
        self.energy = usual_energy(scales)

    def inputs(self, samples: Samples) -> tuple[Any, ...]:
        """What `torque` takes of samples."""
        return tuple(map(torch.as_tensor, (samples.q, samples.v, samples.a)))

    def torque(self, w: Weights, q: Any, v: Any, a: Any) -> Any:
        """Torque over its scale of each member, shape (members, n, m)."""
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
        turned = torch.einsum("enij,ni->enj", L, u)  # L' u
        Ldot = torch.einsum("enijk,nk->enij", dL, v)
        inertial = torch.einsum("enij,enj->eni", L, torch.einsum("enij,ni->enj", L, b))
        inertial = inertial + LEAST_INERTIA * b
        rate = torch.einsum("enij,enj->eni", Ldot, turned)
        rate = rate + torch.einsum("enij,enj->eni", L, torch.einsum("enij,ni->enj", Ldot, u))
        half = torch.einsum("enijk,ni,enj->enk", dL, u, turned)
        whole = D * (inertial + rate) - half + self.energy * slope[..., -1, :]
        return whole / self._lever + self._friction(w, v)

    def _matrix(self, entries: Any) -> Any:
        """Lower triangles of their entries, the third axis."""
        m = len(self.scales.q)
        found = torch.zeros((*entries.shape[:2], m, m, *entries.shape[3:]), dtype=entries.dtype)
        found[:, :, self._rows, self._columns] = entries
        return found

    def _friction(self, w: Weights, v: Any) -> Any:
        weights = torch.nn.functional.softplus(w["friction"])
        curves = torch.as_tensor(curves_of(v.numpy(), self.scales))
        return torch.einsum("emc,nmc->enm", weights, curves) + w["offset"][:, None]
