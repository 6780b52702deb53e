"""The equations of motion of a system as expressions of symbols."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols.curved import CurvedChart, turn_rate, turned
from mbd_ros.compiled.symbols.kinematics import SymbolicKinematics
from mbd_ros.compiled.symbols.mode_switches import SwitchedRows
from mbd_ros.compiled.symbols.motion import (
    Held,
    Margin,
    Motion,
    Pushes,
    Solution,
    YieldingRows,
    softness,
)
from mbd_ros.compiled.symbols.rows import Coordinates, Rows, rows_of
from mbd_ros.compiled.symbols.scalar import column, numbers, plain, scalars
from mbd_ros.compiled.symbols.tree import link_rotations as turns
from mbd_ros.compiled.symbols.tree.dynamics import TreeDynamics, choices
from mbd_ros.compiled.symbols.tree.link_rotations import (
    ZERO,
    Vector,
    cross,
    minus,
    plus,
    through,
    transposed,
)
from mbd_ros.compiled.symbols.tree.links import Tree, tree_of, with_armature
from mbd_ros.compiled.symbols.tree.moving_tree import rotation_of
from mbd_ros.compiled.symbols.untraceable import tracing
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.rows.constraint_rows import RowBlock
from mbd_ros.core.state import Mode, State

# ---- parts of ---------------------------------------------------------------------------------
# Parts with symbols for some of their numbers.


Made = Callable[[Mapping[str, Any]], Mapping[str, Any]]


def parts_of(made: Made, parameters: Sequence[str], p: Any) -> Mapping[str, Any]:
    """Parts of symbols by name; none without parameters."""
    if not parameters:
        return {}
    given = dict(zip(parameters, numbers(p), strict=True))
    with tracing(", ".join(parameters)):
        return made(given)


def with_part(block: RowBlock, part: Any) -> RowBlock:
    """A block of rows of another part of the same form."""
    if part is block.part:
        return block
    given: Any = (np.asarray(one, dtype=object) for one in part.gains)
    gains = tuple(np.broadcast_to(one, len(block.rows)) for one in given)
    if not any(map(np.any, block.gains)):  # rows that are on exactly
        gains = block.gains
    return block._replace(part=part, law=part.law, gains=gains)


# ---- equations --------------------------------------------------------------------------------
# The equations of motion of a system as expressions of symbols.


# Velocities of free bodies in the axes of the world, in symbols; see `core.dynamics.world_axes`.
#
# Where contacts of free bodies are found, runs integrate these; all else is in axes of the bodies.


class WorldChart(CurvedChart):
    """Configurations of which free bodies move along straight lines and turn, in world axes."""

    def _moved(self, pose: list[Any], step: list[Any]) -> list[Any]:
        place = plus(tuple(pose[:3]), tuple(step[:3]))
        return [*place, *turned(pose[3:], tuple(step[3:]), in_world=True)]

    def _rate(self, step: list[Any], v: list[Any]) -> list[Any]:
        return [*v[:3], *turn_rate(tuple(step[3:]), tuple(v[3:]))]


class WorldAxes:
    """From axes of the bodies to those of the world, and back.

    Args:
        model: Pinocchio model whose joints have the coordinates that are integrated.
        q: Configuration of these, SX scalars.
    """

    def __init__(self, model: Any, q: Sequence[Any]) -> None:
        bases = [joint for joint in model.joints if joint.nv == 6]
        self._axes = {
            int(joint.idx_v): rotation_of(q[joint.idx_q + 3 : joint.idx_q + 7]) for joint in bases
        }

    def in_world(self, v: Sequence[Any]) -> list[Any]:
        """Velocities, or small motions, in the axes of the world, SX scalars."""
        found = list(v)
        for at, R in self._vectors():
            found[at : at + 3] = through(R, tuple(v[at : at + 3]))
        return found

    def in_own_axes(self, v: Sequence[Any]) -> list[Any]:
        """The reverse of `in_world`."""
        found = list(v)
        for at, R in self._vectors():
            found[at : at + 3] = through(transposed(R), tuple(v[at : at + 3]))
        return found

    def rate(self, a: Sequence[Any], v: Sequence[Any]) -> list[Any]:
        """Rates of velocities in the axes of the world, SX scalars.

        Args:
            a: Accelerations in the axes of the bodies.
            v: Velocities in those of the world.
        """
        found = self.in_world(a)
        for at in self._axes:
            along: Vector = tuple(v[at : at + 3])
            turning = cross(tuple(v[at + 3 : at + 6]), along)
            found[at : at + 3] = plus(tuple(found[at : at + 3]), turning)
        return found

    def slowing(self, a: Sequence[Any], v: Sequence[Any]) -> list[Any]:
        """The reverse of `rate`."""
        found = list(a)
        for at in self._axes:
            turning = cross(tuple(v[at + 3 : at + 6]), tuple(v[at : at + 3]))
            found[at : at + 3] = minus(tuple(a[at : at + 3]), turning)
        return self.in_own_axes(found)

    def _vectors(self) -> Iterator[tuple[int, turns.Matrix]]:
        for at, R in self._axes.items():
            yield at, R
            yield at + 3, R


ARGUMENTS = "tqvzup"


class Equations:
    """Expressions of a system.

    Args:
        system: The system.
        parameters: Names of numbers that stay symbols.
        mode: Of rows that give way; None for all modes at once, as `SwitchedRows` has them.
        made: Makes parts of symbols, by name.
        in_world: Whether velocities of free bodies stand in the axes of the world.

    Attributes:
        symbols: Argument -> its symbols, by letter.
        tree: The links of all joints.
        k: Kinematics of symbols.
        x: State of all joints.
        switches: How many entries of a mode stand behind the parameters.
        yielding: Rows that give way.
        axes: Of free bodies whose velocities stand in those of the world; None without any.

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
        self.system, self.parameters, self.tier = system, parameters, system.tier
        self.switches = len(system.exact.names) if mode is None and system.exact else 0
        p = ca.SX.sym("p", len(parameters) + self.switches)
        self._symbolic = parts_of(made, parameters, p[: len(parameters)])
        self.tree = self._moved(tree_of(system.model))
        self.nq, self.nv, self.nz = system.nq, system.nv, system.internals.nz
        self.nu, self.m = len(system.loads.idle), len(system.multiplier_rows)
        self.mg, self.mh = len(system.rows), len(system.held.rows)
        sizes = {"t": 1, "q": self.nq, "v": self.nv, "z": self.nz, "u": self.nu}
        sizes |= {"d": self.nv, "a": self.nv}
        self.symbols: dict[str, Any] = {name: ca.SX.sym(name, n) for name, n in sizes.items()}
        self.symbols["p"] = p
        t, q, v, z, self.u = (numbers(self.symbols[name]) for name in "tqvzu")
        self.axes = WorldAxes(system.chart.model, scalars(self.symbols["q"])) if in_world else None
        if self.axes is not None:
            v = numbers(ca.vertcat(*self.axes.in_own_axes(scalars(self.symbols["v"]))))
        couplings = getattr(system.coordinates, "couplings", None)
        with tracing(couplings):
            self.coordinates = Coordinates(couplings, self.tree.nq, self.tree.nv, q, v)
        c, internals = self.coordinates, system.internals
        self.k = SymbolicKinematics(system.robot, self.tree, c.q, c.v)
        inside = self.k.within(z, internals.lower, internals.upper)
        self.x = State(t[0], c.q, c.v, inside, mode or ())
        self.yielding = self._yielding(mode)
        self.symbols["l"] = ca.SX.sym("l", self.mh + len(self.yielding.on.J))

    def _yielding(self, mode: Mode | None) -> YieldingRows:
        if mode is not None or not self.switches:
            return YieldingRows(self, mode or ())
        return SwitchedRows(self, scalars(self.symbols["p"])[-self.switches :])

    def own(self, part: Any) -> Any:
        """The part with symbols for its parameters; itself where it has none."""
        return self._symbolic.get(part.name, part)

    @cached_property
    def loads(self) -> list[Any]:
        """Actuators, then forces."""
        return [self.own(one) for one in (*self.system.loads.actuators, *self.system.loads.forces)]

    def blocks(self, given: Sequence[RowBlock]) -> list[RowBlock]:
        """Blocks of rows, with symbols for the parameters of their parts."""
        return [with_part(block, self.own(block.part)) for block in given]

    def _moved(self, tree: Tree) -> Tree:
        """The tree with what parameters change of the inertia of drives."""
        changed = [one for one in self.system.loads.actuators if one.name in self._symbolic]
        armature: Any = self.system.model.armature.astype(object)
        for one in changed:
            with tracing(one):
                armature = armature + (self.own(one).armature() - one.armature())
        return with_armature(tree, [plain(each) for each in armature]) if changed else tree

    @cached_property
    def chart(self) -> CurvedChart:
        """The chart of what is integrated."""
        return (WorldChart if self.axes else CurvedChart)(self.system.chart.model)

    def moving(self, way: Sequence[Any]) -> Any:
        """A small motion of what is integrated, or a change of its velocity, a column."""
        return ca.vertcat(*(self.axes.in_world(way) if self.axes else way))

    def speeding(self, a: Sequence[Any]) -> Any:
        """Rates of the velocities that are integrated, a column."""
        v = scalars(self.symbols["v"])
        return ca.vertcat(*(self.axes.rate(a, v) if self.axes else a))

    @cached_property
    def tau(self) -> list[Any]:
        """Loads, and rows at a bound, on all joints, SX scalars."""
        total: Any = self.k.zeros(self.tree.nv)
        for part in self.loads:
            with tracing(part):
                total = total + part.force(self.k, self.x, self.u)
        known = self.yielding.known()
        return [force + push for force, push in zip(scalars(column(total)), known, strict=True)]

    @cached_property
    def rates(self) -> Any:
        """Rates of the internal states, a column."""
        found = self.k.zeros(self.nz)
        for part in map(self.own, self.system.internals.parts):
            with tracing(part):
                found[part.z] = part.rates(self.k, self.x, self.u)
        return column(found)

    def balance(self, w: Any) -> Any:
        """What is zero where w, a column, are the rates of the internal states; a column."""
        found, given = self.k.zeros(self.nz), numbers(w)
        for part in map(self.own, self.system.internals.parts):
            with tracing(part):
                found[part.z] = part.balance(self.k, self.x, self.u, given[part.z])
        return column(found)

    @cached_property
    def held(self) -> Rows:
        """Rigid rows that accelerations and velocities keep."""
        return rows_of(self.blocks(self.system.held.constraints.blocks), self.k, self.x)

    @cached_property
    def bias(self) -> list[Any]:
        """The b of J a + b = 0, one SX scalar a row that acts."""
        rigid = self.held.conditions(self.velocity, self.system.held.constraints.gains)
        return [*rigid, *self.yielding.bias]

    @cached_property
    def slack(self) -> list[Any]:
        """The s of J a + s lam + b = 0; empty where all are none."""
        return [*[ZERO] * self.mh, *self.yielding.slack] if self.yielding.slack else []

    @cached_property
    def soft(self) -> list[float]:
        """As `soundness.softness`."""
        return softness(self)

    @cached_property
    def pushing(self) -> Pushes:
        """Rows that push otherwise than they hold, as `Held.pushes`."""
        return {self.mh + i: push for i, push in self.yielding.pushing.items()}

    @cached_property
    def acting(self) -> Rows:
        """Rigid rows, then those that are on in the mode, in what is integrated."""
        return self.held.beside(self.yielding.on)

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
            more = self.slack, self.pushing, self.soft
            motion = Motion(dynamics, self.coordinates, self.tau, self.acting, self.bias, *more)
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
        inputs = [*(self.symbols[key] for key in ARGUMENTS), self.k.searches.symbols]
        expressions = ca.cse([ca.vertcat(*results)])
        return int(ca.Function("count", inputs, expressions).n_instructions())

    @cached_property
    def solved(self) -> tuple[list[Any], list[Any]]:
        """Accelerations of all joints, and multipliers of rows that give way, SX scalars."""
        solution = self.chosen[1]
        a = [ca.SX(one) for one in self.coordinates.lifted(solution.a)]
        return a, self.yielding.multipliers(solution.lam[self.mh :])

    @property
    def margins(self) -> tuple[Margin, ...]:
        """Keys of the margins of the mode."""
        a, lam = self.solved
        return tuple(self.yielding.margins(a, lam, self.velocity))

    def beside(self, rows: Rows, slack: Sequence[Any] = (), soft: Sequence[float] = ()) -> Held:
        """Factors of masses beside rows."""
        mass = self.coordinates.reduced_matrix(self.chosen[0].mass)
        return Held(mass, rows, self.nv, slack, soft=soft)
