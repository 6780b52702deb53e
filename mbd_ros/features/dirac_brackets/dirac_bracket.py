"""Dirac brackets of the coordinates and momenta of a scene with holonomic constraints g(q) = 0.

    x = (q, p), p = M v, chi = (g, psi), psi = J M^-1 p = g'
    {x_i, x_j}_D = {x_i, x_j} - {x_i, chi_a} C^-1_ab {chi_b, x_j},   C_ab = {chi_a, chi_b}

With A = J M^-1 J', D = d psi / dq at constant p and S = D M^-1 J' - J M^-1 D':

    {q, q'}_D = 0,   {q, p'}_D = 1 - M^-1 J' A^-1 J
    {p, p'}_D = J' A^-1 S A^-1 J - J' A^-1 D + D' A^-1 J

Source: P. A. M. Dirac, Canad. J. Math. 2, 1950, 129.
"""

from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols.trace import Traced
from mbd_ros.core.state import Array
from mbd_ros.methods.particles.particle_system import ParticleSystem
from mbd_ros.methods.particles.rigid_bonds import DistanceRow, PointRow

_MINORS = 3  # size up to which an inverse is an explicit formula


class DiracBracket:
    """Brackets of a scene as functions of its state.

    Args:
        q: Symbols of the coordinates, a column of n.
        v: Symbols of the velocities, a column of n.
        g: Independent constraints, a column of m.
        kinetic: Kinetic energy.

    Attributes:
        n: Number of coordinates.
        m: Number of constraints.
    """

    def __init__(self, q: Any, v: Any, g: Any, kinetic: Any) -> None:
        self.n = q.shape[0]
        self.m = g.shape[0]
        self._q = q
        self._p = ca.SX.sym("p", self.n)
        M = ca.densify(ca.hessian(kinetic, v)[0])
        self._momentum = ca.Function("momentum", [q, v], [M @ v])
        self._drift = ca.Function("drift", [q, v], [ca.jtimes(M @ v, q, v)])
        inverse = _inverse(M)
        J = ca.densify(ca.jacobian(g, q))
        self._g = g
        self._psi = J @ (inverse @ self._p)
        self._table = self._brackets(inverse, J) if self.m else _canonical(self.n)
        x = ca.vertcat(q, self._p)
        self._values = ca.Function("table", [q, self._p], [self._table])
        self._casimirs = ca.Function(
            "casimirs", [q, self._p], [ca.jacobian(ca.vertcat(self._g, self._psi), x)]
        )

    def _brackets(self, inverse: Any, J: Any) -> Any:
        D = ca.jacobian(self._psi, self._q)
        lift = inverse @ J.T
        A = _inverse(J @ lift)
        S = D @ lift - lift.T @ D.T
        unit = ca.SX.eye(self.n)
        by_p = unit - lift @ A @ J
        turn = J.T @ A @ S @ A @ J - J.T @ A @ D + D.T @ A @ J
        none = ca.SX(self.n, self.n)
        return ca.densify(ca.blockcat([[none, by_p], [-by_p.T, turn]]))

    @cached_property
    def _slopes(self) -> Any:
        x = ca.vertcat(self._q, self._p)
        slopes = ca.jacobian(ca.vec(self._table), x)
        return ca.Function("slopes", [self._q, self._p], [slopes])

    def momentum(self, q: Array, v: Array) -> Array:
        """Return the momentum M v, shape (n,)."""
        return _flat(self._momentum(q, v))

    def mass_rate(self, q: Array, v: Array) -> Array:
        """Return (dM/dt) v, shape (n,)."""
        return _flat(self._drift(q, v))

    def table(self, q: Array, p: Array) -> Array:
        """Return the brackets {x_i, x_j}_D of x = (q, p), shape (2 n, 2 n)."""
        return np.array(self._values(q, p).full())

    def jacobi(self, q: Array, p: Array) -> float:
        """Return the largest cyclic sum of {x_i, {x_j, x_k}}, which is 0 by Jacobi's identity."""
        size = 2 * self.n
        table = self.table(q, p)
        slopes = np.array(self._slopes(q, p).full()).reshape(size, size, size, order="F")
        nested = np.einsum("il,jkl->ijk", table, slopes)
        cyclic = nested + nested.transpose(1, 2, 0) + nested.transpose(2, 0, 1)
        return float(np.abs(cyclic).max())

    def casimirs(self, q: Array, p: Array) -> float:
        """Return the largest bracket with a constraint or its rate, which is 0 (Casimirs)."""
        slopes = np.array(self._casimirs(q, p).full())
        return float(np.abs(self.table(q, p).dot(slopes.T)).max(initial=0.0))

    def expressions(self, names: tuple[str, ...]) -> dict[tuple[str, str], str]:
        """Return the brackets that are not 0 as expressions, by pairs of names.

        Args:
            names: Names of the coordinates; momenta are p_<name>.
        """
        every = (*names, *(f"p_{name}" for name in names))
        symbols = [ca.SX.sym(name) for name in every]
        column = ca.vertcat(*symbols)
        named = self._values(column[: self.n], column[self.n :])
        return {
            (every[i], every[j]): str(ca.simplify(named[i, j]))
            for i in range(2 * self.n)
            for j in range(i + 1, 2 * self.n)
            if not named[i, j].is_zero()
        }


