"""Modes of exact rows and surfaces that begin together."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.events.surface_modes import MOST_SURFACES, equivalent_signs
from mbd_ros.core.optimization.box_qp import exchanged
from mbd_ros.core.state import Array, Mode
from mbd_ros.core.thresholds import TIE
from mbd_ros.errors import SolveError

_SAME = 1.0e-6  # signs that give the same motion


class Together(NamedTuple):
    """How rows and surfaces answer multipliers lam and signs s.

        w = w0 + A lam + P s,   h' = r + E lam + D s

    Attributes:
        w0: Shape (m,).
        A: Shape (m, m).
        P: Shape (m, k).
        r: Shape (k,).
        E: Shape (k, m).
        D: Shape (k, k).
        lower: Smallest multipliers, shape (m,).
        upper: Largest multipliers, shape (m,).
    """

    w0: Array
    A: Array
    P: Array
    r: Array
    E: Array
    D: Array
    lower: Array
    upper: Array


def modes_of(given: Together, names: Sequence[str]) -> tuple[Mode, Mode]:
    """The only modes in which rows and surfaces go on, rows first.

    The sides of the surfaces are tried one after the other, as by `surface_modes.mode_on`; the
    rows beside each choice are one complementarity problem.

    Args:
        given: How they answer.
        names: Of the surfaces.

    Raises:
        SolveError: There are none, or several.
    """
    k = len(given.r)
    if k > MOST_SURFACES:
        raise SolveError(f"{k} switching surfaces at once ({', '.join(names)})")
    cases = sorted(itertools.product((0, 1, -1), repeat=k), key=lambda mode: -mode.count(0))
    found = [
        (answer, ways) for ways in cases if (answer := _answer(given, ways, names)) is not None
    ]
    where = f"switching surface {', '.join(names)} beside rows"
    if not found:
        raise SolveError(f"{where}: no solution goes on")
    (signs, rows), ways = found[0]
    if any(np.abs(other - signs).max() > _SAME for (other, _), _ in found[1:]):
        raise SolveError(f"{where}: the solution is not unique")
    return rows, ways


def _answer(given: Together, ways: Mode, names: Sequence[str]) -> tuple[Array, Mode] | None:
    """Signs and modes of the rows for one choice of sides; None where it contradicts itself."""
    w0, A, P, r, E, D, lower, upper = given
    s = np.array(ways, dtype=np.float64)
    slides = s == 0.0
    try:
        per_lam = _solved(D, E, slides, names)
        free = _solved(D, (r + D.dot(s))[:, None], slides, names)[:, 0]
    except SolveError:
        return None
    P_on = P[:, slides]
    whole, rest = A + P_on.dot(per_lam), w0 + P.dot(s) + P_on.dot(free)
    if (whole.diagonal() <= TIE * A.diagonal()).any():  # rows that these surfaces hold already
        return None
    lam = exchanged(whole, rest, lower, upper)
    if lam is None:
        return None
    s[slides] = free + per_lam.dot(lam)
    rates, terms = r + E.dot(lam) + D.dot(s), np.abs(r) + np.abs(D).sum(axis=1)
    held = np.abs(s).max(initial=0.0) <= 1.0 + TIE
    leaves = (np.array(ways) * rates)[~slides] >= -TIE * terms[~slides]
    if not (held and leaves.all()):
        return None
    w, slack = whole.dot(lam) + rest, TIE * (np.abs(whole).dot(np.abs(lam)) + np.abs(rest))
    rows = np.where(w > slack, 1, np.where(w < -slack, -1, 0))
    return s, tuple(rows.tolist())


def _solved(D: Array, right: Array, slides: Array, names: Sequence[str]) -> Array:
    """Signs of the surfaces that are slid on for rates that they have to end, one a column."""
    on = np.flatnonzero(slides).tolist()
    if not on:
        return np.zeros((0, right.shape[1]))
    block, titles = D[np.ix_(on, on)], [names[i] for i in on]
    columns = [equivalent_signs(column, block, titles) for column in right[on].T]
    return np.array(columns).T.reshape(len(on), right.shape[1])
