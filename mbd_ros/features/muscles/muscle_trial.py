"""A motion as muscles with dynamics see it, and what they do in it.

A trial is known at the start and at the points of all intervals of a mesh: what muscles and
reserves can exert there, what the motion needs, and what activations cost. Excitations are
unknown.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.muscles.degroote_fregly_curves import DeGrooteFreglyCurves
from mbd_ros.core.muscles.muscle import FirstOrder, Muscle, SmoothFirstOrder
from mbd_ros.core.state import Array

ACTIVATION, TENDON = "activation", "tendon"
_CURVES = DeGrooteFreglyCurves(4.0, 0.6, 0.049, 1.0, 0.01)  # of muscles whose own have kinks
_STEEPNESS = 0.1  # of their change from rising to falling activation


class Trial(NamedTuple):
    """What is known at the start and at the points of all intervals, with n muscles, r reserves.

    Attributes:
        widths: Of the intervals [s], shape (intervals,).
        length: Of the paths [m], shape (points, n).
        strength: Change of the tension with the activation beside rigid tendons [N], same shape.
        offset: Tension there without activation [N], same shape.
        columns: Force of the independent coordinates by a tension of 1 N and by an effort of 1
            of a reserve, shape (points, nv_y, n + r).
        needed: Force that the motion needs of each independent coordinate [N·m or N], shape
            (points, nv_y).
        sizes: Usual sizes of that force, shape (nv_y,).
        prices: Of excitations, shape (points, n).
        stiffness: Price of the squared distance of activations from measured ones, same shape.
        target: The measured ones, same shape.
        least: Lower bounds of activations, same shape.
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

    def cost(self, found: "Excited", b: Array, falling: Array, exponent: float) -> float:
        """What excitations, distances from measured activations, reserves and the start cost.

        Args:
            found: What muscles do.
            b: Shares of the points in the width of an interval.
            falling: Time in which activations fall [s], shape (n,).
        """
        p, (a, e, r) = exponent, (values[1:] for values in found[:3])
        each = (self.prices[1:] * e**p + self.stiffness[1:] * (a - self.target[1:]) ** 2).sum(1)
        each += (np.abs(r) ** p).sum(axis=1)
        before = falling @ (self.prices[0] * found.activation[0] ** p)
        return float((self.widths[:, None] * b).ravel() @ each + before)


class Excited(NamedTuple):
    """What muscles do at the start and at the points of a trial, with ne elastic tendons.

    Attributes:
        activation: Shape (1 + points, n).
        excitation: The same; at the start, what the activation came from.
        effort: Of the reserves, shape (1 + points, r).
        fiber_length: Of fibres beside elastic tendons [m], shape (1 + points, ne).
        fiber_speed: Its rate per largest speed, shape (1 + points, ne).
    """

    activation: Array
    excitation: Array
    effort: Array
    fiber_length: Array
    fiber_speed: Array


class Optimal(NamedTuple):
    """A trial of least cost.

    Attributes:
        excited: What muscles do.
        cost: Integral of the costs [s].
        iterations: Of the solver.
        is_good: Whether the conditions of an optimum hold.
        status: What the solver says.
        residual: Of the conditions of the optimum, in usual sizes.
        lacking: Violations of the balance of forces, in usual sizes, shape (points, nv_y).
        slopes: What the cost of an interval and all after it gains by activations and lengths of
            fibres at its start, shape (intervals, n + ne).
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
    """What takes part, and how finely it is followed.

    Attributes:
        kind: `activation`: activations follow excitations, tendons are rigid; `tendon`: tendons
            are elastic, too, where the muscle says so.
        interval: Longest interval of the mesh [s].
        degree: Points on an interval.
        tolerance: Largest error of activations between points; finer intervals are tried where it
            is larger.
    """

    kind: str
    interval: float
    degree: int
    tolerance: float


def muscles_with(dynamics: MuscleDynamics, muscles: Sequence[Muscle]) -> list[Muscle]:
    """The muscles with these dynamics, on the same paths.

    Curves of other types have kinks, at which no optimum is found: these muscles get the curves
    and the activation of De Groote and Fregly, with their own sizes and times.
    """
    found = []
    for muscle in muscles:
        law, rate, tendon = muscle.contraction, muscle.dynamics, muscle.tendon
        if isinstance(rate, FirstOrder):
            law = law._replace(curves=_CURVES)
            rate = SmoothFirstOrder(rate.rising, rate.falling, rate.least, _STEEPNESS)
        one = Muscle(muscle.path, law, rate, tendon if dynamics.kind == TENDON else "rigid")
        one.name = muscle.name
        found.append(one)
    return found
