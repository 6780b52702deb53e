"""Derivatives by central differences of order four."""

from collections.abc import Callable

import numpy as np

from mbd_ros.core.sensitivities.flow import HybridFlow
from mbd_ros.core.state import Array, State

_STEP = 3.0e-4  # of a position or turn [m, rad]: its fourth power is below rounding over the step


def difference_steps(x: State, size: int) -> Array:
    """Length of a difference in each direction of the tangent, shape (size,).

    Args:
        x: State.
        size: Length of a tangent.
    """
    n = len(x.v)
    speed = max(1.0, float(np.abs(x.v).max(initial=0.0)))
    steps = np.full(size, _STEP)
    steps[n : 2 * n] *= speed
    steps[2 * n :] *= np.maximum(np.abs(x.z), _STEP)
    return steps


def slope(f: Callable[[float], Array], h: float) -> Array:
    """Derivative of f at 0, of order four in h."""
    near, far = f(h) - f(-h), f(2.0 * h) - f(-2.0 * h)
    result: Array = (8.0 * near - far) / (12.0 * h)
    return result


def derivative(flow: HybridFlow, f: Callable[[State], Array], x: State) -> Array:
    """Derivative of a function of a consistent state by its tangent, shape (.., size).

    Args:
        flow: Adds tangents, and says which are consistent; it is 0 across these.
        f: The function.
        x: Where.
    """
    basis = flow.basis(x)
    sizes = difference_steps(x, flow.size)
    columns = []
    for direction in basis.T:

        def along(s: float, direction: Array = direction) -> Array:
            return f(flow.plus(x, s * direction))

        columns.append(slope(along, float(1.0 / np.linalg.norm(direction / sizes))))
    found: Array = np.stack(columns, axis=-1).dot(basis.T)
    return found
