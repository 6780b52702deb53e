"""The force that lacks for the equation of motion as expressions, and its slopes."""

from typing import TYPE_CHECKING, Any

import casadi as ca

from mbd_ros.compiled.symbols.implicit import in_tangent, residual
from mbd_ros.compiled.symbols.scalar import scalars

if TYPE_CHECKING:
    from mbd_ros.compiled.symbols.equations import Equations


def balance(equations: "Equations") -> list[Any]:
    """The force tau - h - M a + J' lam, shape (nv,), and the rates of the internal states."""
    a, lam = (scalars(equations.symbols[key]) for key in "al")
    return [-residual(equations, a, lam)[: equations.nv], equations.rates]


def slopes(equations: "Equations") -> list[Any]:
    """Of both, stacked, by steps of q, by v and by z, each of shape (nv + nz, ..)."""
    both = ca.vertcat(*balance(equations))
    found = []
    for letter in "qvz":
        by = ca.jacobian(both, equations.symbols[letter])
        found.append(in_tangent(equations, letter, by))
    return found
