"""Elastic bonds, angles and torsions of molecules, for all molecules of a kind at once.

Positions and forces are (atoms, 3, lanes). Each term adds its force and gives its energy a lane.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.particles.row_geometry import product
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import TINY


class ElasticBond(NamedTuple):
    """V = k/2 (|x_i - x_j| - L)^2.

    Attributes:
        i: Number of the first point in the molecule.
        j: Number of the second.
        length: L.
        stiffness: k.
    """

    i: int
    j: int
    length: float
    stiffness: float

    def energy(self, x: Array) -> Array:
        """V, shape (lanes,)."""
        stretch = _norm(x[self.i] - x[self.j]) - self.length
        energy: Array = 0.5 * self.stiffness * stretch**2
        return energy

    def add_force(self, x: Array, force: Array) -> None:
        """Adds -dV/dx."""
        d = x[self.i] - x[self.j]
        r = np.maximum(_norm(d), TINY)
        pull = (self.stiffness * (self.length / r - 1.0)) * d
        force[self.i] += pull
        force[self.j] -= pull


class ElasticAngle(NamedTuple):
    """V = k/2 (theta - theta_0)^2, theta the angle at the second of three points.

    Attributes:
        i: Number of the first point in the molecule.
        j: Number of that at the corner.
        k: Number of the third.
        angle: theta_0 [rad].
        stiffness: k.
    """

    i: int
    j: int
    k: int
    angle: float
    stiffness: float

    def energy(self, x: Array) -> Array:
        """V, shape (lanes,)."""
        theta = self._corner(x)[0]
        energy: Array = 0.5 * self.stiffness * (theta - self.angle) ** 2
        return energy

    def add_force(self, x: Array, force: Array) -> None:
        """Adds -dV/dx; a straight angle has no direction of its force, and none is exerted."""
        theta, along, across, e, f, c, s = self._corner(x)
        size = -self.stiffness * (theta - self.angle) / np.maximum(s, TINY)
        size = np.where(s > TINY, size, 0.0)
        first = (size / along) * (c * e - f)
        third = (size / across) * (c * f - e)
        force[self.i] += first
        force[self.k] += third
        force[self.j] -= first + third

    def _corner(self, x: Array) -> tuple[Array, ...]:
        a, b = x[self.i] - x[self.j], x[self.k] - x[self.j]
        along, across = _norm(a), _norm(b)
        e, f = a / along, b / across
        c, s = product(e, f), _norm(np.cross(e, f, axis=0))
        return np.arctan2(s, c), along, across, e, f, c, s


class Torsion(NamedTuple):
    """V = sum_n c_n cos(phi)^n of the dihedral angle of four points, phi = 0 where cis.

    Attributes:
        points: Their numbers in the molecule.
        coefficients: c, from n = 0 on.

    Source: J.-P. Ryckaert, A. Bellemans, Chem. Phys. Lett. 30, 1975, 123-125, for the form;
        their angle is phi - pi.
    """

    points: tuple[int, int, int, int]
    coefficients: tuple[float, ...]

    def energy(self, x: Array) -> Array:
        """V, shape (lanes,)."""
        m, n = self._normals(x)[3:]
        cosine = product(m, n) / np.sqrt(product(m, m) * product(n, n))
        energy: Array = np.polynomial.polynomial.polyval(cosine, np.array(self.coefficients))
        return energy

    def add_force(self, x: Array, force: Array) -> None:
        """Adds -dV/dx."""
        i, j, k, end = self.points
        a, b, c, m, n = self._normals(x)
        mm, nn = product(m, m), product(n, n)
        size = np.sqrt(mm * nn)
        cosine = product(m, n) / size
        slopes = np.polynomial.polynomial.polyder(np.array(self.coefficients))
        slope = -np.polynomial.polynomial.polyval(cosine, slopes)
        by_m = slope * (n / size - (cosine / mm) * m)
        by_n = slope * (m / size - (cosine / nn) * n)
        of_a = np.cross(b, by_m, axis=0)
        of_b = np.cross(by_m, a, axis=0) + np.cross(c, by_n, axis=0)
        of_c = np.cross(by_n, b, axis=0)
        force[i] -= of_a
        force[j] += of_a - of_b
        force[k] += of_b - of_c
        force[end] += of_c

    def _normals(self, x: Array) -> tuple[Array, Array, Array, Array, Array]:
        i, j, k, end = self.points
        a, b, c = x[j] - x[i], x[k] - x[j], x[end] - x[k]
        return a, b, c, np.cross(a, b, axis=0), np.cross(b, c, axis=0)


ElasticTerm = ElasticBond | ElasticAngle | Torsion


def _norm(a: Array) -> Array:
    norm: Array = np.sqrt(product(a, a))
    return norm


def energy_of(terms: Sequence[ElasticTerm], x: Array) -> Array:
    """Sum of the energies, shape (lanes,)."""
    energy = np.zeros(x.shape[2])
    for term in terms:
        energy += term.energy(x)
    return energy
