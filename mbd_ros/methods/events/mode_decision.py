"""In which modes switches go on: one complementarity problem an event."""

import itertools
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.contact_modes.event_rows import ExactRows
from mbd_ros.core.contact_modes.row_distances import Reach
from mbd_ros.core.optimization.box_qp import exchanged
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.core.thresholds import TIE
from mbd_ros.errors import SolveError
from mbd_ros.methods.events.mode_field import ModeField
from mbd_ros.methods.events.switching_surfaces import MOST_SURFACES, equivalent_signs, mode_on

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


def decided(field: ModeField, y: State, u: Array | None, on: Collection[int]) -> dict[int, int]:
    """The modes in which switches go on.

    Args:
        field: The system in its modes.
        y: State of what is integrated.
        u: Inputs.
        on: The switches; the others stay as they are.

    Raises:
        SolveError: There is none, or several.
    """
    n = field.count
    rows = sorted(i for i in on if i < n)
    surfaces = sorted(i - n for i in on if i >= n)
    ways: tuple[int, ...]
    if field.surfaces is None or not surfaces:
        ways = () if field.rows is None else _of_rows(field, field.rows, y, u, rows)
    elif field.rows is None or not rows:
        answer = field.surfaces.answer(y, u, surfaces)
        names = [field.surfaces.names[i] for i in surfaces]
        ways = mode_on(answer.r[surfaces], answer.D[surfaces], names)
    else:
        given = _together(field, y, u, rows, surfaces)
        of_rows, of_surfaces = modes_of(given, [field.surfaces.names[i] for i in surfaces])
        ways = (*of_rows, *of_surfaces)
    return dict(zip([*rows, *(i + n for i in surfaces)], ways, strict=True))


def _of_rows(
    field: ModeField, rows: ExactRows, y: State, u: Array | None, chosen: Sequence[int]
) -> tuple[int, ...]:
    """Modes of exact rows beside surfaces that stay as they are."""
    if not chosen:
        return ()
    rows.solve(y, u, field.mode, chosen)
    found = rows.found()
    return tuple(found[i] for i in chosen)


def _together(
    field: ModeField, y: State, u: Array | None, rows: Sequence[int], surfaces: Sequence[int]
) -> Together:
    """How rows and surfaces answer one another, from rows at their lower bounds on."""
    exact, sliding, mode = field.rows, field.surfaces, field.mode
    assert exact is not None and sliding is not None
    if exact.contacts is not None and any(exact.reach[i] is Reach.FRICTION for i in rows):
        names = ", ".join(field.names[i] for i in (*rows, *(field.count + i for i in surfaces)))
        raise SolveError(
            f"{names}: a contact with friction touches where a switching surface is reached; "
            "accepted: one of them at a time"
        )
    field.mode = tuple(1 if i in rows else way for i, way in enumerate(mode))
    try:
        answer = sliding.answer(y, u, surfaces)
        a = sliding.system.lift(y, answer.a)
        per_sign = [sliding.system.lift(y, answer.a + b) - a for b in answer.B.T]
        J, b, response = exact.answer(y, u, rows)
        per_lam = sliding.system.integrated(response).T
        E = [sliding.rates_at(y, answer.a + more)[surfaces] for more in per_lam]
    finally:
        field.mode = mode
    r, D = answer.r[surfaces], answer.D[surfaces]
    room = exact.upper[rows] - exact.lower[rows]
    P = J.dot(np.array(per_sign).T)
    E_rows = (np.array(E) - r).T
    return Together(J.dot(a) + b, J.dot(response), P, r, E_rows, D, np.zeros(len(rows)), room)
