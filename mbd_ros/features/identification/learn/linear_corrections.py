"""Linear corrections of inertias, friction and stiffness, which adapt a learned model.

Of all training samples, only the triangular factor of a QR factorization is stored, because it
contains all that the samples tell about linear parameters. New samples are appended to it. The
prior torque of each parameter is 0, with the standard deviation that makes the data most likely.

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
    friction_curves,
)
from mbd_ros.features.identification.regressor import Regressor, base_parameters, random_states
from mbd_ros.methods.learned_model import About
from mbd_ros.scene.built_scene import Scene

_STATES = 100  # random states that tell which parameters motions can show
_PRIORS = (0.01, 0.03, 0.1, 0.3)  # of the RMS torque: standard deviations of the prior
_LEAST = 1.0e-4  # of the RMS torque: the smallest standard deviation of measurements
_FIRST = 0.05  # of the RMS torque: initial standard deviation of measurements
_ALIKE = 0.98  # the largest correlation of neighbours
_ROUNDS = 3  # alternations of fit and standard deviations
_SMALLEST = 0.1  # of the inertia of a motion: the least that corrections leave


class Columns:
    """Columns of base parameters, friction and stiffness, of the joints of a model.

    Args:
        joints: Names, in the order of the model.
        scales: Scales of the model.
    """

    def __init__(self, scene: Scene, joints: Sequence[str], scales: Scales) -> None:
        self._regressor = Regressor(scene.robot, scene.inverse_dynamics())
        self._scales = scales
        self._joints = tuple(joints)
        self._rows = [self._regressor.labels.index(name) for name in joints]
        self._states = random_states(scene.robot, scene.couplings, _STATES)
        rows = self._regressor.rows(*self._states)[:, self._rows]
        self._choose_adapters = base_parameters(rows.reshape(-1, rows.shape[2])).chosen
        self._bodies = [body.name for body in moving_bodies(scene.robot)]
        self._nominal = parameters_of(scene.robot.model).ravel()

    def of(self, samples: Samples) -> Array:
        """Return the torque of a unit of each parameter, shape (n, m, p)."""
        inertial = self._regressor.rows(samples.y, samples.w, samples.push)
        curves = friction_curves(samples.v, self._scales, FINE_CURVES)
        n, m, size = curves.shape
        joint_columns = np.zeros((n, m, m, size + 2))  # of each joint: curves, stiffness, offset
        for j in range(m):
            joint_columns[:, j, j, :size] = curves[:, j]
            joint_columns[:, j, j, size + 1] = 1.0
            joint_columns[:, j, j, size] = samples.q[:, j] - self._scales.centre[j]
        rows = inertial[:, self._rows][:, :, self._choose_adapters]
        return np.concatenate([rows, joint_columns.reshape(n, m, -1)], axis=2)

    def torque(self, samples: Samples, numbers: Array) -> Array:
        """Return the torque of corrections [N·m or N], shape (n, m)."""
        if not numbers.any():
            return np.zeros_like(samples.q)
        return np.asarray(self.of(samples) @ numbers)

    def none(self) -> Array:
        """Return corrections that change nothing, shape (p,)."""
        return np.zeros(len(self._choose_adapters) + len(self._joints) * (len(FINE_CURVES) + 3))

    def statistics(self, samples: Samples, network: Array) -> SampleStatistics:
        """Return the statistics of samples.

        They use efforts without the low-pass, which would round dry friction.

        Args:
            network: Torque of the network, shape (n, m).
        """
        error = samples.measured - samples.physics
        rows = np.concatenate([self.of(samples), error[..., None], network[..., None]], axis=2)
        k = rows.shape[2]
        R = np.zeros((rows.shape[1], k, k))
        for j, joint_rows in enumerate(rows.transpose(1, 0, 2)):
            factor = np.linalg.qr(joint_rows, mode="r")
            R[j, : len(factor)] = factor
        rms = np.sqrt(np.mean(np.square(samples.measured), axis=0))
        rms = np.maximum(rms, _LEAST * max(float(rms.max()), 1.0e-300))
        plain = SampleStatistics(R, np.full(len(R), float(samples.count)), rms)
        independent = _independent(plain, rows)
        return SampleStatistics(
            R * np.sqrt(independent)[:, None, None], plain.count * independent, rms
        )

    def describe(self, about: About, numbers: Array) -> About:
        """Return a description of the model that contains the corrections."""
        r, m = len(self._choose_adapters), len(self._joints)
        inertial = np.zeros(self._regressor.size)
        inertial[self._choose_adapters] = numbers[:r]
        ten = inertial.reshape(-1, COUNT)
        bodies = {name: ten[i].tolist() for i, name in enumerate(self._bodies) if ten[i].any()}
        friction, springs = {}, {}
        for j, values in enumerate(numbers[r:].reshape(m, len(FINE_CURVES) + 3)):
            bends = self._scales.v[j] * np.array(FINE_CURVES)
            pairs = np.column_stack([values[: len(FINE_CURVES)], bends]).ravel()
            viscous = values[len(FINE_CURVES)] / self._scales.v[j]
            friction[self._joints[j]] = [float(values[-1]), float(viscous), *pairs.tolist()]
            springs[self._joints[j]] = [float(values[-2]), float(self._scales.centre[j])]
        return about._replace(bodies=bodies, friction=friction, stiffness=springs)

    def limit(self, numbers: Array) -> Array:
        """Return corrections with inertias reduced until the mass matrix is positive definite."""
        limited, r = numbers.copy(), len(self._choose_adapters)
        added = np.zeros(self._regressor.size)
        added[self._choose_adapters] = numbers[:r]
        y, w, _ = self._states
        units = np.eye(w.shape[1])
        rows = np.array([self._regressor.rows(y, 0.0 * w, 0.0 * w + unit) for unit in units])
        rows -= self._regressor.rows(y, 0.0 * w, 0.0 * w)
        M, dM = (np.moveaxis(rows @ values, 0, 2) for values in (self._nominal, added))
        least = 0.0
        for M_i, dM_i in zip(M, dM, strict=True):
            try:
                L = np.linalg.cholesky(M_i)
            except np.linalg.LinAlgError:  # a joint moves no mass
                continue
            relative = np.linalg.solve(L, np.linalg.solve(L, dM_i).T)
            least = min(least, float(np.linalg.eigvalsh(0.5 * (relative + relative.T))[0]))
        limited[:r] *= min(1.0, (1.0 - _SMALLEST) / max(-least, 1.0e-300))
        return limited


class SampleStatistics(NamedTuple):
    """Statistics of samples that determine linear corrections.

    Attributes:
        triangle: Factor R of [columns, torque, torque of the network] of each joint, (m, k, k).
        count: Number of independent samples of each joint, shape (m,).
        usual: Root mean square of the efforts [N·m or N], shape (m,).
    """

    triangle: Array
    count: Array
    usual: Array

    def merge(self, other: SampleStatistics) -> SampleStatistics:
        """Return the statistics of both sets of samples, with the efforts of the first."""
        both = np.concatenate([self.triangle, other.triangle], axis=1)
        return SampleStatistics(np.linalg.qr(both, mode="r"), self.count + other.count, self.usual)


def _independent(known: SampleStatistics, rows: Array) -> Array:
    """Return the number of independent samples per sample for each joint, shape (m,).

    Residuals of neighbours are correlated: with a correlation r from one to the next, n samples
    are worth n (1 - r) / (1 + r).
    """
    p = rows.shape[2] - 2
    fits = [
        (rows[..., p] - w * rows[..., p + 1], solve_corrections(known, w)) for w in (False, True)
    ]
    error = min((b - rows[..., :p] @ numbers for b, numbers in fits), key=np.linalg.norm)
    square = np.maximum(np.square(error).sum(axis=0), 1.0e-300)
    r = np.clip((error[1:] * error[:-1]).sum(axis=0) / square, 0.0, _ALIKE)
    return np.asarray((1.0 - r) / (1.0 + r))


def solve_corrections(known: SampleStatistics, uses_network: bool) -> Array:
    """Return the corrections that make the torques most likely, shape (p,).

    Args:
        known: Statistics of the samples.
        uses_network: Whether the torque of the network is added to the corrections.
    """
    p, usual = known.triangle.shape[2] - 2, known.usual[:, None]
    A = known.triangle[:, :, :p] / usual[..., None]
    b = known.triangle[:, :, p] - uses_network * known.triangle[:, :, p + 1]
    b = b / usual
    size = np.sqrt(np.square(A).sum(axis=(0, 1)) / known.count.sum())
    size = np.maximum(size, 1.0e-9 * float(size.max(initial=1.0e-300)))
    A = A / size
    squares, slopes = A.transpose(0, 2, 1) @ A, np.einsum("mkp,mk->mp", A, b)
    weight = np.full(len(b), 1.0 / _FIRST**2)
    for _ in range(_ROUNDS):
        numbers = _most_likely(np.tensordot(weight, squares, axes=1), weight @ slopes)
        variance = np.square(b - A @ numbers).sum(axis=1) / known.count
        weight = 1.0 / np.maximum(variance, _LEAST**2)
    return np.asarray(numbers / size)


def _most_likely(square: Array, slope: Array) -> Array:
    """Solve A x = b with unit noise, under the prior with the largest evidence.

    Args:
        square: A' A, shape (p, p).
        slope: A' b, shape (p,).
    """
    values, V = np.linalg.eigh(square)
    along = V.T @ slope
    noise = [1.0 + prior**2 * np.maximum(values, 0.0) for prior in _PRIORS]
    evidence = [
        np.sum(prior**2 * np.square(along) / variance) - np.sum(np.log(variance))
        for prior, variance in zip(_PRIORS, noise, strict=True)
    ]
    best = int(np.argmax(evidence))
    x: Array = V @ (_PRIORS[best] ** 2 / noise[best] * along)
    return x
