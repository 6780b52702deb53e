"""Explicit Runge-Kutta method of order 5 by Dormand and Prince."""

from typing import ClassVar

import numpy as np

from mbd_ros.methods.integration.runge_kutta import Tableau, matrix
from mbd_ros.methods.integration.tableau_integrator import ExplicitRungeKutta

# fmt: off
_STEP = [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84, 0]
_FOURTH_ORDER = [
    5179 / 57600, 0, 7571 / 16695, 393 / 640, -92097 / 339200, 187 / 2100, 1 / 40,
]
_A = [
    [],
    [1 / 5],
    [3 / 40, 9 / 40],
    [44 / 45, -56 / 15, 32 / 9],
    [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729],
    [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656],
    _STEP,
]
_DENSE = [
    -12715105075 / 11282082432, 0, 87487479700 / 32700410799, -10690763975 / 1880347072,
    701980252875 / 199316789632, -1453857185 / 822651844, 69997945 / 29380423,
]
# fmt: on
_TABLEAU = Tableau(
    matrix([dict(enumerate(row)) for row in _A], 7),
    stages=6,
    error_order=4,
    errors=np.subtract([_STEP], _FOURTH_ORDER),
    dense=np.array([_DENSE]),
)


class Dopri5(ExplicitRungeKutta):
    """DOPRI5: order 5, six evaluations a step, dense output of order 4.

    Source: Dormand, Prince, J. Comp. Appl. Math. 6, 1980; dense output: Hairer, Nørsett, Wanner,
    Solving Ordinary Differential Equations I, 1993, II.6.

    Args:
        tolerance: Relative and absolute, 1e-13 .. 0.1: largest error of a step in q [rad or m]
            and v [rad/s or m/s], as the root mean square of e_i / (1 + |y_i|) over y = [q; v].
            The step size follows from it. None: steps of length dt.
    """

    order: ClassVar[int] = 5
    native = "runge_kutta"
    tableau: ClassVar[Tableau] = _TABLEAU
    stable = 1.3  # without damping; 2.4 with a twentieth of the critical one
    example = {"tolerance": 1e-6}
