"""A motion with muscle dynamics: its known quantities, and the muscle states that explain it.

A trial holds, at the start and at the collocation points of a mesh, the forces that muscles and
reserves can exert, the forces that the motion needs, and the prices of activations. Excitations
are unknown.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.muscles.degroote_fregly_curves import DeGrooteFreglyCurves
from mbd_ros.core.muscles.muscle import FirstOrder, Muscle, SmoothFirstOrder
from mbd_ros.core.state import Array

ACTIVATION, TENDON = "activation", "tendon"
_CURVES = DeGrooteFreglyCurves(4.0, 0.6, 0.049, 1.0, 0.01)  # replace curves with kinks
_STEEPNESS = 0.1  # of their change from rising to falling activation


class Trial(NamedTuple):
    """Known quantities at the start and at all points, with n muscles and r reserves.

    Attributes:
        widths: Widths of the intervals [s], shape (intervals,).
        length: Path lengths [m], shape (points, n).
        strength: Change of the tension with the activation beside rigid tendons [N], shape
            (points, n).
        offset: Tension without activation beside rigid tendons [N], shape (points, n).
        columns: Force on the independent coordinates by a tension of 1 N, and by a reserve of
            effort 1, shape (points, nv_y, n + r).
        needed: Force that the motion needs at each independent coordinate [N·m or N], shape
            (points, nv_y).
        sizes: Characteristic sizes of that force, shape (nv_y,).
        prices: Prices of excitations, shape (points, n).
        stiffness: Prices of the squared distance of activations from measured ones, shape
            (points, n).
        target: Measured activations, shape (points, n).
        least: Lower bounds of activations, shape (points, n).
        limits: Smallest and largest efforts of the reserves, shape (2, r).
    """

    widths: Array
    length: Array
    strength: Array
    offset: Array
    columns: Array
    needed: Array
    sizes: Array
    prices: Array
    stiffness: Array
    target: Array
    least: Array
    limits: Array

    def cost(self, excited: "Excited", b: Array, falling: Array, exponent: float) -> float:
        """Return the cost of excitations, of distances from measured activations and of reserves.

        Args:
            excited: States and inputs of the muscles.
            b: Weights of the points in the integral over an interval.
            falling: Time constants of falling activations [s], shape (n,).
            exponent: Exponent of the cost.
        """
        p, (a, e, r) = exponent, (values[1:] for values in excited[:3])
        each = (self.prices[1:] * e**p + self.stiffness[1:] * (a - self.target[1:]) ** 2).sum(1)
        each += (np.abs(r) ** p).sum(axis=1)
        before = falling @ (self.prices[0] * excited.activation[0] ** p)
        return float((self.widths[:, None] * b).ravel() @ each + before)


class Excited(NamedTuple):
    """States and inputs of muscles at the start and at the points, with ne elastic tendons.

    Attributes:
        activation: Activations, shape (1 + points, n).
        excitation: Excitations, shape (1 + points, n); at the start that before the motion.
        effort: Efforts of the reserves, shape (1 + points, r).
        fiber_length: Fibre lengths beside elastic tendons [m], shape (1 + points, ne).
        fiber_speed: Rates of the fibre lengths per largest speed, shape (1 + points, ne).
    """

    activation: Array
    excitation: Array
    effort: Array
    fiber_length: Array
    fiber_speed: Array


class Optimal(NamedTuple):
    """Solution of a trial.

    Attributes:
        excited: States and inputs of the muscles.
        cost: Integral of the costs [s].
        iterations: Iterations of the solver.
        is_good: Whether the optimality conditions hold.
        status: Status of the solver.
        residual: Residual of the optimality conditions, in characteristic sizes.
        lacking: Residual forces, in characteristic sizes, shape (points, nv_y).
        slopes: Derivatives of the cost from an interval to the end by the activations and fibre
            lengths at its start (the costates), shape (intervals, n + ne).
    """

    excited: Excited
    cost: float
    iterations: int
    is_good: bool
    status: str
    residual: float
    lacking: Array
    slopes: Array


class MuscleDynamics(NamedTuple):
    """Dynamics of muscles over a motion, and the mesh on which they are solved.

    Attributes:
        kind: `activation`: activations follow excitations and tendons are rigid. `tendon`: also
            tendons are elastic, if the muscle has an elastic one.
        interval: Longest interval of the mesh [s].
        degree: Collocation points on an interval.
        tolerance: Largest error of activations between points; intervals with a larger one are
            refined.
    """

    kind: str
    interval: float
    degree: int
    tolerance: float


def muscles_with(dynamics: MuscleDynamics, muscles: Sequence[Muscle]) -> list[Muscle]:
    """Return muscles with these dynamics on the same paths.

    Curves with kinks prevent an optimum, so muscles that have some get the curves and the
    activation dynamics of De Groote and Fregly, with their own sizes and time constants.
    """
    smooth_muscles = []
    for muscle in muscles:
        law, rate, tendon = muscle.contraction, muscle.dynamics, muscle.tendon
        if isinstance(rate, FirstOrder):
            law = law._replace(curves=_CURVES)
            rate = SmoothFirstOrder(rate.rising, rate.falling, rate.least, _STEEPNESS)
        smooth = Muscle(muscle.path, law, rate, tendon if dynamics.kind == TENDON else "rigid")
        smooth.name = muscle.name
        smooth_muscles.append(smooth)
    return smooth_muscles
