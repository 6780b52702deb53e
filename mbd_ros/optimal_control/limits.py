"""Bounds at all times: of quantities, and of the forces of held contacts.

With one tangent, a friction cone is two planes, mu n >= t and mu n >= -t. With two tangents, it is

    mu n >= t^2 / sqrt((mu n)^2 + s^2),

in addition to n >= 0. Its derivative does not vanish at the apex, where a small s, a share of the
weight, makes it smooth; elsewhere s increases friction by a factor of 1 + (s / mu n)^2 / 4.

Equations may not determine how points of contacts share forces: a motion determines only the sums
of multipliers that vanish for all multipliers without an effect. For a foot on several points
these are its normal force, its friction and the moments about its edges; for heel and toe, the
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
_APEX = 1.0e-4  # s over the weight
_ZERO = 1.0e-6  # of a multiplier without an effect: smaller sums are determined
Cones = list[tuple[str, ConeRoom]]
Limits = list[tuple[Quantity, Range]]


class PathBounds:
    """Bounded quantities, as rows at points and as values between points.

    Attributes:
        bounds: Quantities and their ranges.
        lower: Lower bounds, shape (k,).
        upper: Upper bounds, shape (k,).
    """

    def __init__(self, bounds: Sequence[tuple[Quantity, Range]], forms: PhaseForms) -> None:
        self.bounds = list(bounds)
        self._forms = forms
        self.lower, self.upper = np.array([range_ for _, range_ in bounds]).reshape(-1, 2).T
        self._size = bound_sizes(self.lower, self.upper)

    def blocks(self, unknowns: Unknowns, sizes: Array) -> list[Block]:
        """Return the rows at all points of a mesh.

        Args:
            unknowns: Indices of the unknowns.
            sizes: Characteristic sizes of the unknowns.
        """
        if not self.bounds:
            return []
        places, shares = self._forms.point_places(unknowns), unknowns.mesh.shares[None]
        size = np.maximum(self._size, self._of_forces(sizes[unknowns.points["l"][0]]))
        return [Block(PATH, self._form, places, shares, self.lower, self.upper, size)]

    def values(self, times: Array, letters: dict[str, Array], p: Array) -> Array:
        """Return the quantities at some places, shape (m, k).

        Args:
            times: Times [s], shape (m,).
            letters: Letter -> values, shape (m, ..).
        """
        if not self.bounds:
            return np.zeros((len(times), 0))
        given = [times[None, :], *(letters[key].T for key in LETTERS)]
        given.append(np.tile(p[:, None], len(times)))
        values: Array = self._function.map(len(times))(*given).full().T
        return values

    def holds(self, times: Array, letters: dict[str, Array], p: Array) -> bool:
        """Return whether the bounds hold at some places, given as for `values`."""
        values = self.values(times, letters, p)
        return bool(((self.lower <= values) & (values <= self.upper)).all())

    @cached_property
    def _values(self) -> Any:
        return ca.vertcat(*(quantity.value for quantity, _ in self.bounds))

    @cached_property
    def _form(self) -> Any:
        return self._forms.point_form(self._values)

    @cached_property
    def _function(self) -> Any:
        symbols = self._forms.phase.symbols
        given = [symbols[key] for key in ("t", *LETTERS, "p")]
        return ca.Function("derived", given, [ca.densify(self._values)])

    def _of_forces(self, multipliers: Array) -> Array:
        """Return the sizes that multipliers of characteristic sizes give to the quantities."""
        symbols = self._forms.phase.symbols
        slopes = ca.jacobian(self._values, symbols["l"])
        if not slopes.nnz():
            return np.zeros(len(self.bounds))
        others = [symbols[key] for key in ("t", *"qvzawu", "p")]
        given = [symbols["l"], *others]
        function = ca.Function("slopes", given, [ca.densify(slopes)])
        ones = [np.ones(int(symbol.numel())) for symbol in others]
        sums: Array = np.abs(function(multipliers, *ones).full()) @ multipliers
        return sums


def bound_sizes(lower: Array, upper: Array) -> Array:
    """Return the sizes of quantities from their bounds, at least 1, shape (k,)."""
    ends = [np.where(np.isfinite(end), np.abs(end), 0.0) for end in (lower, upper)]
    return np.maximum(np.maximum(*ends), 1.0)


def contact_limits(
    equations: PhaseEquations,
    demands: Sequence[ContactDemand],
    forces: Any,
    grip: float = 1.0,
) -> Limits:
    """Return the bounds of the forces of held contacts, or of their impulses.

    Args:
        equations: Equations of the system that holds the contacts.
        demands: Conditions that the contacts must satisfy.
        forces: Symbols of the multipliers of the system, or of the impulses along its rows, (m,).
        grip: Share of the friction that may be used.

    Raises:
        ModelError: The forces of a contact are not determined.
    """
    limits: Limits = []
    cones = [(d.contact, d.crossing) for d in demands if isinstance(d.crossing, ConeRoom)]
    for contact, cone in merge_cones(equations, cones):
        limits += _cone(equations, contact, cone, forces, grip)
    for contact, crossing in ((d.contact, d.crossing) for d in demands):
        if isinstance(crossing, Force):
            if not is_determined(equations, crossing.slots):
                raise undetermined(contact)
            name = f"normal force of {contact}"
            limits.append((Quantity(name, force_of(equations, crossing, forces)), _PUSHES))
        elif isinstance(crossing, Footing):
            at = rows_of(equations, crossing.normals)
            for weights in edges_of(equations, crossing):
                moment = ca.dot(ca.DM(weights), forces[at])
                limits.append((Quantity(f"centre of pressure of {contact}", moment), _PUSHES))
    return limits


class ContactDemand(Protocol):
    """A condition that a held contact must satisfy."""

    @property
    def contact(self) -> str:
        """Name of the contact."""

    @property
    def crossing(self) -> Crossing:
        """Function of its multipliers that must not be negative."""


def merge_cones(equations: PhaseEquations, cones: Cones) -> Cones:
    """Merge the friction cones of contacts between which friction is not determined.

    Raises:
        ModelError: Not even the friction of all of them together is determined.
    """
    alone = [cone for cone in cones if _is_cone_determined(equations, cone[1])]
    others = [cone for cone in cones if cone not in alone]
    if not others:
        return alone
    rooms = [room for _, room in others]
    tangents = tuple([slot for room in rooms for slot in room.tangents[i]] for i in (0, 1))
    normals = [slot for room in rooms for slot in room.normals]
    merged = ConeRoom(min(room.mu for room in rooms), normals, (tangents[0], tangents[1]))
    name = " and ".join(name for name, _ in others)
    if not _is_cone_determined(equations, merged):
        raise undetermined(name)
    return [*alone, (name, merged)]


def _is_cone_determined(equations: PhaseEquations, cone: ConeRoom) -> bool:
    return all(is_determined(equations, slots) for slots in (cone.normals, *cone.tangents))


def is_determined(equations: PhaseEquations, slots: Sequence[int], weights: Any = 1.0) -> bool:
    """Return whether a motion determines a weighted sum of multipliers."""
    null = equations.dependence.null
    if not len(null) or not len(slots):
        return True
    sums = null[:, rows_of(equations, slots)] * weights
    return bool(np.abs(sums.sum(axis=1)).max() < _ZERO)


def rows_of(equations: PhaseEquations, slots: Sequence[int]) -> list[int]:
    """Return the active rows of slots of multipliers of the system."""
    rows = equations.equations.system.multiplier_rows
    names = multiplier_names(equations.equations)
    return [names.index(rows[slot].name) for slot in slots]


def undetermined(contacts: str) -> ModelError:
    """Return the error for contacts whose forces are not determined."""
    return ModelError(
        f"contacts {contacts} constrain the same motion, so their forces are not "
        "determined; use one contact with several points, or fewer contacts at once"
    )


def _cone(
    equations: PhaseEquations, contact: str, crossing: ConeRoom, forces: Any, grip: float
) -> Limits:
    """Return the limits of one friction cone."""
    mu, name = grip * _friction(equations, contact, crossing), f"friction cone of {contact}"
    tangents = [slots for slots in crossing.tangents if len(slots)]
    if not tangents or crossing.mu == math.inf:
        return []
    if grip * crossing.mu == 0.0:
        friction = [_along(equations, slots, forces) for slots in tangents]
        return [(Quantity(f"friction of {contact}", t), (0.0, 0.0)) for t in friction]
    if len(tangents) > 1:
        return [(Quantity(name, cone_of(equations, crossing, forces, mu)), _PUSHES)]
    n, t = (_along(equations, slots, forces) for slots in (crossing.normals, tangents[0]))
    planes = {"forwards": mu * n - t, "backwards": mu * n + t}
    return [(Quantity(f"{name} {side}", room), _PUSHES) for side, room in planes.items()]


def _friction(equations: PhaseEquations, contact: str, crossing: ConeRoom) -> Any:
    """Return the coefficient of friction, a symbol where it is an unknown parameter."""
    names = list(equations.equations.parameters)
    key = f"{contact}.friction"
    return equations.symbols["p"][names.index(key)] if key in names else crossing.mu


def _along(equations: PhaseEquations, slots: Sequence[int], forces: Any) -> Any:
    """Return the sum of some multipliers, given by slots of the system."""
    rows = equations.equations.system.multiplier_rows
    names = multiplier_names(equations.equations)
    return sum((forces[names.index(rows[slot].name)] for slot in slots), ca.SX(0))


def cone_of(equations: PhaseEquations, crossing: ConeRoom, forces: Any, mu: Any = None) -> Any:
    """Return the distance of a force from the friction cone of two tangents [N]."""
    n = _along(equations, crossing.normals, forces) * (crossing.mu if mu is None else mu)
    tangents = [_along(equations, slots, forces) for slots in crossing.tangents if len(slots)]
    apex = _APEX * weight_of(equations)
    return n - sum(t**2 for t in tangents) / ca.sqrt(n**2 + apex**2)


def weight_of(equations: PhaseEquations) -> float:
    """Return the weight of all bodies [N]; 1 without gravity."""
    model = equations.equations.system.robot.model
    weight = float(pin.computeTotalMass(model) * np.linalg.norm(model.gravity.linear))
    return weight or 1.0


def force_of(equations: PhaseEquations, crossing: Force, forces: Any) -> Any:
    """Return the function of a guard on forces."""
    return _along(equations, crossing.slots, forces) - crossing.at


def edges_of(equations: PhaseEquations, footing: Footing) -> list[Array]:
    """Return weights of normal forces in the moments about edges that are determined."""
    system, q = equations.equations.system, equations.dependence.q
    x = system.expand(State(0.0, q, np.zeros(equations.sizes.nv)))
    system.k.refresh(x.q, x.v, footing.reads)
    edges = footing.edges(system.k)
    return [weights for weights in edges if is_determined(equations, footing.normals, weights)]
