"""Linkages between ends of phases: guards, impacts and relabelling of joints.

At an impact, M (v+ - v-) = J' p and J v+ = 0 for all rows that hold after it, with unknown p.

Multipliers are polynomials through the points of an interval, lam(1) = sum_k l_k(1) lam_k at its
end, so that a guard of forces is a row of the points of the last interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols.scalar import plain
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError
from mbd_ros.methods.events.crossings import Combination, ConeRoom, Force, Gap
from mbd_ros.methods.events.phases import Exit, Relabelling
from mbd_ros.optimal_control.limits import cone_of, contact_limits, force_of, weight_of
from mbd_ros.optimal_control.mesh import Collocation
from mbd_ros.optimal_control.motion_phase import MotionPhase
from mbd_ros.optimal_control.phase_equations import PhaseEquations
from mbd_ros.optimal_control.phase_motion import Unknowns
from mbd_ros.optimal_control.quantities import Quantity
from mbd_ros.optimal_control.sparse_program import Block, Form

GUARD, RESET, PERIODIC, IMPACT = "guard", "reset", "periodic", "impact"
_ENDS: Array = np.ones((1, 1))  # share of the duration at the end of a phase


class ResetLinkage:
    """Transition of a phase to the next one: guard, impact and relabelling.

    Args:
        before: The phase that ends.
        after: The phase that begins.
        numbers: Indices of these phases.
        exit_: The exit.
        striking: Equations of the impact; None without one.
        travel: Indices in q that need not repeat in a periodic motion.
        grip: Share of the friction of contacts that impulses may use.

    Attributes:
        name: Name of the exit.
        count: Number of unknowns of the linkage.

    Raises:
        ModelError: No row can state the guard, or the phases have different coordinates.
    """

    def __init__(
        self,
        before: MotionPhase,
        after: MotionPhase,
        numbers: tuple[int, int],
        exit_: Exit,
        striking: PhaseEquations | None,
        travel: Sequence[int] = (),
        *,
        grip: float = 1.0,
    ) -> None:
        self._before = before
        self._numbers = numbers
        self.name = exit_.name
        sizes = before.equations.sizes
        if after.equations.sizes[:3] != sizes[:3]:
            raise ModelError(
                "phases have different coordinates; use all joints in both (solver: {type: kkt})"
            )
        self._impulses = 0 if striking is None else striking.sizes.m
        self._guard = None if exit_.crossing is None else EndGuard(before, exit_)
        self._reset = self._reset_form(exit_.reset.relabelling, striking, travel)
        self._limits = (
            [] if striking is None else _impulse_limits(striking, exit_.reset.demands, grip)
        )
        self._is_limited = False
        self.count = sizes.nv + self._impulses

    def blocks(self, all_unknowns: Sequence[Unknowns], first: int) -> tuple[list[Block], int]:
        """Return blocks of rows, and the number after the unknowns that begin with `first`."""
        before, after = (all_unknowns[i] for i in self._numbers)
        nodes = np.array([before.mesh.intervals])
        ends = self._before.forms.node_places(before, nodes)
        end = first + self.count
        added = np.arange(first, end)[:, None]
        places = np.vstack((ends, after.state[0][:, None], added))
        blocks = [Block(RESET, self._reset, places, _ENDS)]
        places = added[self._before.equations.sizes.nv :]
        for name, form, lower, upper in self._limits if self._is_limited else ():
            blocks.append(Block(f"{IMPACT}: {name}", form, places, None, lower, upper))
        if self._guard is not None:
            blocks.append(self._guard.block(before))
        return blocks, end

    def with_limits(self) -> ResetLinkage:
        """Return the linkage with the limits of impulses among its rows."""
        linkage = copy(self)
        linkage._is_limited = True
        return linkage

    def keeps_limits(self, link_values: Array) -> bool:
        """Return whether the unknowns of the linkage satisfy these limits."""
        if self._is_limited:
            return True
        p = link_values[self._before.equations.sizes.nv :]
        values = [(float(form.values(p, [])), *ends) for _, form, *ends in self._limits]
        return all(low <= value <= high for value, low, high in values)

    def _reset_form(
        self,
        relabelling: Relabelling | None,
        striking: PhaseEquations | None,
        travel: Sequence[int],
    ) -> Form:
        symbols, sizes = self._before.equations.symbols, self._before.equations.sizes
        q1, v1, z1 = (ca.SX.sym(f"{key}1", symbols[key].numel()) for key in "qvz")
        between, p = ca.SX.sym("v", sizes.nv), ca.SX.sym("P", self._impulses)
        if striking is None:
            impact = between - symbols["v"]
        else:
            impact = _impact_rows(striking, symbols, between, p)
        q, v, z = _relabel(relabelling, symbols["q"], between, symbols["z"])
        repeated = [i for i in range(sizes.nq) if i not in set(travel)]
        rows = ca.vertcat(impact, (q1 - q)[repeated], v1 - v, z1 - z)
        return self._before.forms.node_form(rows, more=ca.vertcat(q1, v1, z1, between, p))


def _impulse_limits(striking: PhaseEquations, demands: Sequence[Any], grip: float) -> list[Any]:
    """Return name, form and bounds of the limits of impulses of held contacts."""
    p = ca.SX.sym("P", striking.sizes.m)
    limits = contact_limits(striking, demands, p, grip)
    return [(q.name, Form(p, ca.SX(0, 1), q.value), *range_) for q, range_ in limits]


def _impact_rows(striking: PhaseEquations, symbols: Any, after: Any, p: Any) -> Any:
    """Return M (v+ - v-) - J' p and J v+, in symbols of the phase that ends."""
    impact_symbols, nv = striking.symbols, striking.sizes.nv
    force = striking.residual[:nv]
    jump = after - symbols["v"]
    balance = ca.jtimes(force, impact_symbols["a"], jump)
    balance = balance + ca.jtimes(force, impact_symbols["l"], p)
    replaced = [impact_symbols[key] for key in "tqvz"]
    values = [symbols["t"], symbols["q"], after, symbols["z"]]
    rows = ca.vertcat(balance, striking.velocities, p[list(striking.dependence.rows)])
    return ca.substitute([rows], replaced, values)[0]


