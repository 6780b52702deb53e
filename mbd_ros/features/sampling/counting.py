"""Degrees of freedom, temperatures, and how molecules divide their kinetic energy."""

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import redundant
from mbd_ros.features.sampling.ensemble import Ensemble, Walkers
from mbd_ros.features.sampling.space import Space


def degrees_of_freedom(space: Space, q: Array, conserved: int = 0) -> int:
    """Number of coordinates less the rank of the rows and what else is conserved.

    Args:
        space: The space.
        q: A configuration, shape (size,).
        conserved: Momenta that nothing changes: 3 where the centre of mass keeps its velocity.
    """
    rank = 0
    for block in space.blocks:
        at = block.coordinates
        x = q[:, None] if at is None else q[at]
        mass = space.mass[:, None] if at is None else space.mass[at]
        J = np.moveaxis(block.jacobian(x) / np.sqrt(mass), 2, 0)
        sizes = np.linalg.svd(J, compute_uv=False)
        least = np.sqrt(redundant(sizes.shape[1])) * sizes[:, :1]
        rank += int(np.count_nonzero(sizes > least))
    return space.size - rank - conserved


def temperature(kinetic: Array, degrees: int, boltzmann: float) -> Array:
    """2 K / (f k), shape as `kinetic`."""
    found: Array = kinetic * (2.0 / (degrees * boltzmann))
    return found


def kinetic_parts(masses: Array, x: Array, v: Array) -> Array:
    """Kinetic energy of translation, rotation and what is left of molecules, shape (3, n).

    Rotation is L . I^-1 L / 2 about the centre of mass, with the angular momentum and the inertia
    of the instant: a frame that is tied to one bond counts other motion as rotation.

    Args:
        masses: Shape (atoms,).
        x: Positions, shape (atoms, 3, n).
        v: Velocities.
    """
    m, total = masses[:, None, None], float(masses.sum())
    V = (m * v).sum(axis=0) / total
    r, w = x - (m * x).sum(axis=0) / total, v - V
    L = (m * np.cross(r, w, axis=1)).sum(axis=0)
    unit = np.eye(3)[:, :, None]
    inertia = (m * r * r).sum(axis=(0, 1)) * unit - np.einsum("a,acn,adn->cdn", masses, r, r)
    inverse = np.linalg.pinv(inertia.transpose(2, 0, 1), rcond=1.0e-9, hermitian=True)
    translation = 0.5 * total * (V * V).sum(axis=0)
    rotation = 0.5 * np.einsum("cn,ncd,dn->n", L, inverse, L)
    kinetic = 0.5 * np.einsum("a,acn,acn->n", masses, v, v)
    return np.array([translation, rotation, kinetic - translation - rotation])


def kinetic_after_step(ensemble: Ensemble, at: Walkers, h: float) -> Array:
    """Kinetic energy after a step, as RATTLE and as SHAKE leave it, shape (2, chains).

    SHAKE's velocities keep a part normal to the rows, -h/2 M^-1 J' lam, which carries the energy
    h^2/8 f . M^-1 f, f = J' lam.

    Args:
        ensemble: The ensemble.
        at: States before the step.
        h: The step.
    """
    after, unprojected = ensemble.step(at, h)
    return np.array([ensemble.kinetic(after.v), ensemble.kinetic(unprojected)])
