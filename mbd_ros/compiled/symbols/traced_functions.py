"""What the functions of a traced system give, one method a function."""

from collections.abc import Sequence
from typing import Any

import casadi as ca

from mbd_ros.compiled.symbols import balance, implicit
from mbd_ros.compiled.symbols.equations import Equations
from mbd_ros.compiled.symbols.link_rotations import ZERO
from mbd_ros.compiled.symbols.mode_switches import SwitchedRows
from mbd_ros.compiled.symbols.row_rank import health
from mbd_ros.compiled.symbols.rows import Rows
from mbd_ros.compiled.symbols.scalar import column, numbers, plain, scalars
from mbd_ros.compiled.symbols.untraceable import Untraceable, tracing
from mbd_ros.core.contact_modes.row_distances import Reach
from mbd_ros.core.contracts.outputs import Now
from mbd_ros.core.events.part_guards import guarding
from mbd_ros.core.multiplier_laws import Level


class Answers:
    """Expressions of functions; arguments and results are those that `Traced` names.

    Args:
        equations: Of the system.
    """

    def __init__(self, equations: Equations) -> None:
        self._equations = equations

    def accelerate(self) -> list[Any]:
        """Accelerations, rates of internal states, health; multipliers if rows switch."""
        e = self._equations
        solution = e.chosen[1]
        found = [e.speeding(solution.a), e.rates, health(e, solution, switches=True)]
        return [*found, ca.vertcat(*solution.lam)] if e.switches else found

    def multipliers(self) -> list[Any]:
        """Accelerations of all joints, and multipliers."""
        e = self._equations
        (dynamics, solution), (a, yielding) = e.chosen, e.solved
        lam = [ZERO] * e.m
        rigid = solution.lam[: e.mh]
        couplings = getattr(e.system.coordinates, "couplings", None)
        if couplings is not None:
            on = e.yielding.pushes(
                [lam if not way else ZERO for lam, way in zip(yielding, e.x.mode, strict=False)]
            )
            parts = zip(dynamics.needed(a), e.tau, on, strict=True)
            needed = numbers(ca.vertcat(*(n - t - push for n, t, push in parts)))
            slopes = [pair.function(e.x.q[pair.parent_q])[1] for pair in couplings.pairs]
            rigid = scalars(column(couplings.reduce(needed, slopes)[1]))
        blocks = (block.slots for block in e.system.layout.rigid)
        places = [slot for slots in blocks for slot in range(slots.start, slots.stop)]
        for slot, one in zip((*places, *e.yielding.slots), (*rigid, *yielding), strict=True):
            lam[slot] = one
        return [ca.vertcat(*a), ca.vertcat(*lam)]

    def guards(self) -> list[Any]:
        """Margins of the mode, then the values of the guards of parts."""
        e = self._equations
        a, lam = e.solved
        margins = e.yielding.margins(a, lam, e.velocity)
        return [ca.vertcat(*margins.values(), *self._part_guards())]

    def heights(self) -> list[Any]:
        """Margins of heights and slips, rates of gaps, spans; names of slips."""
        rows, v = self._switched, self._equations.velocity
        looks = [*rows.heights(v), rows.spans(v)]
        return [*(ca.vertcat(*one) for one in looks), rows.names()]

    def answers(self) -> list[Any]:
        """Margins of multipliers and demands, rates of slips; the length of a step."""
        e, rows = self._equations, self._switched
        a, lam = (scalars(e.symbols[key]) for key in "al")
        if e.axes is not None:
            a = e.axes.slowing(a, scalars(e.symbols["v"]))
        a = [ca.SX(one) for one in e.coordinates.lifted(a)]
        looks = rows.answers(a, rows.multipliers(lam[e.mh :]))
        return [*(ca.vertcat(*one) for one in looks), rows.longest(a)]

    def land(self) -> list[Any]:
        """A step of Newton's method onto the gaps that are on, and their g."""
        e, rows = self._equations, self._switched
        chosen = rows.of(Reach.GAP)
        on, held = rows.masked(chosen), e.held.of(Level.POSITION)
        a = self._moved(held, on, chosen, on.g)
        return [e.moving(a), ca.vertcat(*on.g)]

    def stay(self) -> list[Any]:
        """What ends the g' of rows that are on, and these."""
        e, rows = self._equations, self._switched
        chosen, rates = rows.of(Reach.GAP, Reach.SLIP, Reach.FRICTION), rows.rates(e.velocity)
        left = [rates[i] for i in chosen]
        a = self._moved(e.held, rows.masked(chosen), chosen, left)
        return [e.moving(a), ca.vertcat(*left)]

    def _moved(
        self, held: Rows, on: Rows, chosen: Sequence[int], left: Sequence[Any]
    ) -> list[Any]:
        """The smallest motion that ends what is left of chosen rows and moves no rigid one."""
        e, still = self._equations, [ZERO] * len(held.J)
        slack, soft = [*still, *self._switched.slack_of(chosen)], list[float]()
        if e.soft:
            soft = [*[0.0] * len(still), *(e.soft[e.mh + i] for i in chosen)]
        factors = e.beside(held.beside(on), slack, soft)
        return factors.solve([ZERO] * e.nv, [*still, *(-one for one in left)]).a

    @property
    def _switched(self) -> SwitchedRows:
        rows = self._equations.yielding
        if not isinstance(rows, SwitchedRows):
            raise Untraceable("rows that give way are looked at where all modes are traced")
        return rows

    def _part_guards(self) -> list[Any]:
        e = self._equations
        a, lam = self.multipliers()
        now, found = (numbers(one) for one in (a, lam)), list[Any]()
        a, lam = now
        for part, slots in ((e.own(part), slots) for part, slots in guarding(e.system)):
            with tracing(part):
                values = part.guard_values(e.k, e.x, e.u, Now(a, lam[slots]))
                found += scalars(column(values))
        return found

    def expand(self) -> list[Any]:
        """All positions and velocities."""
        e = self._equations
        return [column(e.coordinates.q), column(e.coordinates.v)]

    def place(self) -> list[Any]:
        """A step of Newton's method onto the rows of positions, their g, and their health."""
        e = self._equations
        rows = e.held.of(Level.POSITION)
        solution = e.beside(rows).solve([ZERO] * e.nv, [-g for g in rows.g])
        return [e.moving(solution.a), ca.vertcat(*rows.g), health(e, solution)]

    def settle(self) -> list[Any]:
        """What leads velocities onto the rows, and the rates that are left."""
        e = self._equations
        rates = e.held.velocities(e.velocity)
        solution = e.beside(e.held).solve([ZERO] * e.nv, [-one for one in rates])
        return [e.moving(solution.a), ca.vertcat(*rates)]

    def gap(self) -> list[Any]:
        """The g of the rows of positions."""
        e = self._equations
        return [ca.vertcat(*e.held.of(Level.POSITION).g)]

    def lift(self) -> list[Any]:
        """M^-1 J' (J M^-1 J')^-1 of the rows of positions, shape (nv, mg), and their health."""
        e = self._equations
        rows = e.held.of(Level.POSITION)
        held, zero = e.beside(rows), [ZERO] * e.nv
        ones = [[ca.SX(float(i == j)) for i in range(e.mg)] for j in range(e.mg)]
        solutions = [held.solve(zero, one) for one in ones]
        columns = [ca.vertcat(*one.a) for one in solutions]
        share = health(e, solutions[0]) if solutions else ca.SX(1.0)
        return [ca.horzcat(*columns) if columns else ca.SX(e.nv, 0), share]

    def path_places(self) -> list[Any]:
        """What the search of paths that wrap needs."""
        return [self._equations.k.searches.places]

    def integrate(self) -> list[Any]:
        """The configuration q (+) d."""
        e = self._equations
        return [e.chart.integrate(e.symbols["q"], e.symbols["d"])]

    def rate(self) -> list[Any]:
        """The rate of d in q0 (+) d while q moves with v."""
        e = self._equations
        return [e.chart.rate(e.symbols["d"], e.symbols["v"])]

    def derivatives(self) -> list[Any]:
        """Slopes of accelerations and rates by q, v, z, u and p."""
        return implicit.derivatives(self._equations)

    def residual(self) -> list[Any]:
        """What the equations of motion leave of given accelerations and multipliers."""
        e = self._equations
        a, lam = (scalars(e.symbols[key]) for key in "al")
        return [implicit.residual(e, a, lam)]

    def balance(self) -> list[Any]:
        """The force that lacks for given accelerations and multipliers, and rates."""
        return balance.balance(self._equations)

    def balance_slopes(self) -> list[Any]:
        """Slopes of the balance and of rates by q, v and z."""
        return balance.slopes(self._equations)

    def energy(self) -> list[Any]:
        """Kinetic and potential energy [J]."""
        e = self._equations
        kinetic, potential = implicit.energy(e)
        for part in e.loads:
            with tracing(part):
                potential += plain(part.potential(e.k, e.x))
        return [kinetic, potential]
