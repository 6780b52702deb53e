"""What contacts that a phase holds can exert: they push, within their friction cones.

Of one tangent a cone is two planes, mu n >= t and mu n >= -t; of two it is, beside n >= 0,

    mu n >= t^2 / sqrt((mu n)^2 + s^2),

whose slope does not vanish at the apex. A small s, a share of the weight, makes it smooth there;
off the apex it lets friction be larger by (s / mu n)^2 / 4 of itself.
"""

import math
from collections.abc import Sequence
from typing import Any, Protocol

import casadi as ca
import numpy as np
import pinocchio as pin

from mbd_ros.core.events.crossings import ConeRoom, Crossing, Footing, Force
from mbd_ros.optimal_control.phase_equations import PhaseEquations
from mbd_ros.optimal_control.problem import Range
from mbd_ros.optimal_control.quantities import Quantity, multiplier_names
from mbd_ros.optimal_control.shared_limits import (
    edges_of,
    is_determined,
    joined,
    rows_of,
    undetermined,
)

_PUSHES: Range = (0.0, math.inf)
_APEX = 1.0e-4  # of the weight
Limits = list[tuple[Quantity, Range]]


class Kept(Protocol):
    """What a contact that is held has to keep.

    Attributes:
        contact: Its name.
        crossing: A number of its multipliers that may not be negative.
    """

    @property
    def contact(self) -> str:
        """See the attributes of the class."""

    @property
    def crossing(self) -> Crossing:
        """See the attributes of the class."""


def held_limits(
    equations: PhaseEquations, kept: Sequence[Kept], forces: Any, used: float = 1.0
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
    for contact, cone in joined(equations, cones):
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


def force_of(equations: PhaseEquations, crossing: Force, forces: Any) -> Any:
    """The number of a guard that looks at forces."""
    return _along(equations, crossing.slots, forces) - crossing.at


def cone_of(equations: PhaseEquations, crossing: ConeRoom, forces: Any, mu: Any = None) -> Any:
    """What friction of two tangents has left [N]."""
    n = _along(equations, crossing.normals, forces) * (crossing.mu if mu is None else mu)
    t = [_along(equations, each, forces) for each in crossing.tangents if len(each)]
    apex = _APEX * weight_of(equations)
    return n - sum(one**2 for one in t) / ca.sqrt(n**2 + apex**2)


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


def weight_of(equations: PhaseEquations) -> float:
    """Of all bodies [N]; 1 without gravity."""
    model = equations.equations.system.robot.model
    weight = float(pin.computeTotalMass(model) * np.linalg.norm(model.gravity.linear))
    return weight or 1.0
