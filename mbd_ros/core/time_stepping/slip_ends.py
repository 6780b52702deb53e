"""Slips that end within a step of velocities.

Friction holds a contact at the end of a step. Where its slip ends early in the step, that friction
would push along the way that is left of it, and do work: such a step is divided where the slip
ends. Where slips are too slow for that, contacts go their way with the slips at the end of the
step, so that friction only ever takes energy.
"""

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.core.time_stepping.step_problem import StepProblem
from mbd_ros.core.time_stepping.unilateral_rows import Slots

WORK = 1.0e-11  # of the kinetic energy: work of friction that is none
_SLIGHT = 1.0e-4  # of what friction adds to a slip in a step: one that has ended before
_DEPENDENT = 1.0e-12  # of the largest singular value: rows that depend on others
_SEEN = 0.1  # of a slip, which must be left for its end to be foretold


def turned(problem: StepProblem, end: Array, impulses: Array) -> Slots | None:
    """Tangents of contacts whose friction would do work, among the rows of all; None without any.

    Args:
        problem: That of the step.
        end: Velocity at its end, shape (nv,).
        impulses: Of all rows [N·s], shape (m,).
    """
    tangents = problem.acting.tangents
    if not len(tangents):
        return None
    before, after = _slips(problem, end, tangents)
    push = impulses[problem.acting.at[tangents]].reshape(-1, 2)
    gains = dots(before + after, push) > WORK * problem.speed(problem.free) ** 2
    if not gains.any():
        return None
    added = problem.response.loose[tangents].reshape(-1, 2).max(axis=1) * np.sqrt(dots(push, push))
    gains &= dots(before, before) > np.square(_SLIGHT * added)
    chosen: Slots = problem.acting.at[tangents].reshape(-1, 2)[gains].ravel()
    return chosen if len(chosen) else None


def given_back(problem: StepProblem, end: Array, impulses: Array) -> Array | None:
    """What is taken from the way of a step, shape (nv,); None where friction does no work.

    With it contacts have gone (h s+) along their tangents instead of h ((1 - theta) s + theta s+),
    s the slips at the start and s+ those at the end, moved the least in the mass metric. Friction
    p, which is against s+, then takes the energy -p . s+ + (s+ - s) . A^-1 (s+ - s) / 2 >= 0.

    Args:
        problem: That of the step.
        end: Velocity at its end, shape (nv,).
        impulses: Of all rows [N·s], shape (m,).
    """
    acting, tangents = problem.acting, problem.acting.tangents
    if not len(tangents):
        return None
    before, after = _slips(problem, end, tangents)
    push = impulses[acting.at[tangents]].reshape(-1, 2)
    least = WORK * problem.speed(problem.free) ** 2
    if float(dots(before + after, push).sum()) <= least:
        return None
    touching = impulses[acting.at[tangents[::2] - 1]] > 0.0
    rows = np.column_stack((tangents[::2] - 1, tangents[::2], tangents[1::2]))[touching].ravel()
    late = np.column_stack((np.zeros(len(before)), before - after))[touching].ravel()
    X, A = problem.response.X[:, rows], problem.response.A[np.ix_(rows, rows)]
    scale = 1.0 / np.sqrt(np.maximum(A.diagonal(), np.finfo(float).tiny))
    moved = np.linalg.lstsq(scale[:, None] * A * scale, scale * late, rcond=_DEPENDENT)[0]
    way: Array = (1.0 - problem.theta) * problem.h * X.dot(scale * moved)
    return way


def ending(turned: Slots, problem: StepProblem, end: Array) -> float:
    """When the first of some slips ends if it goes on as in a short step [s]; 0 if one has ended.

    Args:
        turned: Tangents of contacts, among the rows of all.
        problem: That of the short step.
        end: Velocity at its end, shape (nv,).
    """
    tangents = np.flatnonzero(np.isin(problem.acting.at, turned))
    if not len(tangents):
        return 0.0
    before, after = _slips(problem, end, tangents)
    size, left = dots(before, before), dots(before, after)
    if not (left > _SEEN * size).all():
        return 0.0
    with np.errstate(divide="ignore"):  # a slip that does not end
        parts = size / np.maximum(size - left, 0.0)
    return problem.h * float(parts.min())


def _slips(problem: StepProblem, end: Array, tangents: NDArray[np.intp]) -> tuple[Array, Array]:
    """Slips at the start and at the end of a step [m/s], shape (n, 2) each."""
    after = problem.J[tangents].dot(end) + problem.offset[tangents]
    return problem.rate[tangents].reshape(-1, 2), after.reshape(-1, 2)


def dots(a: Array, b: Array) -> Array:
    """Products of vectors, shape (n,)."""
    return np.einsum("ij,ij->i", a, b)
