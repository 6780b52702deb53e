"""Gains of drives: torques of efforts that are in other units, such as motor currents.

    i_j = k_j (X_j b + known_j) + F_j f,    gain_j = 1 / k_j

Bodies b and all k can grow together without a trace in i, unless something is known: a load, a
link, a spring, a measured wrench. Which gains that fixes is what their deviations say.

Source: M. Gautier, S. Briot, J. Dyn. Syst. Meas. Control 136, 2014, 051025 (drive gains of all
joints from a known load).
"""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.features.identification.factors import Triangle
from mbd_ros.features.identification.least_squares import Joint, solved, usual_choice
from mbd_ros.features.identification.problem import Problem
from mbd_ros.jobs.lines import Say

_OPEN = 0.1  # relative deviation of a gain that nothing fixes
_STEPS = 200
_REACH = 5.0  # of log k: how far from what the description says


def estimate_gains(problem: Problem, allowed: Sequence[str], say: Say) -> None:
    """Find the gains that are not given, and take efforts for torques from now on.

    Raises:
        DataError: Names the joints whose gains nothing fixes.
    """
    if (problem.joints < 0).any():
        raise DataError(f"{problem.where}: --currents needs an effort of every joint")
    open_ = np.array([name not in problem.gains for name in problem.labels])
    parts = _parts(problem, allowed)
    start = np.array([_slope(part, problem) for part in parts])
    start[~open_] = 1.0  # their efforts are torques already
    share = 1.0 / (1.0 + 2.0 * float(np.sum(np.square(problem.correlation[1:]))))
    k, deviation = _fitted(parts, problem, start, open_, share)
    names = [n for n, s in zip(problem.labels, deviation, strict=True) if not s < _OPEN]
    if names:
        raise DataError(
            f"{problem.where}: nothing that is known fixes the gains of {', '.join(names)}: "
            "masses and gains are told as ratios only. Record the motion with a known load, too "
            "(--held RECORDING --payload LINK=MASS,CX,CY,CZ), name links that the description "
            "has right (--known LINK ..), or give gains (--gain JOINT=VALUE ..)"
        )
    found = dict(zip(problem.labels, 1.0 / k, strict=True))
    problem.gain({name: found[name] for name in np.array(problem.labels)[open_]})
    problem.gain_deviation = np.abs(deviation / k)
    every = zip(problem.labels, 1.0 / k, problem.gain_deviation, strict=True)
    texts = (f"{name} {gain:.4g} +- {s:.2g}" for name, gain, s in every)
    say(f"torque for a unit of effort: {', '.join(texts)}")


def _parts(problem: Problem, allowed: Sequence[str]) -> list[tuple[Array, ...]]:
    """Of each joint rows of X, F, known and i, as triangles, over the size of what is left."""
    r, triangles = len(problem.base.chosen), list[Triangle]()
    for block in problem.blocks(np.zeros(1)):
        triangles = triangles or [Triangle(r + len(own) + 2) for own in problem.columns]
        for j, triangle in enumerate(triangles):
            known = block.known[:, j, None]
            rows = np.hstack([block.X[:, j], block.F[j], known, block.Y[:, j] + known])
            triangle.add(rows[block.kept[:, j]])
    parts = []
    for triangle, columns in zip(triangles, problem.columns, strict=True):
        R = triangle.close().R
        taken = usual_choice(Joint(R, triangle.rows, 1.0, columns, 1.0), allowed)
        F = R[:, [r + i for i in taken]]
        every = np.hstack([R[:, :r], F, R[:, -2:-1]])
        left = R[:, -1] - every @ solved(every, R[:, -1])[0]
        size = np.linalg.norm(left) / np.sqrt(max(triangle.rows, 1))
        size = max(size, 1e-9 * np.linalg.norm(R[:, -1]) / np.sqrt(max(triangle.rows, 1)), 1e-300)
        parts.append((R[:, :r] / size, F / size, R[:, -2] / size, R[:, -1] / size))
    return parts


def _slope(part: tuple[Array, ...], problem: Problem) -> float:
    """Effort over the torque of the given robot."""
    X, F, known, i = part
    model = X @ problem.base.values(problem.given.ravel()) + known
    found = solved(np.column_stack([model, F]), i)[0]
    return float(found[0]) or 1.0


def _fitted(
    parts: Sequence[tuple[Array, ...]],
    problem: Problem,
    start: Array,
    is_open: Array,
    share: float,
) -> tuple[Array, Array]:
    """The k, and the relative deviation of each that is open."""
    from scipy.optimize import least_squares

    r, m = len(problem.base.chosen), len(parts)
    at = r + m + np.cumsum([0, *(F.shape[1] for _, F, _, _ in parts)])

    def off(x: Array) -> Array:
        k = start * np.exp(x[r : r + m])
        each = zip(parts, k, at, strict=False)
        return np.concatenate(
            [kj * (X @ x[:r] + n) + F @ x[a : a + F.shape[1]] - i for (X, F, n, i), kj, a in each]
        )

    def slopes(x: Array) -> Array:
        k, rows = start * np.exp(x[r : r + m]), []
        for j, ((X, F, n, _), kj, a) in enumerate(zip(parts, k, at, strict=False)):
            row = np.zeros((len(X), len(x)))
            row[:, :r], row[:, a : a + F.shape[1]] = kj * X, F
            row[:, r + j] = is_open[j] * kj * (X @ x[:r] + n)
            rows.append(row)
        return np.concatenate(rows)

    x0 = np.concatenate([problem.base.values(problem.given.ravel()), np.zeros(at[-1] - r)])
    size = 1.0 / np.maximum(np.linalg.norm(slopes(x0), axis=0), 1e-12)
    reach = np.full(len(x0), np.inf)
    reach[r : r + m] = _REACH
    found = least_squares(off, x0, slopes, bounds=(-reach, reach), x_scale=size, max_nfev=_STEPS)
    places = r + np.flatnonzero(is_open)
    s = _deviations(slopes(found.x), places) / np.sqrt(share)
    deviation = np.zeros(m)
    deviation[is_open] = s
    return start * np.exp(found.x[r : r + m]), deviation


def _deviations(J: Array, places: Array) -> Array:
    """Standard deviations of some of the unknowns, inf of those that nothing fixes."""
    norm = np.linalg.norm(J, axis=0)
    kept = np.flatnonzero(norm > 0.0)
    _, s, V = np.linalg.svd(J[:, kept] / norm[kept], full_matrices=False)
    s = np.maximum(s, 1e-9 * s.max(initial=1.0))
    every = np.full(J.shape[1], np.inf)
    every[kept] = np.sqrt(np.sum(np.square(V.T / s), axis=1)) / norm[kept]
    return np.asarray(every[places])
