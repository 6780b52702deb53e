"""The equations of motion of a system as expressions of symbols."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols import implicit
from mbd_ros.compiled.symbols.coordinates import Coordinates
from mbd_ros.compiled.symbols.curved import CurvedChart
from mbd_ros.compiled.symbols.dynamics import TreeDynamics, choices
from mbd_ros.compiled.symbols.kinematics import SymbolicKinematics
from mbd_ros.compiled.symbols.links import tree_of
from mbd_ros.compiled.symbols.motion import Held, Motion, Solution
from mbd_ros.compiled.symbols.rows import Rows, rows_of
from mbd_ros.compiled.symbols.scalar import column, numbers, plain, scalars
from mbd_ros.compiled.symbols.turns import ZERO
from mbd_ros.compiled.symbols.untraceable import Untraceable, tracing
from mbd_ros.compiled.symbols.usual_pivots import usual_pivots
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.row_laws import Level
from mbd_ros.core.state import State

ARGUMENTS = "tqvzup"


class Equations:
    """Expressions of a system.

    Args:
        system: The system.
        parameters: Names of numbers that stay symbols.

    Attributes:
        symbols: Argument -> its symbols, by letter.
        tree: The links of all joints.
        k: Kinematics of symbols.
        x: State of all joints.

    Raises:
        Untraceable: Names the part and why.
    """

    def __init__(self, system: System, parameters: tuple[str, ...]) -> None:
        self.system, self.parameters, self.tier = system, parameters, system.tier
        given = system.bounded or system.exact
        if given is not None:
            name = given.constraints.rows[0].name if system.bounded else "rows of the scene"
            raise Untraceable(f"{name} give way, which has no symbolic form yet")
        self.tree = tree_of(system.model)
        self.nq, self.nv, self.nz = system.nq, system.nv, system.internals.nz
        self.nu, self.m = len(system.loads.idle), len(system.multiplier_rows)
        self.mg, self.mh = len(system.rows), len(system.held.rows)
        sizes = {"t": 1, "q": self.nq, "v": self.nv, "z": self.nz, "u": self.nu}
        sizes |= {"p": len(parameters), "d": self.nv, "a": self.nv, "l": self.mh}
        self.symbols: dict[str, Any] = {name: ca.SX.sym(name, n) for name, n in sizes.items()}
        t, q, v, z, self.u = (numbers(self.symbols[name]) for name in "tqvzu")
        couplings = getattr(system.coordinates, "couplings", None)
        with tracing(couplings):
            self.coordinates = Coordinates(couplings, self.tree.nq, self.tree.nv, q, v)
        c, internals = self.coordinates, system.internals
        self.k = SymbolicKinematics(system.robot, self.tree, c.q, c.v)
        inside = self.k.within(z, internals.lower, internals.upper)
        self.x = State(t[0], c.q, c.v, inside)

    @cached_property
    def chart(self) -> CurvedChart:
        """The chart of what is integrated."""
        return CurvedChart(self.system.chart.model)

    @cached_property
    def tau(self) -> list[Any]:
        """Loads on all joints, SX scalars."""
        total: Any = self.k.zeros(self.tree.nv)
        for part in (*self.system.loads.actuators, *self.system.loads.forces):
            with tracing(part):
                total = total + part.force(self.k, self.x, self.u)
        return scalars(column(total))

    @cached_property
    def rates(self) -> Any:
        """Rates of the internal states, a column."""
        found = self.k.zeros(self.nz)
        for part in self.system.internals.parts:
            with tracing(part):
                found[part.z] = part.rates(self.k, self.x, self.u)
        return column(found)

    @cached_property
    def held(self) -> Rows:
        """Rows that accelerations and velocities keep."""
        return rows_of(self.system.held.constraints.blocks, self.k, self.x)

    @cached_property
    def bias(self) -> list[Any]:
        """The b of J a + b = 0, one SX scalar a row."""
        return self.held.conditions(self.velocity, self.system.held.constraints.gains)

    @cached_property
    def dynamics(self) -> list[TreeDynamics]:
        """In all axes that are worth a try."""
        q, v = (scalars(column(one)) for one in (self.coordinates.q, self.coordinates.v))
        return choices(self.tree, q, v, has_rows=self.mh > 0)

    @cached_property
    def chosen(self) -> tuple[TreeDynamics, Solution]:
        """The form of the fewest operations."""
        best, fewest = None, 0
        for dynamics in self.dynamics:
            motion = Motion(dynamics, self.coordinates, self.tau, self.held, self.bias)
            for solution in motion.solutions():
                count = self.operations(solution.a)
                if best is None or count < fewest:
                    best, fewest = (dynamics, solution), count
        assert best is not None
        return best

    @property
    def column_of_velocity(self) -> Any:
        """Velocity of all joints."""
        return column(self.coordinates.v)

    @property
    def velocity(self) -> list[Any]:
        """Of all joints, SX scalars."""
        return scalars(self.column_of_velocity)

    def operations(self, results: Sequence[Any]) -> int:
        """How many operations expressions take, common ones once."""
        inputs = [self.symbols[key] for key in ARGUMENTS]
        expressions = ca.cse([ca.vertcat(*results)])
        return int(ca.Function("count", inputs, expressions).n_instructions())

    def accelerate(self) -> list[Any]:
        """Accelerations, rates of the internal states, health of the rows."""
        solution = self.chosen[1]
        return [ca.vertcat(*solution.a), self.rates, self._health(solution)]

    def multipliers(self) -> list[Any]:
        """Accelerations of all joints, and multipliers."""
        dynamics, solution = self.chosen
        a = [ca.SX(one) for one in self.coordinates.lifted(solution.a)]
        lam = solution.lam
        couplings = getattr(self.system.coordinates, "couplings", None)
        if couplings is not None:
            needed = [n - t for n, t in zip(dynamics.needed(a), self.tau, strict=True)]
            slopes = [pair.function(self.x.q[pair.parent_q])[1] for pair in couplings.pairs]
            lam = couplings.reduce(numbers(ca.vertcat(*needed)), slopes)[1]
        return [ca.vertcat(*a), column(lam) if couplings is not None else ca.vertcat(*lam)]

    def expand(self) -> list[Any]:
        """All positions and velocities."""
        return [column(self.coordinates.q), column(self.coordinates.v)]

    def place(self) -> list[Any]:
        """A step of Newton's method onto the rows of positions, their g, and their health."""
        rows = self.held.of(Level.POSITION)
        solution = self.beside(rows).solve([ZERO] * self.nv, [-g for g in rows.g])
        return [ca.vertcat(*solution.a), ca.vertcat(*rows.g), self._health(solution)]

    def settle(self) -> list[Any]:
        """What leads velocities onto the rows, and the rates that are left."""
        rates = self.held.velocities(self.velocity)
        solution = self.beside(self.held).solve([ZERO] * self.nv, [-one for one in rates])
        return [ca.vertcat(*solution.a), ca.vertcat(*rates)]

    def gap(self) -> list[Any]:
        """The g of the rows of positions."""
        return [ca.vertcat(*self.held.of(Level.POSITION).g)]

    def lift(self) -> list[Any]:
        """M^-1 J' (J M^-1 J')^-1 of the rows of positions, shape (nv, mg), and their health."""
        rows = self.held.of(Level.POSITION)
        held, zero = self.beside(rows), [ZERO] * self.nv
        ones = [[ca.SX(float(i == j)) for i in range(self.mg)] for j in range(self.mg)]
        solutions = [held.solve(zero, one) for one in ones]
        columns = [ca.vertcat(*one.a) for one in solutions]
        health = self._health(solutions[0]) if solutions else ca.SX(1.0)
        return [ca.horzcat(*columns) if columns else ca.SX(self.nv, 0), health]

    def integrate(self) -> list[Any]:
        """The configuration q (+) d."""
        return [self.chart.integrate(self.symbols["q"], self.symbols["d"])]

    def rate(self) -> list[Any]:
        """The rate of d in q0 (+) d while q moves with v."""
        return [self.chart.rate(self.symbols["d"], self.symbols["v"])]

    def derivatives(self) -> list[Any]:
        """Slopes of accelerations and rates by q, v, z, u and p."""
        return implicit.derivatives(self)

    def residual(self) -> list[Any]:
        """What the equations of motion leave of given accelerations and multipliers."""
        a, lam = (scalars(self.symbols[key]) for key in "al")
        return [implicit.residual(self, a, lam)]

    def energy(self) -> list[Any]:
        """Kinetic and potential energy [J]."""
        kinetic, potential = implicit.energy(self)
        for part in (*self.system.loads.actuators, *self.system.loads.forces):
            with tracing(part):
                potential += plain(part.potential(self.k, self.x))
        return [kinetic, potential]

    def beside(self, rows: Rows) -> Held:
        """Factors of masses beside rows."""
        mass = self.coordinates.reduced_matrix(self.chosen[0].mass)
        return Held(mass, rows, self.nv)

    def _health(self, solution: Solution) -> Any:
        """The smallest pivot of the rows over its usual size."""
        health = ca.SX(1.0)
        if solution.pivots:
            usual = usual_pivots(self.system.robot, self.symbols, ca.vertcat(*solution.pivots))
            for pivot, size in zip(solution.pivots, np.asarray(usual).tolist(), strict=True):
                health = ca.fmin(health, pivot * (1.0 / size if size else 0.0))
        return health
