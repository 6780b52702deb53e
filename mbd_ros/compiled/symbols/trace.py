"""A system as symbolic expressions: functions of CasADi that evaluate it without any Python."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca

from mbd_ros.compiled.symbols import implicit
from mbd_ros.compiled.symbols.constrained_motion import Rows
from mbd_ros.compiled.symbols.equations import Equations
from mbd_ros.compiled.symbols.scalar import column, numbers, plain, scalars
from mbd_ros.compiled.symbols.searched_paths import SearchedPaths
from mbd_ros.compiled.symbols.symbolic_system import Made
from mbd_ros.compiled.symbols.tree.link_rotations import ZERO
from mbd_ros.compiled.symbols.unilateral_rows import SwitchedRows
from mbd_ros.compiled.symbols.untraceable import Untraceable, tracing
from mbd_ros.core.contact_modes.row_distances import Reach
from mbd_ros.core.contracts import Now
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.rows.constraint import Level
from mbd_ros.core.state import Mode
from mbd_ros.methods.events.crossings import guarding

ARGUMENTS = {  # of every function, in their order
    "accelerate": "tqvzup",
    "multipliers": "tqvzup",
    "expand": "tqv",
    "place": "tqp",
    "settle": "tqvp",
    "gap": "tqp",
    "lift": "tqp",
    "integrate": "qd",
    "rate": "dv",
    "energy": "tqvzp",
    "derivatives": "tqvzup",
    "residual": "tqvzupal",
    "balance": "tqvzupal",
    "balance_slopes": "tqvzupal",
    "guards": "tqvzup",
    "heights": "tqvp",
    "answers": "tqvzupal",
    "land": "tqp",
    "stay": "tqvp",
    "path_places": "tqp",
}
_OF_PATHS = ("derivatives", "balance_slopes")  # differentiate what paths do


def trace(
    system: System,
    parameters: Sequence[str] = (),
    mode: Mode | None = (),
    made: Made = dict,
    *,
    in_world: bool = False,
) -> Traced:
    """The functions of a system.

    Args:
        parameters: Names of numbers that stay arguments.
        mode: Of unilateral rows, as `State.mode`; needed where there are any. None
            for all modes at once: p ends with the mode then.
        made: Makes parts from symbols by parameter: name -> part; see `scene.runs.compiling`.
        in_world: Whether velocities of free bodies stand in the axes of the world, for functions
            that runs call; accelerations are their rates then.

    Raises:
        Untraceable: Names the part and why.
    """
    return Traced(Equations(system, tuple(parameters), mode, made, in_world=in_world))


class Traced:
    """The functions of a system, made when they are asked for.

    Arguments and results are dense columns, empty where there is nothing: time t [s], q and v of
    what the tier integrates, internal states z, inputs u, parameters p.

    accelerate(t, q, v, z, u, p) -> (a, zdot, health): health is the smallest pivot of the rows
    over its usual size, 1 without rows.
    multipliers(t, q, v, z, u, p) -> (a_all, lam): of all joints, and in the order of
    `System.multiplier_rows`.
    expand(t, q, v) -> (q_all, v_all).
    place(t, q, p) -> (dq, g, health): a step of Newton's method onto the rows of positions in the
    mass metric.
    settle(t, q, v, p) -> (dv, rate): onto all rows that velocities keep.
    gap(t, q, p) -> g, lift(t, q, p) -> (M^-1 J' (J M^-1 J')^-1, health) of the rows of positions.
    energy(t, q, v, z, p) -> (T, V).
    derivatives(t, q, v, z, u, p) -> of (a, zdot) by steps of q, by v, z, u and p.
    residual(t, q, v, z, u, p, a, lam): what the equations of motion leave, lam of rows that act.
    balance(t, q, v, z, u, p, a, lam) -> (tau - h - M a + J' lam, zdot), and
    balance_slopes(the same) -> of both, stacked, by steps of q, by v and by z.
    guards(t, q, v, z, u, p) -> margins of unilateral rows in the mode, as `margins` lists them,
    then the values of the guards of parts.
    heights(t, q, v, p) -> (margins, rates, spans, names), answers(t, q, v, z, u, p, a, lam) ->
    (margins, rates, length) of unilateral rows, in all modes: margins of heights and slips, and
    of multipliers, positive while a mode goes on. Names are 0 where a slip should have another
    one, 2 where one turns with its velocity: length [s] is how long a step may be then. `a` and
    `lam` are those of `accelerate`, which gives `lam` as its fourth result then.
    land(t, q, p) -> (dq, g), stay(t, q, v, p) -> (dv, rate) onto the rows that are on.
    path_places(t, q, p): where points and surfaces of paths that wrap are, as `searched` has them.
    Functions that depend on what such paths do have one more argument: `searched.symbols`.
    integrate(q, dq) -> q (+) dq, rate(dq, v) -> the rate of dq: for charts that are not flat.

    Attributes:
        tier: Name of the way of solving.
        parameters: Names of p.
        nq: Size of the configuration of what is integrated.
        nv: Size of its velocity.
        nz: Number of internal states.
        nu: Number of inputs.
        np: Number of parameters.
        nq_all: Size of the configuration of all joints.
        nv_all: Size of their velocity.
        m: Number of multipliers.
        mg: Number of rows of positions that an integrator may have to keep.
        mh: Number of rows that velocities keep.
        switches: How many entries of a mode stand behind the parameters in p.
        least_health: Below it, rows are too near to dependent for a factor without pivoting.
    """

    least_health = 1.0e-8

    def __init__(self, equations: Equations) -> None:
        self.equations, self._expressions = equations, Expressions(equations)
        self.tier, self.parameters = equations.tier, equations.parameters
        self.nq, self.nv = equations.nq, equations.nv
        self.nz, self.nu, self.np = equations.nz, equations.nu, len(equations.parameters)
        self.nq_all, self.nv_all = equations.tree.nq, equations.tree.nv
        self.m, self.mg, self.mh = equations.m, equations.mg, equations.mh
        self.switches = equations.switches
        self._made: dict[str, Any] = {}

    @property
    def margins(self) -> tuple[tuple[int, int], ...]:
        """Row, and 1 or -1 where its multiplier meets a bound: what `guards` begins with."""
        return self.equations.margins

    @property
    def keys(self) -> dict[tuple[int, int], int]:
        """Margins in all modes: row and way -> place among those of `heights`, then `answers`."""
        return getattr(self.equations.unilateral, "keys", {})

    @property
    def searched(self) -> SearchedPaths:
        """Paths that functions made so far have as numbers."""
        return self.equations.k.searches

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all functions."""
        return tuple(ARGUMENTS)

    def function(self, name: str) -> Any:
        """The `casadi.Function` of a name.

        Raises:
            Untraceable: The system has no such function; says why.
        """
        if name not in self._made:
            if name not in ARGUMENTS:
                raise Untraceable(f"no function '{name}'; there are {', '.join(ARGUMENTS)}")
            made: Callable[[], Sequence[Any]] = getattr(self._expressions, name)
            results = ca.cse([_dense(result) for result in made()])
            arguments = [self.equations.symbols[key] for key in ARGUMENTS[name]]
            paths = self.searched.symbols
            if self.searched and ca.depends_on(ca.vertcat(*map(ca.vec, results)), paths):
                if name in _OF_PATHS:
                    raise Untraceable("derivatives through paths that wrap have no compiled form")
                arguments.append(paths)
            self._made[name] = ca.Function(name, arguments, results)
        return self._made[name]


def _dense(result: Any) -> Any:
    """A result whose columns are there even where they are empty."""
    results = ca.densify(ca.SX(result))
    return results if results.shape[1] else ca.SX(results.shape[0], 1)


class Expressions:
    """Results of the functions of a traced system, one method for each function."""

    def __init__(self, equations: Equations) -> None:
        self._equations = equations

    def accelerate(self) -> list[Any]:
        """Accelerations, rates of internal states, health; multipliers if rows switch."""
        e = self._equations
        solution = e.chosen[1]
        results = [e.speeding(solution.a), e.rates, e.health(solution, has_switches=True)]
        return [*results, ca.vertcat(*solution.lam)] if e.switches else results

    def multipliers(self) -> list[Any]:
        """Accelerations of all joints, and multipliers."""
        e = self._equations
        (dynamics, solution), (a, yielding) = e.chosen, e.solved
        lam = [ZERO] * e.m
        rigid = solution.lam[: e.mh]
        couplings = getattr(e.system.coordinates, "couplings", None)
        if couplings is not None:
            on = e.unilateral.pushes(
                [lam if not way else ZERO for lam, way in zip(yielding, e.x.mode, strict=False)]
            )
            parts = zip(dynamics.needed(a), e.tau, on, strict=True)
            needed = numbers(ca.vertcat(*(n - t - push for n, t, push in parts)))
            slopes = [pair.function(e.x.q[pair.parent_q])[1] for pair in couplings.pairs]
            rigid = scalars(column(couplings.reduce(needed, slopes)[1]))
        blocks = (block.slots for block in e.system.layout.rigid)
        places = [slot for slots in blocks for slot in range(slots.start, slots.stop)]
        for slot, one in zip((*places, *e.unilateral.slots), (*rigid, *yielding), strict=True):
            lam[slot] = one
        return [ca.vertcat(*a), ca.vertcat(*lam)]

    def guards(self) -> list[Any]:
        """Margins of the mode, then the values of the guards of parts."""
        e = self._equations
        a, lam = e.solved
        margins = e.unilateral.margins(a, lam, e.velocity)
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
        on, held = rows.masked(chosen), e.rigid_rows.of(Level.POSITION)
        a = self._moved(held, on, chosen, on.g)
        return [e.moving(a), ca.vertcat(*on.g)]

    def stay(self) -> list[Any]:
        """Return the velocity change that ends the g' of active rows, and these rates."""
        e, rows = self._equations, self._switched
        chosen, rates = rows.of(Reach.GAP, Reach.SLIP, Reach.FRICTION), rows.rates(e.velocity)
        left = [rates[i] for i in chosen]
        a = self._moved(e.rigid_rows, rows.masked(chosen), chosen, left)
        return [e.moving(a), ca.vertcat(*left)]

    def _moved(
        self, rigid: Rows, on: Rows, chosen: Sequence[int], left: Sequence[Any]
    ) -> list[Any]:
        """The smallest motion that ends what is left of chosen rows and moves no rigid one."""
        e, still = self._equations, [ZERO] * len(rigid.J)
        slack, soft = [*still, *self._switched.slack_of(chosen)], list[float]()
        if e.soft:
            soft = [*[0.0] * len(still), *(e.soft[e.mh + i] for i in chosen)]
        factors = e.beside(rigid.beside(on), slack, soft)
        return factors.solve([ZERO] * e.nv, [*still, *(-one for one in left)]).a

    @property
    def _switched(self) -> SwitchedRows:
        rows = self._equations.unilateral
        if not isinstance(rows, SwitchedRows):
            raise Untraceable("unilateral and bounded constraints need a trace of all modes")
        return rows

    def _part_guards(self) -> list[Any]:
        e = self._equations
        a, lam = self.multipliers()
        now, results = (numbers(one) for one in (a, lam)), list[Any]()
        a, lam = now
        for part, slots in ((e.with_symbols(part), slots) for part, slots in guarding(e.system)):
            with tracing(part):
                values = part.guard_values(e.k, e.x, e.u, Now(a, lam[slots]))
                results += scalars(column(values))
        return results

    def expand(self) -> list[Any]:
        """All positions and velocities."""
        e = self._equations
        return [column(e.coordinates.q), column(e.coordinates.v)]

    def place(self) -> list[Any]:
        """A step of Newton's method onto the rows of positions, their g, and their health."""
        e = self._equations
        rows = e.rigid_rows.of(Level.POSITION)
        solution = e.beside(rows).solve([ZERO] * e.nv, [-g for g in rows.g])
        return [e.moving(solution.a), ca.vertcat(*rows.g), e.health(solution)]

    def settle(self) -> list[Any]:
        """Return the correction of velocities onto the rows, and the remaining rates."""
        e = self._equations
        rates = e.rigid_rows.velocities(e.velocity)
        solution = e.beside(e.rigid_rows).solve([ZERO] * e.nv, [-one for one in rates])
        return [e.moving(solution.a), ca.vertcat(*rates)]

    def gap(self) -> list[Any]:
        """The g of the rows of positions."""
        e = self._equations
        return [ca.vertcat(*e.rigid_rows.of(Level.POSITION).g)]

    def lift(self) -> list[Any]:
        """M^-1 J' (J M^-1 J')^-1 of the rows of positions, shape (nv, mg), and their health."""
        e = self._equations
        rows = e.rigid_rows.of(Level.POSITION)
        held, zero = e.beside(rows), [ZERO] * e.nv
        ones = [[ca.SX(float(i == j)) for i in range(e.mg)] for j in range(e.mg)]
        solutions = [held.solve(zero, one) for one in ones]
        columns = [ca.vertcat(*one.a) for one in solutions]
        share = e.health(solutions[0]) if solutions else ca.SX(1.0)
        return [ca.horzcat(*columns) if columns else ca.SX(e.nv, 0), share]

    def path_places(self) -> list[Any]:
        """Return the inputs of the search of wrapping paths."""
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
        """Return the residual of the equations of motion for accelerations and multipliers."""
        e = self._equations
        a, lam = (scalars(e.symbols[key]) for key in "al")
        return [implicit.residual(e, a, lam)]

    def balance(self) -> list[Any]:
        """The force that lacks for given accelerations and multipliers, and rates."""
        return implicit.balance(self._equations)

    def balance_slopes(self) -> list[Any]:
        """Slopes of the balance and of rates by q, v and z."""
        return implicit.balance_slopes(self._equations)

    def energy(self) -> list[Any]:
        """Kinetic and potential energy [J]."""
        e = self._equations
        kinetic, potential = implicit.energy(e)
        for part in e.loads:
            with tracing(part):
                potential += plain(part.potential(e.k, e.x))
        return [kinetic, potential]
