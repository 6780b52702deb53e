"""The equations of motion of a system as expressions of symbols."""

from typing import Any

import casadi as ca

from mbd_ros.compiled.symbols import open_chain
from mbd_ros.compiled.symbols.links import tree_of
from mbd_ros.compiled.symbols.untraceable import Untraceable
from mbd_ros.core.dynamics.system import System


class Equations:
    """Expressions of a system.

    Args:
        system: The system.
        parameters: Names of numbers that stay symbols.

    Attributes:
        symbols: Argument -> its symbols, by letter.

    Raises:
        Untraceable: Names the part and why.
    """

    def __init__(self, system: System, parameters: tuple[str, ...]) -> None:
        self._system, self.parameters, self.tier = system, parameters, system.tier
        if system.multiplier_rows or not system.loads.is_empty or parameters:
            raise Untraceable("rows, forces and parameters have no symbolic form yet")
        self.tree = tree_of(system.model)
        self.nq, self.nv, self.nz = system.nq, system.nv, system.internals.nz
        self.nu, self.m, self.mg = len(system.loads.idle), 0, len(system.rows)
        sizes = {"t": 1, "q": self.nq, "v": self.nv, "z": self.nz, "u": self.nu}
        sizes["p"] = len(parameters)
        self.symbols: dict[str, Any] = {name: ca.SX.sym(name, n) for name, n in sizes.items()}

    def accelerate(self) -> list[Any]:
        """Accelerations, rates of the internal states, health of the rows."""
        inputs = [self.symbols[name] for name in "tqvzup"]
        q, v = (ca.vertsplit(self.symbols[name]) for name in "qv")
        a = open_chain.cheapest(self.tree, q, v, [ca.SX(0.0)] * self.nv, inputs)
        return [a, ca.SX(self.nz, 1), ca.SX(1.0)]

    def expand(self) -> list[Any]:
        """All positions and velocities."""
        return [self.symbols["q"], self.symbols["v"]]

    def multipliers(self) -> list[Any]:
        """Accelerations of all joints, and multipliers."""
        return [self.accelerate()[0], ca.SX(self.m, 1)]
