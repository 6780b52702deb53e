"""Mean force along a held quantity, from its multiplier, and the free energy it belongs to.

Rows s and a held quantity xi have the Jacobian J = (J_s, J_xi), A = J M^-1 J' and Hessians H_c;
with the multiplier of M a = -grad V + J' lam and the motion W = M^-1 J' A^-1 e_xi along which xi
alone changes,

    dA/dxi = <w (lam_xi + kT G)> / <w>,   w = (det A_s / det A)^(1/2)
    G = tr(A^-1 K) - tr(A_s^-1 K_s),      K_ca = (M^-1 J_a') . H_c W

Without other rows these are w = Z^-1/2 and G = grad xi . H grad xi / |grad xi|^4, as in
the sources.
Where rows s are the limit of stiff springs (Fixman), w = det A^(-1/2) and G = tr(A^-1 K).
Masses are constant here. Those of a mechanism are not: V contains the density that they give to
configurations then (`weighted_space`).

Sources: E. A. Carter et al., Chem. Phys. Lett. 156, 1989, 472; M. Sprik, G. Ciccotti, J. Chem.
Phys. 109, 1998, 7737; W. K. den Otter, W. J. Briels, ibid. 109, 1998, 4139.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.features.sampling.averages import Average, average, ratio
from mbd_ros.features.sampling.ensemble import Ensemble, Walkers
from mbd_ros.features.sampling.small_matrices import inverse, log_determinant, solve

_AVERAGED = 60  # coordinates up to which velocities are averaged over and not drawn
_ROUNDED = 1.0e-9  # what differences of Jacobians leave, where samples do not scatter
_NODES = 4  # of the polynomial that is integrated over an interval


class Instant(NamedTuple):
    """What is averaged at states of held chains.

    Attributes:
        weight: w, shape (chains,).
        multiplier: lam_xi; where velocities are averaged over, its mean over them.
        correction: kT G.
    """

    weight: Array
    multiplier: Array
    correction: Array


class MeanForce(NamedTuple):
    """The mean force at a value.

    Attributes:
        level: Value of the held quantity.
        force: dA/dxi, the derivative of the free energy.
        multiplier: The average of the multiplier alone, without weight and correction.
    """

    level: float
    force: Average
    multiplier: Average


def instant(held: Ensemble, at: Walkers, gradient: Array, *, fixman: bool) -> Instant:
    """What is averaged, at states of an ensemble of a `HeldSpace`.

    Args:
        held: The ensemble, without Fixman's potential: weights take care of it.
        at: Its states.
        gradient: Of the potential energy there, shape (size, chains).
        fixman: Whether the other rows are the limit of stiff springs.
    """
    (part,), (place,) = held.manifold.parts, at.places
    B = inverse(place.A)
    bending = _bending(held, at)
    pull = np.einsum("aib,ib->ab", place.D, gradient)
    multiplier = solve(place.A, pull - bending)[-1]
    W = np.einsum("aib,ab->ib", place.D, B[:, -1])
    K = np.einsum("cib,aib->cab", part.turned(at.q, W), place.D)
    G = np.einsum("acb,cab->b", B, K)
    log_weight = -log_determinant(place.A)
    if not fixman and len(B) > 1:
        own = place.A[:-1, :-1]
        G = G - np.einsum("acb,cab->b", inverse(own), K[:-1, :-1])
        log_weight = log_weight + log_determinant(own)
    return Instant(np.exp(0.5 * log_weight), multiplier, held.kT * G)


def _bending(held: Ensemble, at: Walkers) -> Array:
    """The v . H_a v of all rows, their mean over velocities where that is cheap, (m, chains)."""
    ((part,), (place,)), space = (held.manifold.parts, at.places), held.space
    velocities = [at.v]
    if space.size <= _AVERAGED:
        spread = np.sqrt(held.kT / space.mass)
        unit = np.repeat(np.diag(spread)[:, :, None], at.q.shape[1], axis=2)
        velocities = [part.project(place, v) for v in unit]
    total = np.zeros(place.J.shape[::2])
    for v in velocities:
        total += np.einsum("aib,ib->ab", part.turned(at.q, v), v)
    return total


def mean_force(level: float, weight: Array, multiplier: Array, correction: Array) -> MeanForce:
    """The mean force of samples, arrays of shape (chains, samples)."""
    force = ratio(weight * (multiplier + correction), weight)
    rounded = _ROUNDED * float(np.abs(multiplier).mean() + np.abs(correction).mean())
    force = force._replace(error=float(np.hypot(force.error, rounded)))
    return MeanForce(level, force, average(multiplier))


class Profile(NamedTuple):
    """Free energy at the values, 0 at the first one.

    Attributes:
        energy: Shape (values,).
        errors: Standard errors of the differences to the first one.
    """

    energy: Array
    errors: Array


def free_energy(forces: Sequence[MeanForce]) -> Profile:
    """Thermodynamic integration of mean forces, each interval by a cubic through its neighbours.

    Args:
        forces: At values that rise or fall.
    """
    levels = np.array([one.level for one in forces])
    means, errors = (np.array([one.force[i] for one in forces]) for i in (0, 1))
    S = _integrals(levels)
    return Profile(S.dot(means), np.sqrt((S**2).dot(errors**2)))


def _integrals(x: Array) -> Array:
    """Matrix that integrates values from the first node to each, shape (n, n)."""
    n = len(x)
    S, size = np.zeros((n, n)), min(_NODES, n)
    for k in range(n - 1):
        first = min(max(k - 1, 0), n - size)
        near = slice(first, first + size)
        middle, half = 0.5 * (x[k] + x[k + 1]), 0.5 * (x[k + 1] - x[k])
        powers = np.arange(size)
        integral = half * (1.0 - (-1.0) ** (powers + 1)) / (powers + 1)
        columns = np.vander((x[near] - middle) / half, size, increasing=True)
        S[k + 1] = S[k]
        S[k + 1, near] += np.linalg.solve(columns.T, integral)
    return S
