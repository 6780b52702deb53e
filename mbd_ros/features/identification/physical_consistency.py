"""Inertial numbers that bodies can have, near those given and as the data ask.

    min  1/2 |A [T p; f] - b|^2 + 1/2 sum |Z_i - E|^2,   P_i(p) = L_i Z_i L_i',   P0_i = L_i L_i'

over inertial numbers p and friction f, with Z_i >= 0.001 E and friction not negative. P is the
pseudo-inertia: each body stays one of positive density, and a deviation by all of it costs as much
as one standard deviation of the data.

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

_LEAST_BODY = 1.0e-3  # of the given pseudo-inertia: what is left of a body
_LIGHT = 1.0e-2  # of the usual body: what one without mass counts as beside others
_BLUNTER = (1.0, 0.1, 0.01, 1.0e-3, 1.0e-4)  # factors of the weight of the data
_CONE_SLACK = 1.0e-5  # of the sizes at hand: by how much a solver may miss the cones
_FRICTION_WEIGHT = 1.0e-9  # of the weight of bodies: friction is as the data say
_SIDE = 4  # of P
_UPPER = [(i, j) for j in range(_SIDE) for i in range(j + 1)]


def consistent(
    A: Array, b: Array, T: Array, given: Array, is_signed: NDArray[np.bool_]
) -> Consistent:
    """The optimum of the problem of this module.

    Args:
        A: Weighted rows, base parameters first, then friction; shape (k, r + f).
        b: Weighted torques, shape (k,).
        T: Base parameters of inertial numbers, shape (r, p).
        given: Inertial numbers of the description, shape (bodies, 10).
        is_signed: Friction that is not negative, shape (f,).

    Raises:
        DataError: The solver is not installed.
        SolveError: It finds no optimum.
    """
    r, bodies = len(T), len(given)
    maps = _maps(given)
    to_p = np.zeros((COUNT * bodies, COUNT * bodies))
    for i, M in enumerate(maps):
        to_p[COUNT * i : COUNT * (i + 1), COUNT * i : COUNT * (i + 1)] = M
    whole = np.hstack([A[:, :r] @ T @ to_p, A[:, r:]])
    scale = np.linalg.norm(A[:, r:], axis=0)
    scale[scale == 0.0] = 1.0
    whole[:, COUNT * bodies :] /= scale
    one = np.tile(_svec(np.eye(_SIDE)), bodies)
    prior = np.full(whole.shape[1], _FRICTION_WEIGHT)
    prior[: len(one)] = 1.0
    known = np.concatenate([one, np.zeros(len(prior) - len(one))])
    signed = len(one) + np.flatnonzero(is_signed)
    x = _within_reach(whole, b, np.diag(prior), known, signed)
    z = x[: len(one)].reshape(bodies, COUNT)
    inertial = np.array([M @ own for M, own in zip(maps, z, strict=True)])
    away = np.linalg.norm(z - one.reshape(bodies, COUNT), axis=1)
    return Consistent(inertial, x[len(one) :] / scale, away)


class Consistent(NamedTuple):
    """Numbers that bodies can have.

    Attributes:
        inertial: Of all bodies, shape (bodies, 10).
        friction: Of all joints together.
        deviation: |Z_i - E| of each body: 1 is a deviation by all of it, shape (bodies,).
    """

    inertial: Array
    friction: Array
    deviation: Array


def _maps(given: Array) -> list[Array]:
    """Of every body the matrix that makes inertial numbers of svec(Z), shape (10, 10)."""
    every = np.array([pseudo_inertia(numbers) for numbers in given])
    heavy = [P for P in every if np.linalg.eigvalsh(P)[0] > 0.0]
    usual = _bare(np.mean(heavy, axis=0)) if heavy else np.diag([0.01, 0.01, 0.01, 1.0])
    light = _LIGHT if heavy else 1.0  # nothing is known of a description without any mass
    units = [pseudo_inertia(unit) for unit in np.eye(COUNT)]
    of_numbers = np.array([_svec(unit) for unit in units]).T
    maps = []
    for P in every:
        size = np.sqrt(np.diag(usual))
        least = np.linalg.eigvalsh(P / np.outer(size, size))[0]
        L = np.linalg.cholesky(P if least > _LIGHT**3 else _lifted(P, light * usual))
        of_z = np.array([_svec(L @ _matrix(unit) @ L.T) for unit in np.eye(COUNT)]).T
        maps.append(np.linalg.solve(of_numbers, of_z))
    return maps


def _bare(P: Array) -> Array:
    """Without the product of mass and centre: about the mass centre of all."""
    return np.diag(np.diag(P))


def _svec(S: Array) -> Array:
    """Upper triangle by columns, those off the diagonal by sqrt 2, shape (10,)."""
    return np.array([S[i, j] * (1.0 if i == j else np.sqrt(2.0)) for i, j in _UPPER])


def _lifted(P: Array, light: Array) -> Array:
    """A pseudo-inertia that is none, or nearly, made one by a light body around it."""
    values, vectors = np.linalg.eigh(P)
    kept = vectors @ np.diag(np.maximum(values, 0.0)) @ vectors.T
    lifted: Array = kept + light
    return lifted


def _matrix(s: Array) -> Array:
    """Inverse of `_svec`."""
    S = np.zeros((_SIDE, _SIDE))
    for value, (i, j) in zip(s, _UPPER, strict=True):
        S[i, j] = S[j, i] = value / (1.0 if i == j else np.sqrt(2.0))
    return S


def _within_reach(
    A: Array, b: Array, prior: Array, known: Array, signed: NDArray[np.intp]
) -> Array:
    """The optimum; where data are too sharp for the solver, they are taken for blunter.

    Args:
        A: Rows of the data, shape (k, n).
        b: Shape (k,).
        prior: Rows that hold without data, shape (n, n).
        known: Their right side, shape (n,); ones of bodies come first.
        signed: Places of numbers that are not negative.

    Raises:
        SolveError: However blunt they are, there is no optimum.
    """
    bodies = int((known == 1.0).sum()) // _SIDE
    for blunt in _BLUNTER:
        rows, wanted = np.concatenate([blunt * A, prior]), np.concatenate([blunt * b, known])
        try:
            return _solve(rows, wanted, bodies, signed)
        except SolveError:
            if blunt == _BLUNTER[-1]:
                raise
    raise SolveError("no consistent inertias")


def _solve(A: Array, b: Array, bodies: int, signed: NDArray[np.intp]) -> Array:
    """The x nearest to A x = b within the cones.

    With A = Q R and x = x0 + R^-1 u, x0 the least squares, it is the shortest u: well
    conditioned, however well the data tell one thing and how badly another.

    Args:
        A: Rows of full column rank, shape (k, n).
        b: Shape (k,).
        bodies: How many; ten numbers of each come first.
        signed: Places of numbers that are not negative.
    """
    Q, R = np.linalg.qr(A)
    x0 = np.linalg.solve(R, Q.T @ b)
    m = COUNT * bodies
    least = _LEAST_BODY * np.tile(_svec(np.eye(_SIDE)), bodies)
    sides = [np.linalg.eigvalsh(_matrix(z))[0] for z in x0[:m].reshape(bodies, COUNT)]
    if min(sides, default=1.0) >= _LEAST_BODY and (x0[signed] >= 0.0).all():
        return np.asarray(x0)
    back = np.linalg.solve(R, np.eye(len(x0)))
    rows = -np.concatenate([back[:m], back[signed]])
    bound = np.concatenate([x0[:m] - least, x0[signed]])
    x = np.asarray(x0 + back @ _shortest(rows, bound, bodies, len(signed)))
    x[:m] = np.concatenate([_inside(z) for z in x[:m].reshape(bodies, COUNT)])
    x[signed] = np.maximum(x[signed], 0.0)
    return x


def _shortest(rows: Array, bound: Array, bodies: int, signed: int) -> Array:
    """The shortest u with bound - rows u in the cones, by an interior-point method.

    Raises:
        DataError: The solver is not installed.
        SolveError: It finds none.
    """
    try:
        import clarabel
    except ImportError as error:
        raise DataError(install_hint("clarabel")) from error
    from scipy import sparse

    blocks = [slice(COUNT * i, COUNT * (i + 1)) for i in range(bodies)]
    blocks += [slice(k, k + 1) for k in range(COUNT * bodies, COUNT * bodies + signed)]
    scale = np.ones(len(rows))  # a cone is the same in other units
    for own in blocks:
        scale[own] = max(float(np.abs(rows[own]).max()), TINY)
    rows, bound = rows / scale[:, None], bound / scale
    size = max(float(np.abs(bound).max(initial=0.0)), 1.0)
    cones = [clarabel.PSDTriangleConeT(_SIDE)] * bodies
    if signed:
        cones.append(clarabel.NonnegativeConeT(signed))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    n = rows.shape[1]
    H, A = sparse.csc_matrix(sparse.identity(n)), sparse.csc_matrix(rows)
    found = clarabel.DefaultSolver(H, np.zeros(n), A, bound / size, cones, settings).solve()
    u = size * np.array(found.x)
    left = bound - rows @ u
    sides = [np.linalg.eigvalsh(_matrix(z))[0] for z in left[: COUNT * bodies].reshape(-1, COUNT)]
    worst = min([*sides, *left[COUNT * bodies :]], default=0.0)
    if not (np.isfinite(u).all() and worst > -_CONE_SLACK * size):
        raise SolveError(f"no consistent inertias: the solver ends with {found.status}")
    return u


def _inside(z: Array) -> Array:
    """The nearest numbers of a body, which an interior-point method misses by little."""
    values, vectors = np.linalg.eigh(_matrix(z))
    return _svec(vectors @ np.diag(np.maximum(values, _LEAST_BODY)) @ vectors.T)


def prior_deviation(T: Array, given: Array) -> Array:
    """Standard deviation of base parameters before any data, all of a body wide, shape (r,)."""
    own = [T[:, COUNT * i : COUNT * (i + 1)] @ M for i, M in enumerate(_maps(given))]
    deviation: Array = np.sqrt(np.sum([np.square(one).sum(axis=1) for one in own], axis=0))
    return deviation


def inertias_of_links(
    robot: Robot, bodies: Sequence[Body], inertial: Array
) -> tuple[dict[str, Any], list[str]]:
    """Inertias of the links that make bodies with given numbers.

    The heaviest link of a body takes the change; where no body of its own would be left of it,
    it takes all and those that are fixed to it lose theirs.

    Args:
        inertial: Their numbers, shape (bodies, 10).

    Returns:
        Link -> inertia in the axes of the link, and remarks.
    """
    given, found, said = robot.inertias(), dict[str, Any](), list[str]()
    for body, numbers in zip(bodies, inertial, strict=True):
        places = {name: _placement(robot, name) for name in body.links}
        others = [n for n in body.links[1:] if n in given and given[n].mass > 0.0]
        left = numbers.copy()
        for name in others:
            left = left - places[name].act(given[name]).toDynamicParameters()
        if others and not is_consistent(left):
            left = numbers
            found |= {name: pin.Inertia.Zero() for name in others}
            said.append(f"{body.name} takes the inertia of {', '.join(others)}, fixed to it")
        found[body.name] = places[body.name].actInv(inertia_of(left))
    return found, said


def _placement(robot: Robot, link: str) -> Any:
    """Pose of a link in the axes of its joint."""
    return robot.model.frames[robot.frame(link)].placement


def known_numbers(bodies: Sequence[Body], given: Array, known: Sequence[str]) -> Array:
    """Inertial numbers of bodies with links that are known, 0 of others, shape (10 bodies,).

    Raises:
        DataError: No such link.
    """
    found, links = np.zeros_like(given), [set(body.links) for body in bodies]
    for name in known:
        at = [i for i, own in enumerate(links) if name in own]
        if not at:
            names = ", ".join(body.name for body in bodies)
            raise DataError(f"--known {name}: no link that moves; there are {names}")
        found[at[0]] = given[at[0]]
    return found.ravel()
