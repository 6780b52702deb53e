"""Bounds all the time: of quantities, and of contacts that are held.

Of one tangent a cone is two planes, mu n >= t and mu n >= -t; of two it is, beside n >= 0,

    mu n >= t^2 / sqrt((mu n)^2 + s^2),

whose slope does not vanish at the apex. A small s, a share of the weight, makes it smooth there;
off the apex it lets friction be larger by (s / mu n)^2 / 4 of itself.

Points of contacts may share forces in ways that no equation tells: a motion determines only sums
of multipliers that are zero for all multipliers that push nothing. Of a foot on several points
these are its normal force, its friction and the moments about its edges; of a heel and a toe the
friction of both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any, Protocol

import casadi as ca
import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError
from mbd_ros.methods.events.crossings import ConeRoom, Crossing, Footing, Force
from mbd_ros.optimal_control.defects import PhaseForms
from mbd_ros.optimal_control.phase_equations import LETTERS, PhaseEquations
from mbd_ros.optimal_control.phase_motion import Unknowns
from mbd_ros.optimal_control.problem import Range
from mbd_ros.optimal_control.quantities import Quantity, multiplier_names
from mbd_ros.optimal_control.sparse_program import Block

PATH = "bounds"  # name of blocks
_PUSHES: Range = (0.0, math.inf)
_APEX = 1.0e-4  # of the weight
_ZERO = 1.0e-6  # of a multiplier that pushes nothing
Cones = list[tuple[str, ConeRoom]]
Limits = list[tuple[Quantity, Range]]


class PathBounds:
    """Quantities, their bounds, and what they are at points and between them.

    Attributes:
        lower: Shape (k,).
        upper: Shape (k,).
    """

    def __init__(self, bounds: Sequence[tuple[Quantity, Range]], forms: PhaseForms) -> None:
        self.bounds, self._forms = list(bounds), forms
        self.lower, self.upper = np.array([one for _, one in bounds]).reshape(-1, 2).T
        self._size = bound_sizes(self.lower, self.upper)

    def blocks(self, unknowns: Unknowns, sizes: Array) -> list[Block]:
        """The rows at all points of a mesh.

        Args:
            unknowns: Where the unknowns stand.
            sizes: Their usual sizes.
        """
        if not self.bounds:
            return []
        places, shares = self._forms.point_places(unknowns), unknowns.mesh.shares[None]
        size = np.maximum(self._size, self._of_forces(sizes[unknowns.points["l"][0]]))
        return [Block(PATH, self._form, places, shares, self.lower, self.upper, size)]

    def values(self, times: Array, letters: dict[str, Array], p: Array) -> Array:
        """The quantities at some places, shape (m, k).

        Args:
            times: [s], shape (m,).
            letters: Letter -> values, shape (m, ..).
        """
        if not self.bounds:
            return np.zeros((len(times), 0))
        given = [times[None, :], *(letters[key].T for key in LETTERS)]
        given.append(np.tile(p[:, None], len(times)))
        found: Array = self._function.map(len(times))(*given).full().T
        return found

    def holds(self, times: Array, letters: dict[str, Array], p: Array) -> bool:
        """Whether the bounds are kept at all of some places, given as for `values`."""
        found = self.values(times, letters, p)
        return bool(((self.lower <= found) & (found <= self.upper)).all())

    @cached_property
    def _values(self) -> Any:
        return ca.vertcat(*(one.value for one, _ in self.bounds))

    @cached_property
    def _form(self) -> Any:
        return self._forms.point_form(self._values)

    @cached_property
    def _function(self) -> Any:
        symbols = self._forms.phase.symbols
        given = [symbols[key] for key in ("t", *LETTERS, "p")]
        return ca.Function("derived", given, [ca.densify(self._values)])

    def _of_forces(self, multipliers: Array) -> Array:
        """What multipliers of their usual sizes add up to, 0 where they do not count."""
        symbols = self._forms.phase.symbols
        slopes = ca.jacobian(self._values, symbols["l"])
        if not slopes.nnz():
            return np.zeros(len(self.bounds))
        others = [symbols[key] for key in ("t", *"qvzawu", "p")]
        given = [symbols["l"], *others]
        function = ca.Function("slopes", given, [ca.densify(slopes)])
        ones = [np.ones(int(one.numel())) for one in others]
        found: Array = np.abs(function(multipliers, *ones).full()) @ multipliers
        return found


def bound_sizes(lower: Array, upper: Array) -> Array:
    """Characteristic sizes of quantities by their bounds, 1 at least, shape (k,)."""
    ends = [np.where(np.isfinite(one), np.abs(one), 0.0) for one in (lower, upper)]
    return np.maximum(np.maximum(*ends), 1.0)


def contact_limits(
    equations: PhaseEquations, kept: Sequence[ContactDemand], forces: Any, used: float = 1.0
) -> Limits:
    """Bounds of forces of contacts, or of their impulses.

    Args:
        equations: Of the system that holds the contacts.
        kept: What they have to keep.
        forces: The multipliers of the system or the impulses along its rows, symbols, (m,).
        used: Share of the friction that may be used.

    Raises:
        ModelError: Contacts whose forces are not determined.
    """
    found: Limits = []
    cones = [(one.contact, one.crossing) for one in kept if isinstance(one.crossing, ConeRoom)]
    for contact, cone in merge_cones(equations, cones):
        found += _cone(equations, contact, cone, forces, used)
    for contact, crossing in ((one.contact, one.crossing) for one in kept):
        if isinstance(crossing, Force):
            if not is_determined(equations, crossing.slots):
                raise undetermined(contact)
            name = f"normal force of {contact}"
            found.append((Quantity(name, force_of(equations, crossing, forces)), _PUSHES))
        elif isinstance(crossing, Footing):
            at = rows_of(equations, crossing.normals)
            for weights in edges_of(equations, crossing):
                moment = ca.dot(ca.DM(weights), forces[at])
                found.append((Quantity(f"centre of pressure of {contact}", moment), _PUSHES))
    return found


class ContactDemand(Protocol):
    """What a contact that is held has to keep."""

    @property
    def contact(self) -> str:
        """Name of the contact."""

    @property
    def crossing(self) -> Crossing:
        """A number of its multipliers that may not be negative."""


def merge_cones(equations: PhaseEquations, cones: Cones) -> Cones:
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


def is_determined(equations: PhaseEquations, slots: Sequence[int], weights: Any = 1.0) -> bool:
    """Whether a motion determines a weighted sum of multipliers."""
    null = equations.dependence.null
    if not len(null) or not len(slots):
        return True
    sums = null[:, rows_of(equations, slots)] * weights
    return bool(np.abs(sums.sum(axis=1)).max() < _ZERO)


def rows_of(equations: PhaseEquations, slots: Sequence[int]) -> list[int]:
    """Rows that act by slots of multipliers of the system."""
    rows = equations.equations.system.multiplier_rows
    names = multiplier_names(equations.equations)
    return [names.index(rows[slot].name) for slot in slots]


def undetermined(contacts: str) -> ModelError:
    """What is said of contacts whose forces depend on each other."""
    return ModelError(
        f"contacts {contacts} hold the same, and no equation tells their forces apart; accepted: "
        "one contact with several points, or fewer contacts at once"
    )


def _cone(
    equations: PhaseEquations, contact: str, crossing: ConeRoom, forces: Any, used: float
) -> Limits:
    mu, name = used * _friction(equations, contact, crossing), f"friction cone of {contact}"
    tangents = [each for each in crossing.tangents if len(each)]
    if not tangents or crossing.mu == math.inf:
        return []
    if used * crossing.mu == 0.0:
        along = [_along(equations, each, forces) for each in tangents]
        return [(Quantity(f"friction of {contact}", one), (0.0, 0.0)) for one in along]
    if len(tangents) > 1:
        return [(Quantity(name, cone_of(equations, crossing, forces, mu)), _PUSHES)]
    n, t = (_along(equations, each, forces) for each in (crossing.normals, tangents[0]))
    ways = {"forwards": mu * n - t, "backwards": mu * n + t}
    return [(Quantity(f"{name} {way}", room), _PUSHES) for way, room in ways.items()]


def _friction(equations: PhaseEquations, contact: str, crossing: ConeRoom) -> Any:
    """The coefficient of friction, a symbol where it is a parameter that is unknown."""
    names = list(equations.equations.parameters)
    key = f"{contact}.friction"
    return equations.symbols["p"][names.index(key)] if key in names else crossing.mu


def _along(equations: PhaseEquations, slots: Sequence[int], forces: Any) -> Any:
    """The sum of some multipliers, numbered as those of the system."""
    rows = equations.equations.system.multiplier_rows
    names = multiplier_names(equations.equations)
    return sum((forces[names.index(rows[slot].name)] for slot in slots), ca.SX(0))


def cone_of(equations: PhaseEquations, crossing: ConeRoom, forces: Any, mu: Any = None) -> Any:
    """What friction of two tangents has left [N]."""
    n = _along(equations, crossing.normals, forces) * (crossing.mu if mu is None else mu)
    t = [_along(equations, each, forces) for each in crossing.tangents if len(each)]
    apex = _APEX * weight_of(equations)
    return n - sum(one**2 for one in t) / ca.sqrt(n**2 + apex**2)


def weight_of(equations: PhaseEquations) -> float:
    """Of all bodies [N]; 1 without gravity."""
    model = equations.equations.system.robot.model
    weight = float(pin.computeTotalMass(model) * np.linalg.norm(model.gravity.linear))
    return weight or 1.0


def force_of(equations: PhaseEquations, crossing: Force, forces: Any) -> Any:
    """The number of a guard that looks at forces."""
    return _along(equations, crossing.slots, forces) - crossing.at


def edges_of(equations: PhaseEquations, footing: Footing) -> list[Array]:
    """Weights of normal forces that are moments about edges, of those that are determined."""
    system, q = equations.equations.system, equations.dependence.q
    x = system.expand(State(0.0, q, np.zeros(equations.sizes.nv)))
    system.k.refresh(x.q, x.v, footing.reads)
    every = footing.edges(system.k)
    return [one for one in every if is_determined(equations, footing.normals, one)]
