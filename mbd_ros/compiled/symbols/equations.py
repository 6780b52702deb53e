"""The equations of motion of a system as expressions of symbols."""

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols.constrained_motion import (
    SOFT,
    ConstrainedMotion,
    Pushes,
    Rows,
    Solution,
    rows_of,
)
from mbd_ros.compiled.symbols.scalar import column, numbers, scalars
from mbd_ros.compiled.symbols.symbolic_system import Made, SymbolicSystem
from mbd_ros.compiled.symbols.tree.dynamics import LONG, TreeDynamics, choices
from mbd_ros.compiled.symbols.tree.link_rotations import ZERO
from mbd_ros.compiled.symbols.unilateral_rows import Margin, SwitchedRows, UnilateralRows
from mbd_ros.compiled.symbols.untraceable import tracing
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.rows.delassus import configurations
from mbd_ros.core.state import Array, Mode, State

_ARGUMENTS = "tqvzup"


class Equations(SymbolicSystem):
    """Loads, rows and accelerations of a system.

        M a + h = tau + J' lam,   J a + s lam + b = 0

    Rigid rows have s = 0. Unilateral rows stand in one mode, or in all modes at once, which
    switch them by s.

    Args:
        parameters: Names of numbers that stay symbols.
        mode: Of unilateral rows; None for all modes at once, as `SwitchedRows` has them.
        made: Makes parts of symbols, by name.
        in_world: Whether velocities of free bodies stand in the axes of the world.

    Raises:
        Untraceable: Names the part and why.
    """

    def __init__(
        self,
        system: System,
        parameters: tuple[str, ...],
        mode: Mode | None,
        made: Made,
        *,
        in_world: bool = False,
    ) -> None:
        super().__init__(system, parameters, mode, made, in_world=in_world)
        self.unilateral: UnilateralRows
        if mode is None and self.switches:
            self.unilateral = SwitchedRows(self, scalars(self.symbols["p"])[-self.switches :])
        else:
            self.unilateral = UnilateralRows(self, mode or ())
        self.symbols["l"] = ca.SX.sym("l", self.mh + len(self.unilateral.on.J))

    @cached_property
    def tau(self) -> list[Any]:
        """Loads, and rows at a bound, on all joints, SX scalars."""
        total: Any = self.k.zeros(self.tree.nv)
        for part in self.loads:
            with tracing(part):
                total = total + part.force(self.k, self.x, self.u)
        known = self.unilateral.known()
        return [force + push for force, push in zip(scalars(column(total)), known, strict=True)]

    @cached_property
    def rates(self) -> Any:
        """Rates of the internal states, a column."""
        rates = self.k.zeros(self.nz)
        for part in map(self.with_symbols, self.system.internals.parts):
            with tracing(part):
                rates[part.z] = part.rates(self.k, self.x, self.u)
        return column(rates)

    def balance(self, w: Any) -> Any:
        """Return the residual of rates w of the internal states, a column."""
        residual, w_values = self.k.zeros(self.nz), numbers(w)
        for part in map(self.with_symbols, self.system.internals.parts):
            with tracing(part):
                residual[part.z] = part.balance(self.k, self.x, self.u, w_values[part.z])
        return column(residual)

    @cached_property
    def rigid_rows(self) -> Rows:
        """Rows of bilateral constraints."""
        return rows_of(self.blocks(self.system.bilateral.constraints.blocks), self.k, self.x)

    @cached_property
    def active_rows(self) -> Rows:
        """Bilateral rows, then active unilateral rows, in integrated coordinates."""
        return self.rigid_rows.beside(self.unilateral.on)

    @cached_property
    def bias(self) -> list[Any]:
        """The b of J a + b = 0, one SX scalar for each active row."""
        rigid = self.rigid_rows.conditions(self.velocity, self.system.bilateral.constraints.gains)
        return [*rigid, *self.unilateral.bias]

    @cached_property
    def slack(self) -> list[Any]:
        """The s of J a + s lam + b = 0; empty if all are zero."""
        return [*[ZERO] * self.mh, *self.unilateral.slack] if self.unilateral.slack else []

    @cached_property
    def pushing(self) -> Pushes:
        """Force directions of rows that differ from J, see `ConstrainedMotion`."""
        return {self.mh + i: push for i, push in self.unilateral.pushing.items()}

    @cached_property
    def soft(self) -> list[float]:
        """Regularization of contacts, whose rows may be dependent, one number a row."""
        contacts = self.unilateral.touching
        if not contacts:
            return []
        mass = self.coordinates.reduced_matrix(self.dynamics[0].mass)
        pivots = ConstrainedMotion(mass, self.active_rows, self.nv, self.slack).pivots
        usual = self._usual_pivots(pivots, self.switches)
        sizes = np.abs(usual[self.mh :]).tolist()
        softness = [0.0] * len(self.slack)
        for i in contacts:
            most = max(sizes[i : i + 3]) or 1.0
            softness[self.mh + i : self.mh + i + 3] = [SOFT * most] * 3
        return softness

    @cached_property
    def dynamics(self) -> list[TreeDynamics]:
        """Equations of the tree in all axes that may lead to few operations."""
        q, v = (scalars(column(entry)) for entry in (self.coordinates.q, self.coordinates.v))
        return choices(self.tree, q, v, has_rows=self.mh > 0)

    @cached_property
    def chosen(self) -> tuple[TreeDynamics, Solution]:
        """The form with the fewest operations."""
        best, fewest = None, 0
        for dynamics in self.dynamics:
            for solution in self._solutions(dynamics):
                count = self.operations(solution.a)
                if best is None or count < fewest:
                    best, fewest = (dynamics, solution), count
        assert best is not None
        return best

    def _solutions(self, dynamics: TreeDynamics) -> Iterator[Solution]:
        """Yield the accelerations in all forms that may lead to few operations."""
        is_open_chain = not self.active_rows.J and self.nv == self.tree.nv
        if is_open_chain:
            yield Solution(dynamics.articulated(self.tau), [], [])
        if not is_open_chain or self.nv <= LONG:
            yield self._solved_by_factors(dynamics)

    def _solved_by_factors(self, dynamics: TreeDynamics) -> Solution:
        """Return the accelerations from a factorization of masses and rows."""
        c = self.coordinates
        if c.moves_on:
            h = dynamics.needed([ca.SX(entry) for entry in c.lifted([ZERO] * c.nv)])
        else:
            h = dynamics.forces()
        forces = c.reduced([force - bias for force, bias in zip(self.tau, h, strict=True)])
        motion = ConstrainedMotion(
            *(c.reduced_matrix(dynamics.mass), self.active_rows, c.nv),
            *(self.slack, self.pushing, self.soft),
        )
        rates = [-entry for entry in self.bias]
        solve = motion.balanced if any(self.soft) else motion.solve
        return solve(forces, rates)

    def operations(self, results: Sequence[Any]) -> int:
        """Return the number of operations of expressions, with common subexpressions."""
        inputs = [*(self.symbols[key] for key in _ARGUMENTS), self.k.searches.symbols]
        expressions = ca.cse([ca.vertcat(*results)])
        return int(ca.Function("count", inputs, expressions).n_instructions())

    @cached_property
    def solved(self) -> tuple[list[Any], list[Any]]:
        """Accelerations of all joints, and multipliers of unilateral rows, SX scalars."""
        solution = self.chosen[1]
        a = [ca.SX(entry) for entry in self.coordinates.lifted(solution.a)]
        return a, self.unilateral.multipliers(solution.lam[self.mh :])

    @property
    def margins(self) -> tuple[Margin, ...]:
        """Keys of the margins of the mode."""
        a, lam = self.solved
        return tuple(self.unilateral.margins(a, lam, self.velocity))

    def beside(
        self, rows: Rows, slack: Sequence[Any] = (), soft: Sequence[float] = ()
    ) -> ConstrainedMotion:
        """Return the factorization of masses and rows."""
        mass = self.coordinates.reduced_matrix(self.chosen[0].mass)
        return ConstrainedMotion(mass, rows, self.nv, slack, soft=soft)

    def health(self, solution: Solution, *, has_switches: bool = False) -> Any:
        """Return the smallest pivot of the rows over its usual size; 0 for an unsound solution.

        Args:
            solution: Solution with rows, the unilateral ones last.
            has_switches: Whether the mode of some rows is an argument.
        """
        smallest, count = ca.SX(1.0), self.switches if has_switches else 0
        off = self.slack if count else [ZERO] * len(solution.pivots)
        is_soft = [False] * len(off)
        if solution.sound is not None:
            smallest = ca.fmin(solution.sound, self.unilateral.directed)
            is_soft = [entry > 0.0 for entry in self.soft]
        if solution.pivots:
            usual = self._usual_pivots(solution.pivots, count).tolist()
            for i, pivot in enumerate(solution.pivots):
                if not is_soft[i]:
                    share = pivot * (1.0 / usual[i] if usual[i] else 0.0)
                    smallest = ca.fmin(smallest, share + off[i] * (1.0 - share))
        return smallest

    def _usual_pivots(self, pivots: Sequence[Any], switches: int) -> Array:
        """Return the medians of pivots over the range of the joints, at rest, shape (m,).

        Args:
            pivots: Expressions of configuration and time.
            switches: How many of the rows, the last ones, have an entry of a mode behind the
                parameters: each is measured while the others of these are off.
        """
        arguments = [self.symbols[key] for key in _ARGUMENTS]
        evaluate = ca.Function("pivots", arguments, [ca.vertcat(*pivots)])
        v, z, u, p = (np.zeros(self.symbols[key].shape[0]) for key in "vzup")
        still, first = np.zeros(self.system.model.nv), len(p) - switches
        every = [
            self.system.reduce(State(0.0, q, still)).q for q in configurations(self.system.robot)
        ]

        def medians() -> Array:
            values = np.array([np.array(evaluate(0.0, q, v, z, u, p)).ravel() for q in every])
            return np.asarray(np.median(np.where(np.isfinite(values), values, 0.0), axis=0))

        if switches:
            p[first:] = 1.0
        usual = medians()
        for i in range(switches):
            p[first:] = np.arange(switches) != i
            usual[i - switches] = medians()[i - switches]
        return usual
