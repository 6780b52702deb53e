"""Physically consistent inertial parameters near those of the description and the data.

    min  1/2 |A [T p; f] - b|^2 + 1/2 sum |Z_i - E|^2,   P_i(p) = L_i Z_i L_i',   P0_i = L_i L_i'

over inertial parameters p and friction f, with Z_i >= 0.001 E and f not negative. P is the
pseudo-inertia of a body and P0 that of its description. The bound keeps the density of each body
positive. A deviation by the whole of a body costs as much as one standard deviation of the data.

Source: P. M. Wensing, S. Kim, J.-J. E. Slotine, IEEE Robot. Autom. Lett. 3, 2018, 60 (the cone);
T. Lee, P. M. Wensing, F. C. Park, IEEE Trans. Robot. 36, 2020, 168 (the distance).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.model.inertial_parameters import (
    COUNT,
    Body,
    inertia_of,
    is_consistent,
    pseudo_inertia,
)
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import TINY
from mbd_ros.errors import DataError, SolveError, install_hint

_LEAST_BODY = 1.0e-3  # of the pseudo-inertia of the description: the least that remains
_LIGHT = 1.0e-2  # of the mean body: added to bodies without mass
_DATA_WEIGHTS = (1.0, 0.1, 0.01, 1.0e-3, 1.0e-4)  # tried in turn until the solver succeeds
_CONE_SLACK = 1.0e-5  # by which a solution may miss the cones, relative to the problem
_FRICTION_WEIGHT = 1.0e-9  # of the weight of bodies: only the data determine friction
_SIDE = 4  # rows of P
_UPPER = [(i, j) for j in range(_SIDE) for i in range(j + 1)]


def fit_consistent_bodies(
    A: Array, b: Array, T: Array, nominal: Array, is_signed: NDArray[np.bool_]
) -> ConsistentBodies:
    """Solve the optimization problem in the docstring of this module.

    Args:
        A: Weighted rows, base parameters first, then friction; shape (k, r + f).
        b: Weighted torques, shape (k,).
        T: Matrix from inertial to base parameters, shape (r, p).
        nominal: Inertial parameters of the description, shape (bodies, 10).
        is_signed: Friction that must not be negative, shape (f,).

    Raises:
        DataError: The solver is not installed.
        SolveError: The solver finds no optimum.
    """
    r, bodies = len(T), len(nominal)
    maps = _maps(nominal)
    to_p = np.zeros((COUNT * bodies, COUNT * bodies))
    for i, M in enumerate(maps):
        to_p[COUNT * i : COUNT * (i + 1), COUNT * i : COUNT * (i + 1)] = M
    rows = np.hstack([A[:, :r] @ T @ to_p, A[:, r:]])
    scale = np.linalg.norm(A[:, r:], axis=0)
    scale[scale == 0.0] = 1.0
    rows[:, COUNT * bodies :] /= scale
    identity = np.tile(_svec(np.eye(_SIDE)), bodies)
    prior = np.full(rows.shape[1], _FRICTION_WEIGHT)
    prior[: len(identity)] = 1.0
    target = np.concatenate([identity, np.zeros(len(prior) - len(identity))])
    signed = len(identity) + np.flatnonzero(is_signed)
    x = _solve_with_fallback(rows, b, np.diag(prior), target, signed)
    z = x[: len(identity)].reshape(bodies, COUNT)
    inertial = np.array([M @ z_i for M, z_i in zip(maps, z, strict=True)])
    deviation = np.linalg.norm(z - identity.reshape(bodies, COUNT), axis=1)
    return ConsistentBodies(inertial, x[len(identity) :] / scale, deviation)


class ConsistentBodies(NamedTuple):
    """Physically consistent bodies, and the friction that belongs to them.

    Attributes:
        inertial: Inertial parameters of all bodies, shape (bodies, 10).
        friction: Friction of all joints, one after the other, shape (f,).
        deviation: |Z_i - E| of each body; 1 is a deviation by the whole body, shape (bodies,).
    """

    inertial: Array
    friction: Array
    deviation: Array


def _maps(nominal: Array) -> list[Array]:
    """Return for each body the matrix from svec(Z) to inertial parameters, shape (10, 10)."""
    pseudo_inertias = np.array([pseudo_inertia(numbers) for numbers in nominal])
    heavy = [P for P in pseudo_inertias if np.linalg.eigvalsh(P)[0] > 0.0]
    mean = _diagonal(np.mean(heavy, axis=0)) if heavy else np.diag([0.01, 0.01, 0.01, 1.0])
    light = _LIGHT if heavy else 1.0  # nothing is known of a description without any mass
    units = [pseudo_inertia(unit) for unit in np.eye(COUNT)]
    of_numbers = np.array([_svec(unit) for unit in units]).T
    maps = []
    for P in pseudo_inertias:
        size = np.sqrt(np.diag(mean))
        least = np.linalg.eigvalsh(P / np.outer(size, size))[0]
        L = np.linalg.cholesky(P if least > _LIGHT**3 else _regularized(P, light * mean))
        of_z = np.array([_svec(L @ _matrix(unit) @ L.T) for unit in np.eye(COUNT)]).T
        maps.append(np.linalg.solve(of_numbers, of_z))
    return maps


def _diagonal(P: Array) -> Array:
    """Return P without the products of mass and centre."""
    return np.diag(np.diag(P))


def _svec(S: Array) -> Array:
    """Return the upper triangle by columns, off-diagonals times sqrt 2, shape (10,)."""
    return np.array([S[i, j] * (1.0 if i == j else np.sqrt(2.0)) for i, j in _UPPER])


def _regularized(P: Array, light: Array) -> Array:
    """Return a positive definite pseudo-inertia: the positive part of P plus a light body."""
    values, vectors = np.linalg.eigh(P)
    positive = vectors @ np.diag(np.maximum(values, 0.0)) @ vectors.T
    regularized: Array = positive + light
    return regularized


def _matrix(s: Array) -> Array:
    """Return the symmetric matrix of a vector from `_svec`."""
    S = np.zeros((_SIDE, _SIDE))
    for value, (i, j) in zip(s, _UPPER, strict=True):
        S[i, j] = S[j, i] = value / (1.0 if i == j else np.sqrt(2.0))
    return S


def _solve_with_fallback(
    A: Array, b: Array, prior: Array, target: Array, signed: NDArray[np.intp]
) -> Array:
    """Return the optimum, with less weight on the data where the solver fails otherwise.

    Args:
        A: Rows of the data, shape (k, n).
        b: Right-hand side of the data, shape (k,).
        prior: Rows of the prior, shape (n, n).
        target: Right-hand side of the prior, shape (n,); ones of bodies come first.
        signed: Indices of numbers that must not be negative.

    Raises:
        SolveError: There is no optimum for any weight of the data.
    """
    bodies = int((target == 1.0).sum()) // _SIDE
    for weight in _DATA_WEIGHTS:
        rows, b_all = np.concatenate([weight * A, prior]), np.concatenate([weight * b, target])
        try:
            return _solve(rows, b_all, bodies, signed)
        except SolveError:
            if weight == _DATA_WEIGHTS[-1]:
                raise
    raise SolveError("no physically consistent inertias were found")


def _solve(A: Array, b: Array, bodies: int, signed: NDArray[np.intp]) -> Array:
    """Return the x within the cones that minimizes |A x - b|.

    With A = Q R and x = x0 + R^-1 u, where x0 is the least-squares solution, it belongs to the
    shortest u. That problem is well conditioned even if the data determine some parameters much
    better than others.

    Args:
        A: Rows of full column rank, shape (k, n).
        b: Right-hand side, shape (k,).
        bodies: Number of bodies; x begins with ten numbers of each.
        signed: Indices of numbers that must not be negative.
    """
    Q, R = np.linalg.qr(A)
    x0 = np.linalg.solve(R, Q.T @ b)
    m = COUNT * bodies
    least = _LEAST_BODY * np.tile(_svec(np.eye(_SIDE)), bodies)
    eigenvalues = [np.linalg.eigvalsh(_matrix(z))[0] for z in x0[:m].reshape(bodies, COUNT)]
    if min(eigenvalues, default=1.0) >= _LEAST_BODY and (x0[signed] >= 0.0).all():
        return np.asarray(x0)
    back = np.linalg.solve(R, np.eye(len(x0)))
    rows = -np.concatenate([back[:m], back[signed]])
    bound = np.concatenate([x0[:m] - least, x0[signed]])
    x = np.asarray(x0 + back @ _shortest_in_cones(rows, bound, bodies, len(signed)))
    x[:m] = np.concatenate([_project_into_cone(z) for z in x[:m].reshape(bodies, COUNT)])
    x[signed] = np.maximum(x[signed], 0.0)
    return x


def _shortest_in_cones(rows: Array, bound: Array, bodies: int, signed: int) -> Array:
    """Return the shortest u with bound - rows u in the cones, by an interior-point method.

    Raises:
        DataError: The solver is not installed.
        SolveError: The solver finds no u.
    """
    try:
        import clarabel
    except ImportError as error:
        raise DataError(install_hint("clarabel")) from error
    from scipy import sparse

    blocks = [slice(COUNT * i, COUNT * (i + 1)) for i in range(bodies)]
    blocks += [slice(k, k + 1) for k in range(COUNT * bodies, COUNT * bodies + signed)]
    scale = np.ones(len(rows))  # scaling a cone does not change it
    for block in blocks:
        scale[block] = max(float(np.abs(rows[block]).max()), TINY)
    rows, bound = rows / scale[:, None], bound / scale
    size = max(float(np.abs(bound).max(initial=0.0)), 1.0)
    cones = [clarabel.PSDTriangleConeT(_SIDE)] * bodies
    if signed:
        cones.append(clarabel.NonnegativeConeT(signed))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    n = rows.shape[1]
    H, A = sparse.csc_matrix(sparse.identity(n)), sparse.csc_matrix(rows)
    solution = clarabel.DefaultSolver(H, np.zeros(n), A, bound / size, cones, settings).solve()
    u = size * np.array(solution.x)
    slack = bound - rows @ u
    z = slack[: COUNT * bodies].reshape(-1, COUNT)
    eigenvalues = [np.linalg.eigvalsh(_matrix(z_i))[0] for z_i in z]
    worst = min([*eigenvalues, *slack[COUNT * bodies :]], default=0.0)
    if not (np.isfinite(u).all() and worst > -_CONE_SLACK * size):
        raise SolveError(
            "no physically consistent inertias were found: the interior-point solver ended with "
            f"status {solution.status}"
        )
    return u


def _project_into_cone(z: Array) -> Array:
    """Return the nearest point of the cone; interior-point methods may miss it by little."""
    values, vectors = np.linalg.eigh(_matrix(z))
    return _svec(vectors @ np.diag(np.maximum(values, _LEAST_BODY)) @ vectors.T)


def prior_deviation(T: Array, nominal: Array) -> Array:
    """Return the prior standard deviation of base parameters, shape (r,).

    Before any data, each body may deviate by the whole of itself.
    """
    parts = [T[:, COUNT * i : COUNT * (i + 1)] @ M for i, M in enumerate(_maps(nominal))]
    deviation: Array = np.sqrt(np.sum([np.square(part).sum(axis=1) for part in parts], axis=0))
    return deviation


def inertias_of_links(
    robot: Robot, bodies: Sequence[Body], inertial: Array
) -> tuple[dict[str, Any], list[str]]:
    """Distribute the inertias of bodies over their links.

    The first link of a body takes the change. If its inertia became inconsistent, it takes the
    inertia of the entire body, and the links that are fixed to it lose theirs.

    Args:
        inertial: Inertial parameters of the bodies, shape (bodies, 10).

    Returns:
        Link -> `pinocchio.Inertia` in the axes of the link, and remarks for people.
    """
    nominal, inertias, remarks = robot.inertias(), dict[str, Any](), list[str]()
    for body, numbers in zip(bodies, inertial, strict=True):
        places = {name: _placement(robot, name) for name in body.links}
        others = [n for n in body.links[1:] if n in nominal and nominal[n].mass > 0.0]
        remainder = numbers.copy()
        for name in others:
            remainder = remainder - places[name].act(nominal[name]).toDynamicParameters()
        if others and not is_consistent(remainder):
            remainder = numbers
            inertias |= {name: pin.Inertia.Zero() for name in others}
            remarks.append(
                f"{body.name} takes the inertia of {', '.join(others)}, which is fixed to it"
            )
        inertias[body.name] = places[body.name].actInv(inertia_of(remainder))
    return inertias, remarks


def _placement(robot: Robot, link: str) -> pin.SE3:
    """Return the pose of a link in the axes of its joint."""
    return robot.model.frames[robot.frame(link)].placement


def known_parameters(bodies: Sequence[Body], nominal: Array, known: Sequence[str]) -> Array:
    """Return the inertial parameters of known bodies, 0 for all others, shape (10 bodies,).

    Args:
        nominal: Inertial parameters of the description, shape (bodies, 10).
        known: Links whose bodies have the right parameters in the description.

    Raises:
        DataError: A link does not exist or does not move.
    """
    parameters, links = np.zeros_like(nominal), [set(body.links) for body in bodies]
    for name in known:
        indices = [i for i, names in enumerate(links) if name in names]
        if not indices:
            names = ", ".join(body.name for body in bodies)
            raise DataError(f"--known {name}: no link that moves; accepted are {names}")
        parameters[indices[0]] = nominal[indices[0]]
    return parameters.ravel()
