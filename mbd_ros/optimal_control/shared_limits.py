"""Limits of contacts whose points share forces in ways that no equation tells.

A motion determines sums of multipliers alone that are zero for all multipliers which push nothing.
Of a foot on several points these are its normal force, its friction and the moments about its
edges; of a heel and a toe the friction of both.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_ros.core.events.crossings import ConeRoom, Footing
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError
from mbd_ros.optimal_control.phase_equations import PhaseEquations
from mbd_ros.optimal_control.quantities import multiplier_names

_ZERO = 1.0e-6  # of a multiplier that pushes nothing
Cones = list[tuple[str, ConeRoom]]


def rows_of(equations: PhaseEquations, slots: Sequence[int]) -> list[int]:
    """Rows that act by slots of multipliers of the system."""
    rows = equations.equations.system.multiplier_rows
    names = multiplier_names(equations.equations)
    return [names.index(rows[slot].name) for slot in slots]


def is_determined(equations: PhaseEquations, slots: Sequence[int], weights: Any = 1.0) -> bool:
    """Whether a motion determines a weighted sum of multipliers."""
    null = equations.dependence.null
    if not len(null) or not len(slots):
        return True
    sums = null[:, rows_of(equations, slots)] * weights
    return bool(np.abs(sums.sum(axis=1)).max() < _ZERO)


def joined(equations: PhaseEquations, cones: Cones) -> Cones:
    """Friction cones, one of all contacts between which friction is not determined.

    Raises:
        ModelError: Not even the friction of all of them is determined.
    """
    alone = [one for one in cones if _is_cone_determined(equations, one[1])]
    rest = [one for one in cones if one not in alone]
    if not rest:
        return alone
    every = [one for _, one in rest]
    tangents = tuple([slot for one in every for slot in one.tangents[i]] for i in (0, 1))
    normals = [slot for one in every for slot in one.normals]
    whole = ConeRoom(min(one.mu for one in every), normals, (tangents[0], tangents[1]))
    name = " and ".join(name for name, _ in rest)
    if not _is_cone_determined(equations, whole):
        raise undetermined(name)
    return [*alone, (name, whole)]


def _is_cone_determined(equations: PhaseEquations, one: ConeRoom) -> bool:
    return all(is_determined(equations, slots) for slots in (one.normals, *one.tangents))


def undetermined(contacts: str) -> ModelError:
    """What is said of contacts whose forces depend on each other."""
    return ModelError(
        f"contacts {contacts} hold the same, and no equation tells their forces apart; accepted: "
        "one contact with several points, or fewer contacts at once"
    )


def edges_of(equations: PhaseEquations, footing: Footing) -> list[Array]:
    """Weights of normal forces that are moments about edges, of those that are determined."""
    system, q = equations.equations.system, equations.dependence.q
    x = system.expand(State(0.0, q, np.zeros(equations.sizes.nv)))
    system.k.refresh(x.q, x.v, footing.reads)
    every = footing.edges(system.k)
    return [one for one in every if is_determined(equations, footing.normals, one)]
