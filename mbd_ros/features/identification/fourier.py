"""Periodic motions that begin and end at rest: finite Fourier series of velocities.

    v = sum_l A_l cos(l w t) + B_l sin(l w t),   sum A_l = 0,   sum l B_l = 0

so that velocity and acceleration are 0 at t = 0 and after every period.

Source: J. Swevers et al., IEEE Trans. Robot. Autom. 13, 1997, 730 (Fourier series to excite
robots).
"""

from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array


class Fourier(NamedTuple):
    """A motion of joints.

    Attributes:
        centre: Mean position [rad or m], shape (n,).
        A: Cosines of the velocity [rad/s or m/s], shape (harmonics, n).
        B: Sines of the velocity, same shape.
        period: [s].
    """

    centre: Array
    A: Array
    B: Array
    period: float

    @classmethod
    def at_rest(cls, centre: Array, A: Array, B: Array, period: float) -> "Fourier":
        """The nearest motion that begins at rest."""
        harmonic = np.arange(1.0, len(A) + 1.0)[:, None]
        B = B - harmonic * (harmonic * B).sum(axis=0) / np.square(harmonic).sum()
        return cls(centre, A - A.mean(axis=0), B, period)

    def scaled(self, share: Array) -> "Fourier":
        """With other amplitudes of each joint, about the same centre."""
        return self._replace(A=self.A * share, B=self.B * share)

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration at times [s] of shape (k,), shape (k, n) each."""
        w = 2.0 * np.pi / self.period * np.arange(1.0, len(self.A) + 1.0)
        s, c = np.sin(np.outer(t, w)), np.cos(np.outer(t, w))
        position = self.centre + (s / w) @ self.A - (c / w) @ self.B
        return position, c @ self.A + s @ self.B, (c * w) @ self.B - (s * w) @ self.A
