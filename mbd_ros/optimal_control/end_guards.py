"""Guards that end a phase: numbers of positions, or of forces as the last interval has them.

Multipliers are polynomials through the points of an interval, lam(1) = sum_k l_k(1) lam_k at its
end, so that a guard of forces is a row of the points of the last one.
"""

from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols.scalar import plain
from mbd_ros.core.events.crossings import Combination, ConeRoom, Force, Gap
from mbd_ros.core.events.phase import Exit
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError
from mbd_ros.optimal_control.collocation import Collocation
from mbd_ros.optimal_control.held_limits import cone_of, force_of, weight_of
from mbd_ros.optimal_control.motion_phase import MotionPhase
from mbd_ros.optimal_control.phase_equations import PhaseEquations
from mbd_ros.optimal_control.program_block import Block, Form
from mbd_ros.optimal_control.unknowns import Unknowns

GUARD = "guard"
_ENDS: Array = np.ones((1, 1))  # share of the duration


class EndGuard:
    """The guard of an exit is zero at the end of a phase, and gets there in its direction.

    Args:
        phase: The phase that ends.
        way: The exit, with a crossing.

    Raises:
        ModelError: A guard that no row states.
    """

    def __init__(self, phase: MotionPhase, way: Exit) -> None:
        self._phase, self._way = phase, way
        self._is_force = isinstance(way.crossing, Force | ConeRoom)
        self._form = None if self._is_force else self._of_positions()
        self._of_degree = cache(self._of_forces)
        self.name = f"{GUARD} {way.name}"

    def block(self, unknowns: Unknowns) -> Block:
        """Its rows at the end of a mesh."""
        upper = 0.0 if self._way.direction else np.inf
        mesh = unknowns.mesh
        bounds = [0.0, -np.inf], [0.0, upper]
        if self._form is not None:
            places = self._phase.forms.node_places(unknowns, np.array([mesh.intervals]))
            return Block(self.name, self._form, places, _ENDS, *bounds)
        degree = int(mesh.degrees[-1])
        form, size = self._of_degree(mesh.scheme_of(degree))
        places = unknowns.points["l"][-degree:].reshape(-1, 1)
        return Block(self.name, form, places, None, *bounds, size)

    def _of_positions(self) -> Form:
        equations = self._phase.equations
        value = ca.SX(guard_value(self._way.crossing, equations.equations))
        symbols = equations.symbols
        rate = -self._way.direction * ca.jtimes(value, symbols["q"], _rates(equations))
        return self._phase.forms.node_form(ca.vertcat(value, rate))

    def _of_forces(self, scheme: Collocation) -> tuple[Form, float]:
        """Of multipliers at the points of an interval, and their usual size."""
        equations, crossing = self._phase.equations, self._way.crossing
        m, d = equations.sizes.m, scheme.degree
        points, share = ca.SX.sym("l", m, d), ca.SX.sym("s")
        powers = scheme.powers().T @ ca.vertcat(*(share**j for j in range(d)))
        forces = points @ powers
        of = force_of if isinstance(crossing, Force) else cone_of
        value = of(equations, crossing, forces)
        both = ca.vertcat(value, -self._way.direction * ca.jtimes(value, share, 1))
        rows = ca.substitute(both, share, ca.SX(1.0))
        return Form(ca.vec(points), ca.SX(0, 1), rows), weight_of(equations)


def guard_value(crossing: Any, equations: Any) -> Any:
    """The number of a guard as an expression of positions.

    Raises:
        ModelError: It looks at something else.
    """
    if isinstance(crossing, Gap):
        gaps = list(crossing.contact.pair.gaps(equations.k))
        least = ca.SX(plain(gaps[0]))
        for other in gaps[1:]:
            least = ca.fmin(least, plain(other))
        return least
    if isinstance(crossing, Combination):
        pairs = zip(crossing.q, crossing.factors, strict=True)
        total: Any = sum(factor * equations.coordinates.q[i] for i, factor in pairs)
        return plain(total) - crossing.at
    raise ModelError(
        "a guard looks at a centre of pressure; accepted: touch_down, lift_off, slip, joint, "
        "joints, force, multiplier, time"
    )


def _rates(equations: PhaseEquations) -> Any:
    """Q' of a configuration without free bodies."""
    rates = ca.SX(equations.sizes.nq, 1)
    for i, j in equations.flat:
        rates[int(i)] = equations.symbols["v"][int(j)]
    return rates
