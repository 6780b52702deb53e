"""Equations of one muscle or of one time, that repeat over muscles, intervals and points."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mbd_ros.compiled.symbols.kinematics import SymbolicKinematics
from mbd_ros.compiled.symbols.scalar import Scalar, plain
from mbd_ros.core.muscles.contraction import Contraction, Fiber
from mbd_ros.core.muscles.muscle import ActivationDynamics
from mbd_ros.core.muscles.pennation import Pennation
from mbd_ros.core.state import Array
from mbd_ros.optimal_control.collocation import Collocation
from mbd_ros.optimal_control.program_block import Form

_ROUND = 1.0e-3  # of full excitation and of the optimal force of a reserve


def price_form(exponent: float) -> Form:
    """Of x it gives w |x|^p; data: w."""
    x, weight = ca.SX.sym("x"), ca.SX.sym("w")
    return Form(x, weight, ca.SX(0, 1), weight * _power(x, exponent))


def slope_form() -> Form:
    """Of x it gives s x; data: s."""
    x, slope = ca.SX.sym("x"), ca.SX.sym("s")
    return Form(x, slope, ca.SX(0, 1), slope * x)


def start_slopes(scheme: Collocation) -> Array:
    """What the rows of an interval gain by the state at its start, shape (degree,)."""
    slopes, sizes = _differences(scheme)
    found: Array = -slopes.sum(axis=1) / sizes
    return found


def activation_form(dynamics: ActivationDynamics, scheme: Collocation, exponent: float) -> Form:
    """One activation on one interval, and what its excitation costs.

    Unknown are the activation at the start, activations and excitations at the points; data:
    width of the interval, numbers of the dynamics, then prices, stiffness and target at points.
    """
    kind: Any = type(dynamics)
    d, count = scheme.degree, len(kind._fields)
    a, e = ca.SX.sym("a", d + 1), ca.SX.sym("e", d)
    h, own, known = ca.SX.sym("h"), ca.SX.sym("n", count), ca.SX.sym("k", d, 3)
    law = kind(*(Scalar(own[i]) for i in range(count)))
    rates = [plain(law.rate(SymbolicKinematics, Scalar(e[j]), Scalar(a[j + 1]))) for j in range(d)]
    prices, stiffness, target = ca.horzsplit(known)
    costs = prices * _power(e, exponent) + stiffness * (a[1:] - target) ** 2
    rows = _defects(scheme, a, h * ca.vertcat(*rates))
    cost = h * ca.dot(ca.DM(scheme.b), costs)
    return Form(ca.vertcat(a, e), ca.vertcat(h, own, ca.vec(known)), rows, cost)


def fiber_form(scheme: Collocation) -> Form:
    """One length of fibres on one interval: l' = v fastest; data: width, fastest."""
    l, v = ca.SX.sym("l", scheme.degree + 1), ca.SX.sym("v", scheme.degree)  # noqa: E741
    known = ca.SX.sym("k", 2)
    return Form(ca.vertcat(l, v), known, _defects(scheme, l, known[0] * known[1] * v))


def tendon_form(curves: Any) -> Form:
    """Balance of one tendon with its fibres, per peak force.

    Unknown are activation, length and speed of the fibres; data: the length of the path, then the
    numbers of `contraction_numbers`.
    """
    x, known = ca.SX.sym("x", 3), ca.SX.sym("k", 8)
    a, l, v, length = (Scalar(one) for one in (*ca.vertsplit(x), known[0]))  # noqa: E741
    law = _contraction(known[1:], curves)
    fiber = Fiber(l, law.cosine(SymbolicKinematics, l), v * law.fastest)
    k = SymbolicKinematics
    along = law.active(k, a, fiber) + law.passive(k, fiber) + law.damping(fiber)
    lacks = (law.tendon(k, length, l) - along * fiber.cosine) / law.peak
    return Form(x, known, plain(lacks))


def contraction_numbers(law: Contraction) -> list[float]:
    """Data of `tendon_form` beside the length of the path."""
    return [law.peak, law.optimal, law.slack, law.fastest, *law.pennation]


class Pull(NamedTuple):
    """How the tension of a muscle follows from its unknown.

    Attributes:
        law: Beside an elastic tendon, from the length of fibres; None: from the activation.
        may_slacken: Whether a tension beside a rigid tendon may come out negative.
    """

    law: Contraction | None
    may_slacken: bool


def force_form(pulls: Sequence[Pull], kept: NDArray[np.bool_]) -> Form:
    """What muscles and reserves exert on the independent coordinates, less what is needed.

    Unknown are an activation or a length of fibres for each muscle, then efforts of the reserves;
    data: of each muscle strength and offset beside a rigid tendon, lengths of the paths, entries
    of the columns, what is needed.

    Args:
        pulls: Of each muscle.
        kept: Which entries of the columns are there, shape (nv_y, n + r).
    """
    (rows, columns), n = np.nonzero(kept), len(pulls)
    x, needed = ca.SX.sym("x", kept.shape[1]), ca.SX.sym("t", kept.shape[0])
    strength, offset, length = (ca.SX.sym(name, n) for name in ("s", "o", "L"))
    entries = ca.SX.sym("c", len(rows))
    exerted = ca.SX.zeros(kept.shape[0])
    forces = [
        _tension(pull, x[i], strength[i], offset[i], length[i]) for i, pull in enumerate(pulls)
    ]
    forces += ca.vertsplit(x[n:]) if kept.shape[1] > n else []
    for place, (row, column) in enumerate(zip(rows.tolist(), columns.tolist(), strict=True)):
        exerted[row] += entries[place] * forces[column]
    return Form(x, ca.vertcat(strength, offset, length, entries, needed), exerted - needed)


def _tension(pull: Pull, x: Any, strength: Any, offset: Any, length: Any) -> Any:
    if pull.law is not None:
        return plain(pull.law.tendon(SymbolicKinematics, Scalar(length), Scalar(x)))
    tension = strength * x + offset
    return ca.fmax(tension, 0.0) if pull.may_slacken else tension


def _contraction(numbers: Any, curves: Any) -> Contraction:
    peak, optimal, slack, fastest, *geometry = (Scalar(one) for one in ca.vertsplit(numbers))
    return Contraction(peak, optimal, slack, fastest, Pennation(*geometry), curves)


def _defects(scheme: Collocation, x: Any, moved: Any) -> Any:
    """Rows of x' h = moved at the points, by differences: they have fewest entries."""
    slopes, sizes = _differences(scheme)
    from_start = ca.DM(slopes / sizes[:, None]) @ (x[1:] - x[0])
    return from_start - moved / ca.DM(sizes)


def _differences(scheme: Collocation) -> tuple[Array, Array]:
    """Slopes at the points by differences from the start, and the sizes of their rows."""
    slopes: Array = np.linalg.inv(scheme.A)
    return slopes, np.abs(slopes).sum(axis=1)


def _power(x: Any, p: float) -> Any:
    """|x|^p; where it has a kink at 0, a little round there."""
    if p == 2.0:
        return x**2
    return (x**2) ** (0.5 * p) if p > 2.0 else (x**2 + _ROUND**2) ** (0.5 * p) - _ROUND**p
