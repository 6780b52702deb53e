"""A system at symbolic time, state, inputs and parameters: what its equations are made of."""

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols.charts import CurvedChart, WorldAxes, WorldChart
from mbd_ros.compiled.symbols.kinematics import SymbolicKinematics
from mbd_ros.compiled.symbols.scalar import Scalar, column, numbers, plain, scalars
from mbd_ros.compiled.symbols.sparse_ldl import Entries
from mbd_ros.compiled.symbols.tree.links import Tree, tree_of, with_armature
from mbd_ros.compiled.symbols.untraceable import tracing
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.rows.constraint_rows import RowBlock
from mbd_ros.core.state import Mode, State

Made = Callable[[Mapping[str, Any]], Mapping[str, Any]]  # numbers by name -> parts by name


class SymbolicSystem:
    """A system whose time, state, inputs and parameters are symbols.

    Args:
        parameters: Names of numbers that stay symbols.
        mode: Of unilateral rows; None for all modes at once, which stand behind the parameters.
        made: Makes parts of symbols, by name.
        in_world: Whether velocities of free bodies stand in the axes of the world.

    Attributes:
        symbols: Argument -> its symbols, by letter.
        tree: The links of all joints.
        coordinates: All joints from what is integrated.
        k: Kinematics of symbols.
        x: State of all joints.
        switches: How many entries of a mode stand behind the parameters.
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
        self.switches = len(system.event_rows.names) if mode is None and system.event_rows else 0
        p = ca.SX.sym("p", len(parameters) + self.switches)
        self._symbolic = parts_of(made, parameters, p[: len(parameters)])
        self.tree = self._with_drive_inertias(tree_of(system.model))
        self.nq, self.nv, self.nz = system.nq, system.nv, system.internals.nz
        self.nu, self.m = len(system.loads.idle), len(system.multiplier_rows)
        self.mg, self.mh = len(system.rows), len(system.bilateral.rows)
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

    def with_symbols(self, part: Any) -> Any:
        """Return a part with symbols for its parameters; the part itself if it has none."""
        return self._symbolic.get(part.name, part)

    @cached_property
    def loads(self) -> list[Any]:
        """Actuators, then forces."""
        return [
            self.with_symbols(part)
            for part in (*self.system.loads.actuators, *self.system.loads.forces)
        ]

    def blocks(self, blocks: Sequence[RowBlock]) -> list[RowBlock]:
        """Return blocks of rows with symbols for the parameters of their parts."""
        return [with_part(block, self.with_symbols(block.part)) for block in blocks]

    def _with_drive_inertias(self, tree: Tree) -> Tree:
        """Return the tree with drive inertias that depend on parameters."""
        changed = [
            actuator for actuator in self.system.loads.actuators if actuator.name in self._symbolic
        ]
        armature: Any = self.system.model.armature.astype(object)
        for actuator in changed:
            with tracing(actuator):
                armature = armature + (
                    self.with_symbols(actuator).armature() - actuator.armature()
                )
        return with_armature(tree, [plain(each) for each in armature]) if changed else tree

    @cached_property
    def chart(self) -> CurvedChart:
        """The chart of what is integrated."""
        return (WorldChart if self.axes else CurvedChart)(self.system.chart.model)

    def moving(self, motion: Sequence[Any]) -> Any:
        """Return a tangent step or a velocity change in integrated coordinates, a column."""
        return ca.vertcat(*(self.axes.in_world(motion) if self.axes else motion))

    def speeding(self, a: Sequence[Any]) -> Any:
        """Return the rates of the integrated velocities, a column."""
        v = scalars(self.symbols["v"])
        return ca.vertcat(*(self.axes.rate(a, v) if self.axes else a))

    @property
    def column_of_velocity(self) -> Any:
        """Velocity of all joints."""
        return column(self.coordinates.v)

    @property
    def velocity(self) -> list[Any]:
        """Velocities of all joints, SX scalars."""
        return scalars(self.column_of_velocity)


def parts_of(made: Made, parameters: Sequence[str], p: Any) -> Mapping[str, Any]:
    """Return parts with symbolic parameters by name; none without parameters."""
    if not parameters:
        return {}
    values = dict(zip(parameters, numbers(p), strict=True))
    with tracing(", ".join(parameters)):
        return made(values)


def with_part(block: RowBlock, part: Any) -> RowBlock:
    """Return a block with the rows of another part of the same form."""
    if part is block.part:
        return block
    part_gains: Any = (np.asarray(gain, dtype=object) for gain in part.gains)
    gains = tuple(np.broadcast_to(gain, len(block.rows)) for gain in part_gains)
    if not any(map(np.any, block.gains)):  # rows that are on exactly
        gains = block.gains
    return block._replace(part=part, law=part.law, gains=gains)


class Coordinates:
    """Positions and velocities of all joints: q = F(y), v = G y', a = G y'' + drift.

    Every joint follows one coordinate, so G has one entry a row.

    Args:
        couplings: Dependent joints, which are eliminated; None where all joints are integrated.
        nq: Size of a configuration of all joints.
        nv: Size of a velocity of all joints.
        q: Configuration of what is integrated, an array of numbers.

    Attributes:
        q: Of all joints, an array of objects.
    """

    def __init__(self, couplings: Couplings | None, nq: int, nv: int, q: Any, v: Any) -> None:
        self.q, self.v, self.drift = (np.zeros(n, dtype=object) for n in (nq, nv, nv))
        self.drift.fill(0.0)
        self._column, self._slope = list(range(nv)), [1.0] * nv
        self.nv = len(v)
        if couplings is None:
            self.q[:], self.v[:] = q, v
            return
        self.q[couplings.q_index], self.v[couplings.v_index] = q, v
        for i, at in enumerate(couplings.v_index.tolist()):
            self._column[at] = i
        for child_q, child_v, parent_q, parent_v, function in couplings.pairs:
            rate = self.v[parent_v]
            self.q[child_q], slope, curvature = function(self.q[parent_q])
            self.v[child_v] = slope * rate
            self.drift[child_v] = slope * self.drift[parent_v] + curvature * rate * rate
            self._column[child_v] = self._column[parent_v]
            self._slope[child_v] = slope * self._slope[parent_v]

    def reduced(self, tau: Any) -> list[Any]:
        """Return G' tau, from SX scalars to SX scalars."""
        reduced: list[Any] = [0.0] * self.nv
        for force, i, slope in zip(tau, self._column, self._slope, strict=True):
            reduced[i] = reduced[i] + plain(slope) * force
        return reduced

    def reduced_row(self, row: dict[int, Any]) -> dict[int, Any]:
        """Return the row J G of a row of J, as entries by velocity."""
        reduced: dict[int, Any] = {}
        for j, value in row.items():
            column, share = self._column[j], plain(self._slope[j]) * value
            reduced[column] = reduced[column] + share if column in reduced else share
        return reduced

    def reduced_matrix(self, M: Entries) -> Entries:
        """Return G' M G, in lower triangles of SX scalars."""
        reduced: Entries = {}
        for (i, j), value in M.items():
            I, J = self._column[i], self._column[j]  # noqa: E741
            at = max(I, J), min(I, J)
            twice = 2.0 if i != j and I == J else 1.0
            share = plain(self._slope[i] * self._slope[j]) * twice * value
            reduced[at] = reduced[at] + share if at in reduced else share
        return reduced

    def lifted(self, a: Any) -> list[Any]:
        """Return G y'' + drift, the accelerations of all joints, SX scalars or floats."""
        pairs = zip(self._column, self._slope, self.drift, strict=True)
        return [plain(slope) * a[column] + plain(drift) for column, slope, drift in pairs]

    @property
    def moves_on(self) -> bool:
        """Whether a coupling is nonlinear, so that there is a drift."""
        return any(isinstance(value, Scalar) or value != 0.0 for value in self.drift)