def of_mechanism(traced: Traced, rows: list[int]) -> DiracBracket:
    """Return the brackets of the coordinates that the solver of a mechanism integrates.

    Args:
        traced: Symbolic functions of the system.
        rows: Indices of independent constraint rows.
    """
    symbols = traced.equations.symbols
    t, q, v, z, p = (symbols[key] for key in "tqvzp")
    g = traced.function("gap")(0.0, q, p) if rows else ca.SX(0, 1)
    kinetic = traced.function("energy")(t, q, v, z, p)[0]
    return DiracBracket(q, v, g[rows] if rows else g, kinetic)


def of_particles(system: ParticleSystem, independent: list[int]) -> DiracBracket:
    """Return the brackets of the coordinates of particles.

    Args:
        system: System of the particles.
        independent: Indices of independent constraint rows.
    """
    q, v = ca.SX.sym("q", system.nv), ca.SX.sym("v", system.nv)
    rows, first = [], 0
    for kind in system.kinds:
        of_molecule = [row for cluster in kind.clusters for row in cluster.rows]
        for copy in range(kind.count):
            begin = first + copy * len(kind.atoms)
            rows += [_row(row, q, begin) for row in of_molecule]
        first += kind.size
    masses = np.repeat(system.masses, 3)
    chosen = [rows[i] for i in independent]
    return DiracBracket(q, v, ca.vertcat(*chosen), 0.5 * ca.dot(masses * v, v))


def _row(row: PointRow, q: Any, begin: int) -> Any:
    at = [q[3 * (begin + i) : 3 * (begin + i) + 3] for i, _ in row.ends]
    if isinstance(row, DistanceRow):
        d = at[0] - at[1]
        return (ca.dot(d, d) / row.length - row.length) / 2.0
    d = at[0] - row.center
    return ca.dot(row.squares * d + row.normal, d) - row.level


def _canonical(n: int) -> Any:
    unit, none = ca.SX.eye(n), ca.SX(n, n)
    return ca.densify(ca.blockcat([[none, unit], [-unit, none]]))


def _inverse(A: Any) -> Any:
    """Return A^-1 of a symmetric matrix, as short formulas if it is small or diagonal."""
    n = A.shape[0]
    if n == 1:
        return 1.0 / A
    off = [A[i, j] for i in range(n) for j in range(n) if i != j]
    if all(entry.is_zero() for entry in off):
        return ca.diag(1.0 / ca.diag(A))
    return ca.inv_minor(A) if n <= _MINORS else ca.solve(A, ca.SX.eye(n))


def _flat(result: Any) -> Array:
    return np.array(result.full()).ravel()
