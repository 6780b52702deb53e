"""Corrections of inertias, friction and stiffness: adapters that are linear in torque.

Of everything that a model has learned from, the triangle of a QR factorisation is kept: that is
all that samples say of linear numbers. New samples are put below it. The prior of each number is
that its torque is 0, with a deviation that makes what was measured most likely.

Source: D. MacKay, Neural Computation 4, 1992, 415 (evidence of a prior).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.model.inertial_parameters import COUNT, moving_bodies, parameters_of
from mbd_ros.core.state import Array
from mbd_ros.features.identification.learn.training_samples import (
    FINE_CURVES,
    Samples,
    Scales,
    curves_of,
)
from mbd_ros.features.identification.regressor import Regressor, base_parameters, random_states
from mbd_ros.methods.learned import About
from mbd_ros.scene.built_scene import Scene

_STATES = 100  # random ones, to tell which numbers a motion can show
_PRIORS = (0.01, 0.03, 0.1, 0.3)  # of the usual torque: deviations of that of a number
_LEAST = 1.0e-4  # of the usual torque: the smallest deviation of what is measured
_FIRST = 0.05  # of the usual torque: deviation of what is measured, before the fit says it
_ALIKE = 0.98  # the largest correlation of neighbours
_ROUNDS = 3  # deviations follow from the fit, and the fit from them
_SMALLEST = 0.1  # of the inertia of a motion: what is left of it at least


class Columns:
    """Columns of base parameters, friction and stiffness, of the joints of a model.

    Args:
        joints: Names, in the order of the model.
        scales: Of the model.
    """

    def __init__(self, scene: Scene, joints: Sequence[str], scales: Scales) -> None:
        self._regressor = Regressor(scene.robot, scene.inverse_dynamics())
        self._scales, self._joints = scales, tuple(joints)
        self._mine = [self._regressor.labels.index(name) for name in joints]
        self._states = random_states(scene.robot, scene.couplings, _STATES)
        rows = self._regressor.rows(*self._states)[:, self._mine]
        self._chosen = base_parameters(rows.reshape(-1, rows.shape[2])).chosen
        self._bodies = [body.name for body in moving_bodies(scene.robot)]
        self._given = parameters_of(scene.robot.model).ravel()

    def of(self, samples: Samples) -> Array:
        """Torque of a unit of each number, shape (n, m, p)."""
        inertial = self._regressor.rows(samples.y, samples.w, samples.push)
        curves = curves_of(samples.v, self._scales, FINE_CURVES)
        n, m, size = curves.shape
        own = np.zeros((n, m, m, size + 2))  # of each joint: curves, stiffness, offset
        for j in range(m):
            own[:, j, j, :size], own[:, j, j, size + 1] = curves[:, j], 1.0
            own[:, j, j, size] = samples.q[:, j] - self._scales.centre[j]
        rows = inertial[:, self._mine][:, :, self._chosen]
        return np.concatenate([rows, own.reshape(n, m, -1)], axis=2)

    def torque(self, samples: Samples, numbers: Array) -> Array:
        """Torque of the numbers [N·m or N], shape (n, m)."""
        if not numbers.any():
            return np.zeros_like(samples.q)
        return np.asarray(self.of(samples) @ numbers)

    def none(self) -> Array:
        """Numbers that change nothing, shape (p,)."""
        return np.zeros(len(self._chosen) + len(self._joints) * (len(FINE_CURVES) + 3))

    def known(self, samples: Samples, said: Array) -> Known:
        """What samples say, with efforts as measured: a low-pass would round dry friction.

        Args:
            said: Torque of the network, shape (n, m).
        """
        left = samples.measured - samples.physics
        whole = np.concatenate([self.of(samples), left[..., None], said[..., None]], axis=2)
        k = whole.shape[2]
        R = np.zeros((whole.shape[1], k, k))
        for j, rows in enumerate(whole.transpose(1, 0, 2)):
            found = np.linalg.qr(rows, mode="r")
            R[j, : len(found)] = found
        usual = np.sqrt(np.mean(np.square(samples.measured), axis=0))
        usual = np.maximum(usual, _LEAST * max(float(usual.max()), 1.0e-300))
        plain = Known(R, np.full(len(R), float(samples.count)), usual)
        independent = _independent(plain, whole)
        return Known(R * np.sqrt(independent)[:, None, None], plain.count * independent, usual)

    def written(self, said: About, numbers: Array) -> About:
        """The corrections as a file has them."""
        r, m = len(self._chosen), len(self._joints)
        inertial = np.zeros(self._regressor.size)
        inertial[self._chosen] = numbers[:r]
        ten = inertial.reshape(-1, COUNT)
        bodies = {name: ten[i].tolist() for i, name in enumerate(self._bodies) if ten[i].any()}
        friction, springs = {}, {}
        for j, own in enumerate(numbers[r:].reshape(m, len(FINE_CURVES) + 3)):
            bends = self._scales.v[j] * np.array(FINE_CURVES)
            pairs = np.column_stack([own[: len(FINE_CURVES)], bends]).ravel()
            viscous = own[len(FINE_CURVES)] / self._scales.v[j]
            friction[self._joints[j]] = [float(own[-1]), float(viscous), *pairs.tolist()]
            springs[self._joints[j]] = [float(own[-2]), float(self._scales.centre[j])]
        return said._replace(bodies=bodies, friction=friction, stiffness=springs)

    def possible(self, numbers: Array) -> Array:
        """The same numbers, inertias drawn to 0 until every motion has inertia."""
        found, r = numbers.copy(), len(self._chosen)
        added = np.zeros(self._regressor.size)
        added[self._chosen] = numbers[:r]
        y, w, _ = self._states
        units = np.eye(w.shape[1])
        rows = np.array([self._regressor.rows(y, 0.0 * w, 0.0 * w + unit) for unit in units])
        rows -= self._regressor.rows(y, 0.0 * w, 0.0 * w)
        M, more = (np.moveaxis(rows @ values, 0, 2) for values in (self._given, added))
        least = 0.0
        for own, other in zip(M, more, strict=True):
            try:
                L = np.linalg.cholesky(own)
            except np.linalg.LinAlgError:  # something moves that has no inertia
                continue
            turned = np.linalg.solve(L, np.linalg.solve(L, other).T)
            least = min(least, float(np.linalg.eigvalsh(0.5 * (turned + turned.T))[0]))
        found[:r] *= min(1.0, (1.0 - _SMALLEST) / max(-least, 1.0e-300))
        return found


class Known(NamedTuple):
    """What samples say of linear numbers.

    Attributes:
        triangle: Of each joint R of [columns, torque, torque of the network], shape (m, k, k).
        count: Independent samples of each joint, shape (m,).
        usual: Root mean square of the efforts [N·m or N], shape (m,).
    """

    triangle: Array
    count: Array
    usual: Array

    def and_also(self, other: Known) -> Known:
        """What both say; sizes are those of the first."""
        both = np.concatenate([self.triangle, other.triangle], axis=1)
        return Known(np.linalg.qr(both, mode="r"), self.count + other.count, self.usual)


def _independent(known: Known, rows: Array) -> Array:
    """Share of the samples that say something of their own, of each joint, shape (m,).

    What a fit leaves of neighbours is alike: with a correlation r of one to the next, n samples
    are worth n (1 - r) / (1 + r).
    """
    p = rows.shape[2] - 2
    ways = [(rows[..., p] - w * rows[..., p + 1], fitted(known, w)) for w in (False, True)]
    left = min((b - rows[..., :p] @ numbers for b, numbers in ways), key=np.linalg.norm)
    square = np.maximum(np.square(left).sum(axis=0), 1.0e-300)
    r = np.clip((left[1:] * left[:-1]).sum(axis=0) / square, 0.0, _ALIKE)
    return np.asarray((1.0 - r) / (1.0 + r))


def fitted(known: Known, with_network: bool) -> Array:
    """Linear numbers that make the torques most likely, shape (p,).

    Args:
        known: What samples say.
        with_network: Whether the network acts beside them.
    """
    p, usual = known.triangle.shape[2] - 2, known.usual[:, None]
    A = known.triangle[:, :, :p] / usual[..., None]
    b = known.triangle[:, :, p] - with_network * known.triangle[:, :, p + 1]
    b = b / usual
    size = np.sqrt(np.square(A).sum(axis=(0, 1)) / known.count.sum())
    size = np.maximum(size, 1.0e-9 * float(size.max(initial=1.0e-300)))
    A = A / size
    squares, slopes = A.transpose(0, 2, 1) @ A, np.einsum("mkp,mk->mp", A, b)
    weight = np.full(len(b), 1.0 / _FIRST**2)
    for _ in range(_ROUNDS):
        numbers = _most_likely(np.tensordot(weight, squares, axes=1), weight @ slopes)
        left = np.square(b - A @ numbers).sum(axis=1) / known.count
        weight = 1.0 / np.maximum(left, _LEAST**2)
    return np.asarray(numbers / size)


def _most_likely(square: Array, slope: Array) -> Array:
    """Numbers x under the prior with the largest evidence; of A x = b with unit noise.

    Args:
        square: A' A, shape (p, p).
        slope: A' b, shape (p,).
    """
    values, V = np.linalg.eigh(square)
    along = V.T @ slope
    noise = [1.0 + prior**2 * np.maximum(values, 0.0) for prior in _PRIORS]
    evidence = [
        np.sum(prior**2 * np.square(along) / one) - np.sum(np.log(one))
        for prior, one in zip(_PRIORS, noise, strict=True)
    ]
    best = int(np.argmax(evidence))
    found: Array = V @ (_PRIORS[best] ** 2 / noise[best] * along)
    return found
