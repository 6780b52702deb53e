"""Explicit Adams methods."""

from typing import Any, ClassVar

import numpy as np

from mbd_ros.errors import ModelError
from mbd_ros.methods.integration.adams import AdamsSteps, adams_weights
from mbd_ros.methods.integration.linear_motion import LinearMotion, spectral_radius
from mbd_ros.methods.integration.stepping import Integrator

_ORDERS = range(2, 9)
_STABLE = (0.25, 0.25, 0.15, 0.08, 0.043, 0.023, 0.012)  # rate * dt of each order


class Adams(Integrator):
    """Adams-Bashforth: one evaluation a step, from the polynomial through the last accelerations.

        v+ = v + h sum_j b_j a_(n-j),   q+ = q + h v + h^2 sum_j d_j a_(n-j)

    Runge-Kutta steps start it, at first and after every discontinuity, a new command included:
    it pays on smooth stretches. It refuses free bodies. With decay rates or frequencies r [1/s]
    it is stable for r dt up to about 0.15 at order 4 and 0.043 at order 6, where critical
    damping is the worst case; undamped vibrations grow slowly from order 5 on. Hence 4 is the
    default; orders 6 to 8 are for accuracy at small dt.

    Source: Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, 1993, III.1; III.10
    for the position (Störmer).

    Args:
        order: 2 .. 8.
    """

    native = "adams"
    dense: ClassVar[bool] = True
    event_driven: ClassVar[bool] = True
    example = {"order": 4}

    def __init__(self, *, order: int = 4) -> None:
        if order not in _ORDERS:
            raise ModelError(f"order {order} is outside {_ORDERS[0]} .. {_ORDERS[-1]}")
        self.order = order
        self.stable = _STABLE[order - _ORDERS[0]]

    def growth(self, motion: LinearMotion, dt: float) -> float:
        """Factor by which a step multiplies a linear motion at most, the history included."""
        n, k = len(motion.stiffness), self.order
        unit, position, velocity = np.eye(n), *adams_weights(k, dt)
        now = np.hstack([motion.stiffness, motion.damping, np.zeros((n, n * (k - 1)))])
        kept = np.eye(n * (k + 1))  # [q, v, older accelerations, newest of them first]
        accelerations = np.vstack([now, kept[2 * n :]])
        after = np.vstack([kept[: 2 * n], accelerations[: n * (k - 1)]])
        after[:n] += dt * kept[n : 2 * n] + np.kron(position, unit).dot(accelerations)
        after[n : 2 * n] += np.kron(velocity, unit).dot(accelerations)
        return spectral_radius(after)

    def prepare(self, system: Any, dt: float) -> AdamsSteps:
        """Return the stepper for one system and one step size [s].

        Raises:
            ModelError: A body moves freely; names it.
        """
        if not system.chart.is_flat:
            free = ", ".join(base.title for base in system.robot.bases)
            raise ModelError(f"adams takes no free bodies ({free}), use rk4, dopri5 or dop853")
        return AdamsSteps(system, self.order, dt)
