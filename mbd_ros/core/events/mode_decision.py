"""In which modes switches go on: one complementarity problem an event."""

from collections.abc import Collection, Sequence

import numpy as np

from mbd_ros.core.contact_modes.event_rows import ExactRows
from mbd_ros.core.contact_modes.row_distances import Reach
from mbd_ros.core.events.mixed_modes import Together, modes_of
from mbd_ros.core.events.mode_field import ModeField
from mbd_ros.core.events.surface_modes import mode_on
from mbd_ros.core.state import Array, State
from mbd_ros.errors import SolveError


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
