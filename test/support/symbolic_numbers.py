"""Parts asked with symbols: kinematics, and what expressions are in numbers."""

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols.kinematics import SymbolicKinematics
from mbd_ros.compiled.symbols.scalar import column, numbers
from mbd_ros.compiled.symbols.tree.links import tree_of
from mbd_ros.core.state import State


class Symbols:
    """Kinematics k at a state x of symbols, with nz internal states and nu inputs u."""

    def __init__(self, robot, nz=0, nu=0):
        nq, nv = robot.model.nq, robot.model.nv
        sizes = {"t": 1, "q": nq, "v": nv, "z": nz, "u": nu}
        self.given = [ca.SX.sym(name, n) for name, n in sizes.items()]
        t, q, v, z, self.u = map(numbers, self.given)
        self.k = SymbolicKinematics(robot, tree_of(robot.model), q, v)
        self.x = State(t[0], q, v, z)

    def number(self, expression, x, u=()):
        """What an expression, or an array of them, is at a state in numbers."""
        flat = np.asarray(expression, dtype=object)
        asked = ca.Function("f", self.given, [ca.densify(column(flat.ravel()))])
        return np.array(asked(*x[:4], np.array(u))).reshape(flat.shape)

    def slopes(self, expressions, x):
        """Slopes of expressions by q, in numbers."""
        slopes = ca.jacobian(column(expressions), self.given[1])
        return np.array(ca.Function("f", self.given[:4], [ca.densify(slopes)])(*x[:4]))
