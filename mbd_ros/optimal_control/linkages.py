"""What links ends of phases: guards, impacts and other names of joints.

At an impact M (v+ - v-) = J' p and J v+ = 0 of all rows that hold after it, with p unknown.

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
    """A phase ends where a guard is zero, and the next one begins after what happens at once.

    Args:
        before: The phase that ends.
        after: The phase that begins.
        way: The exit that is taken.
        striking: Equations of the impact; None without one.
        travel: Places in q that go on as they like, where a motion repeats.
        grip: Share of the friction of contacts that their impulses may use.

    Attributes:
        name: Of the exit.
        count: Unknowns of its own.

    Raises:
        ModelError: A guard that no row states, or coordinates that differ.
    """

    def __init__(
        self,
        before: MotionPhase,
        after: MotionPhase,
        numbers: tuple[int, int],
        way: Exit,
        striking: PhaseEquations | None,
        travel: Sequence[int] = (),
        *,
        grip: float = 1.0,
    ) -> None:
        self._before, self._numbers, self.name = before, numbers, way.name
        sizes = before.equations.sizes
        if after.equations.sizes[:3] != sizes[:3]:
            raise ModelError("phases whose coordinates differ; accepted: solver: {type: kkt}")
        self._impulses = 0 if striking is None else striking.sizes.m
        self._guard = None if way.crossing is None else EndGuard(before, way)
        self._reset = self._reset_form(way.reset.relabelling, striking, travel)
        self._limits = [] if striking is None else _kept(striking, way.reset.demands, grip)
        self._is_limited, self.count = False, sizes.nv + self._impulses

    def blocks(self, every: Sequence[Unknowns], first: int) -> tuple[list[Block], int]:
        """Blocks of rows, and the number after their own unknowns, which begin with `first`."""
        before, after = (every[i] for i in self._numbers)
        nodes = np.array([before.mesh.intervals])
        ends = self._before.forms.node_places(before, nodes)
        end = first + self.count
        own = np.arange(first, end)[:, None]
        found = [Block(RESET, self._reset, np.vstack((ends, after.state[0][:, None], own)), _ENDS)]
        places = own[self._before.equations.sizes.nv :]
        for name, form, lower, upper in self._limits if self._is_limited else ():
            found.append(Block(f"{IMPACT}: {name}", form, places, None, lower, upper))
        if self._guard is not None:
            found.append(self._guard.block(before))
        return found, end

    def with_limits(self) -> ResetLinkage:
        """With what impulses have to keep among the rows."""
        found = copy(self)
        found._is_limited = True
        return found

    def keeps_limits(self, own: Array) -> bool:
        """Whether its own unknowns keep that."""
        if self._is_limited:
            return True
        p = own[self._before.equations.sizes.nv :]
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
            struck = between - symbols["v"]
        else:
            struck = _struck(striking, symbols, between, p)
        q, v, z = _relabelled(relabelling, symbols["q"], between, symbols["z"])
        kept = [i for i in range(sizes.nq) if i not in set(travel)]
        rows = ca.vertcat(struck, (q1 - q)[kept], v1 - v, z1 - z)
        return self._before.forms.node_form(rows, more=ca.vertcat(q1, v1, z1, between, p))


def _kept(striking: PhaseEquations, demands: Sequence[Any], grip: float) -> list[Any]:
    """Name, form and bounds of what impulses of contacts that are held keep."""
    p = ca.SX.sym("P", striking.sizes.m)
    limits = contact_limits(striking, demands, p, grip)
    return [(one.name, Form(p, ca.SX(0, 1), one.value), *range_) for one, range_ in limits]


def _struck(striking: PhaseEquations, symbols: Any, after: Any, p: Any) -> Any:
    """M (v+ - v-) - J' p and J v+, in symbols of the phase that ends."""
    own, nv = striking.symbols, striking.sizes.nv
    force = striking.residual[:nv]
    jump = after - symbols["v"]
    balance = ca.jtimes(force, own["a"], jump) + ca.jtimes(force, own["l"], p)
    given = [own[key] for key in "tqvz"]
    taken = [symbols["t"], symbols["q"], after, symbols["z"]]
    rows = ca.vertcat(balance, striking.velocities, p[list(striking.dependence.rows)])
    return ca.substitute([rows], given, taken)[0]


def _relabelled(names: Relabelling | None, q: Any, v: Any, z: Any) -> tuple[Any, Any, Any]:
    if names is None:
        return q, v, z
    q, v, z = ca.SX(q), ca.SX(v), ca.SX(z)
    at_q, at_v, at_z = (one.tolist() for one in (names.q, names.v, names.z))
    new = ca.DM(names.A) @ q[at_q] + ca.DM(names.b), ca.DM(names.A) @ v[at_v]
    q[at_q], v[at_v] = new
    if at_z:
        z[at_z] = ca.DM(names.B) @ z[at_z]
    return q, v, z


class EqualEnds:
    """Quantities that end as others began.

    Args:
        pairs: At the end, and at the beginning.
        signs: What values at the beginning count as, one a pair.

    Attributes:
        count: Unknowns of its own: none.
    """

    count = 0

    def __init__(
        self,
        last: MotionPhase,
        first: MotionPhase,
        pairs: Sequence[tuple[Quantity, Quantity]],
        signs: Sequence[float],
    ) -> None:
        self._last, symbols = last, first.equations.symbols
        begin = {key: ca.SX.sym(f"{key}0", symbols[key].numel()) for key in "qvz"}
        given, taken = [symbols[key] for key in "qvz"], list(begin.values())
        rows = [
            end.value - sign * ca.substitute([start.value], given, taken)[0]
            for (end, start), sign in zip(pairs, signs, strict=True)
        ]
        self._form = last.forms.node_form(ca.vertcat(*rows), more=ca.vertcat(*taken))

    def blocks(self, every: Sequence[Unknowns], first: int) -> tuple[list[Block], int]:
        """Blocks of rows, and the number after their own unknowns, which begin with `first`."""
        last = every[-1]
        ends = self._last.forms.node_places(last, np.array([last.mesh.intervals]))
        places = np.vstack((ends, every[0].state[0][:, None]))
        return [Block(PERIODIC, self._form, places, _ENDS)], first

    def with_limits(self) -> EqualEnds:
        """With what impulses have to keep among the rows."""
        return self

    def keeps_limits(self, own: Array) -> bool:
        """Whether its own unknowns keep that."""
        return True


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
