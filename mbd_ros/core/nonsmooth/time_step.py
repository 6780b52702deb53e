"""The Moreau-Jean time step with contact on one page.

`moreau_jean_step` takes the same step and adds what long runs need: impacts with restitution and
slips that end early divide a step, friction acts against the mean slip where a contact slides all
along, internal states are implicit, contacts that are far away are passed over, and gaps that are
negative are corrected. `test/core/nonsmooth/test_time_step.py` holds it to this function.
"""

import numpy as np

from mbd_ros.core.complementarity.contact_problem import ContactProblem
from mbd_ros.core.dynamics.chart import Chart
from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.nonsmooth.implicit_loads import ImplicitLoads
from mbd_ros.core.nonsmooth.unilateral_rows import all_rows
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import Array, State


def time_step(
    mechanism: Mechanism,
    loads: ImplicitLoads,
    rows: ConstraintRows,
    x: State,
    u: Array | None,
    h: float,
    theta: float = 0.5,
) -> State:
    """Return the state after one Moreau-Jean step with contact.

        M (v+ - v) = h f + J' p,   q+ = q (+) h ((1 - theta) v + theta v+)
        0 <= p  and  w + max(gap, 0) / (theta h) >= 0, one of them 0,   w = J v+ + offset

    for unilateral rows that the step would close; Coulomb's law for friction against w; w = 0 for
    bilateral rows; and -h limit <= p <= h limit for bounded ones. M, f and J are those of the
    intermediate time t + theta h. One step of Newton's method with the matrix K makes stiff loads
    implicit, and a second one takes their force on the way to v+.

    Args:
        mechanism: Robot and loads, without free bodies and internal states.
        loads: The loads with their slopes.
        rows: All constraint rows; bilateral ones without position feedback.
        x: State of all joints, without impacts in the step.
        u: Inputs, held over the step, shape (nu,); None stands for those of the sources.
        h: Length of the step [s].
        theta: From 1/2, of second order where the motion is smooth, to 1.

    Source: J. J. Moreau, in Nonsmooth Mechanics and Applications, 1988, 1-82; V. Acary, B.
    Brogliato, Numerical Methods for Nonsmooth Dynamical Systems, 2008, ch. 10.
    """
    k, integrate, v = mechanism.k, Chart(mechanism.model).integrate, x.v
    early, late = theta * h, (1.0 - theta) * h
    middle = State(x.t + early, integrate(x.q, early * v), v)
    M = np.array(mechanism.mass(middle.q))
    K = M + loads.slopes(middle, u, early).added  # M - theta h df/dv - (theta h)^2 df/dq
    free = v + np.linalg.solve(K, h * loads.force(middle, u))
    k.refresh(middle.q, middle.v, rows.reads)
    rows.limit(k, middle)
    J, drift = (np.array(each) for each in rows.accelerations(k, middle))
    offset = rows.rate(k, middle) + late * drift
    rate = J.dot(v) + offset - h * drift  # at the start of the step
    gap = rows.residual(k, middle) - early * (rate + 0.5 * early * drift)
    gap = gap + late * rate  # at the end of the step if w is 0
    kinds = all_rows(rows)
    closes = (gap + early * (J.dot(free) + offset) <= 0.0) | ~kinds.pushes
    on = np.flatnonzero(closes[kinds.decides])
    chosen, J, offset = kinds.chosen(on), J[on], offset[on]
    offset = offset + np.where(chosen.pushes, np.maximum(gap[on], 0.0) / early, 0.0)
    response = np.linalg.solve(K, J.T)
    A, bounds = J.dot(response), (h * rows.lower[on], h * rows.upper[on])
    laws = ContactProblem(A, A.diagonal(), chosen.names, chosen.cones)
    end = free + response.dot(laws.solve(J.dot(free) + offset, *bounds, np.sqrt(v.dot(M).dot(v))))
    mean = (1.0 - theta) * v + theta * end
    middle = State(x.t + early, integrate(x.q, early * mean), mean)
    free = end + np.linalg.solve(K, h * loads.force(middle, u) - M.dot(end - v))
    end = free + response.dot(laws.solve(J.dot(free) + offset, *bounds, np.sqrt(v.dot(M).dot(v))))
    return State(x.t + h, integrate(x.q, h * ((1.0 - theta) * v + theta * end)), end)
