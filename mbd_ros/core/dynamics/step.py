"""The constrained acceleration M a + h = tau + J' lam on one page.

Every formulation ("tier") computes the same with less work: the articulated-body algorithm needs
no M (`open_chain`), eliminated couplings no rows (`reduced`), bilateral rows one factorisation
(`kkt`), and rows that exert no force no solve (`complementarity/bounded_rows`,
`contact_modes/event_rows`). `benchmarks/constrained_acceleration.py` measures what they save, and
`test/core/dynamics/test_step.py` holds each of them to this function.
"""

import numpy as np

from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.optimization.box_qp import BoxQp, exchanged
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import Array, State


def constrained_acceleration(
    mechanism: Mechanism,
    rows: ConstraintRows,
    x: State,
    u: Array | None = None,
    bounds: tuple[Array, Array] | None = None,
) -> tuple[Array, Array]:
    """Return the accelerations of all joints and the multipliers of all constraint rows.

        M a + h = tau + J' lam,   w = J a + drift + kd g' + kp g

    A bilateral row has w = 0. The multiplier of a bounded row stays between its bounds, with w = 0
    inside them, w >= 0 at the lower one and w <= 0 at the upper one. With a from the first
    equation that is a linear complementarity problem in lam, whose matrix J M^-1 J' is called the
    Delassus matrix.

    Args:
        mechanism: Robot and loads.
        rows: All constraint rows, couplings among them; each pushes along its Jacobian.
        x: State of all joints.
        u: Inputs, shape (nu,); None stands for those of the sources.
        bounds: Smallest and largest multipliers, shape (m,) each; None stands for those of the
            laws of the rows.

    Returns:
        a [rad/s^2 or m/s^2], shape (nv,), and lam [N·m or N], shape (m,).

    Source: R. Featherstone, Rigid Body Dynamics Algorithms, 2008, sec. 3.2 and 11.5.
    """
    k = mechanism.k
    M = np.array(mechanism.mass(x.q))
    h = np.array(mechanism.bias(x.q, x.v))
    tau = mechanism.tau(x, u)
    k.refresh(x.q, x.v, rows.reads)
    J, b = rows.conditions(k, x)  # w = J a + b
    rows.limit(k, x)
    lower, upper = (rows.lower, rows.upper) if bounds is None else bounds
    free = np.linalg.solve(M, tau - h)
    response = np.linalg.solve(M, J.T)
    lam = solve_multipliers(J.dot(response), J.dot(free) + b, lower, upper)
    return free + response.dot(lam), lam


def solve_multipliers(A: Array, w: Array, lower: Array, upper: Array) -> Array:
    """Return lam between bounds that is complementary to A lam + w, shape (m,).

    Args:
        A: Delassus matrix, symmetric, shape (m, m).
        w: Rates of the rows without multipliers, shape (m,).
        lower: Smallest multipliers, shape (m,).
        upper: Largest multipliers, shape (m,).

    Raises:
        SolveError: The rows contradict one another.
    """
    if not len(w):
        return w
    lam = exchanged(A, w, lower, upper)
    return BoxQp(len(w)).solve(A, w, lower, upper) if lam is None else lam