def _relabel(names: Relabelling | None, q: Any, v: Any, z: Any) -> tuple[Any, Any, Any]:
    if names is None:
        return q, v, z
    q, v, z = ca.SX(q), ca.SX(v), ca.SX(z)
    at_q, at_v, at_z = (indices.tolist() for indices in (names.q, names.v, names.z))
    new = ca.DM(names.A) @ q[at_q] + ca.DM(names.b), ca.DM(names.A) @ v[at_v]
    q[at_q], v[at_v] = new
    if at_z:
        z[at_z] = ca.DM(names.B) @ z[at_z]
    return q, v, z


class EqualEnds:
    """Linkage of quantities at the end of a motion with quantities at its beginning.

    Args:
        last: The last phase.
        first: The first phase.
        pairs: Quantities at the end and at the beginning.
        signs: Factors of the values at the beginning, one per pair.

    Attributes:
        count: Number of unknowns of the linkage: 0.
    """

    count = 0

    def __init__(
        self,
        last: MotionPhase,
        first: MotionPhase,
        pairs: Sequence[tuple[Quantity, Quantity]],
        signs: Sequence[float],
    ) -> None:
        self._last = last
        symbols = first.equations.symbols
        begin = {key: ca.SX.sym(f"{key}0", symbols[key].numel()) for key in "qvz"}
        replaced, values = [symbols[key] for key in "qvz"], list(begin.values())
        rows = [
            end.value - sign * ca.substitute([start.value], replaced, values)[0]
            for (end, start), sign in zip(pairs, signs, strict=True)
        ]
        self._form = last.forms.node_form(ca.vertcat(*rows), more=ca.vertcat(*values))

    def blocks(self, all_unknowns: Sequence[Unknowns], first: int) -> tuple[list[Block], int]:
        """Return blocks of rows, and the number after the unknowns that begin with `first`."""
        last = all_unknowns[-1]
        ends = self._last.forms.node_places(last, np.array([last.mesh.intervals]))
        places = np.vstack((ends, all_unknowns[0].state[0][:, None]))
        return [Block(PERIODIC, self._form, places, _ENDS)], first

    def with_limits(self) -> EqualEnds:
        """Return the linkage with the limits of impulses among its rows."""
        return self

    def keeps_limits(self, link_values: Array) -> bool:
        """Return whether the unknowns of the linkage satisfy these limits."""
        return True


class EndGuard:
    """Rows that state that the guard of an exit crosses zero at the end of a phase.

    Args:
        phase: The phase that ends.
        exit_: The exit, which has a crossing.

    Raises:
        ModelError: No row can state the guard.
    """

    def __init__(self, phase: MotionPhase, exit_: Exit) -> None:
        self._phase = phase
        self._exit = exit_
        self._is_force = isinstance(exit_.crossing, Force | ConeRoom)
        self._form = None if self._is_force else self._of_positions()
        self._of_degree = cache(self._of_forces)
        self.name = f"{GUARD} {exit_.name}"

    def block(self, unknowns: Unknowns) -> Block:
        """Return the rows at the end of a mesh."""
        upper = 0.0 if self._exit.direction else np.inf
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
        value = ca.SX(guard_value(self._exit.crossing, equations.equations))
        symbols = equations.symbols
        rate = -self._exit.direction * ca.jtimes(value, symbols["q"], _rates(equations))
        return self._phase.forms.node_form(ca.vertcat(value, rate))

    def _of_forces(self, scheme: Collocation) -> tuple[Form, float]:
        """Return the rows on multipliers at the points of an interval, and their size."""
        equations, crossing = self._phase.equations, self._exit.crossing
        m, d = equations.sizes.m, scheme.degree
        points, share = ca.SX.sym("l", m, d), ca.SX.sym("s")
        powers = scheme.powers().T @ ca.vertcat(*(share**j for j in range(d)))
        forces = points @ powers
        function = force_of if isinstance(crossing, Force) else cone_of
        value = function(equations, crossing, forces)
        both = ca.vertcat(value, -self._exit.direction * ca.jtimes(value, share, 1))
        rows = ca.substitute(both, share, ca.SX(1.0))
        return Form(ca.vec(points), ca.SX(0, 1), rows), weight_of(equations)


def guard_value(crossing: Any, equations: Any) -> Any:
    """Return the function of a guard as an expression of positions.

    Raises:
        ModelError: The guard depends on other quantities.
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
        "a guard uses a centre of pressure; accepted are touch_down, lift_off, slip, joint, "
        "joints, force, multiplier, time"
    )


def _rates(equations: PhaseEquations) -> Any:
    """Return q' of a configuration without free bodies."""
    rates = ca.SX(equations.sizes.nq, 1)
    for i, j in equations.flat:
        rates[int(i)] = equations.symbols["v"][int(j)]
    return rates
