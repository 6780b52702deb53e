"""Matrices of the steps of the Adams methods, one for every place of the newest acceleration."""

from typing import Any

import numpy as np

from mbd_ros.core.integration.polynomial import integrals
from mbd_ros.core.state import Array


def turns(order: int, nv: int, dt: float) -> tuple[Array, list[tuple[Any, ...]]]:
    """What the steps need in turn, until everything is back in place.

    Returns:
        B with both places of [q; v]. For each turn: row of the newest acceleration, product with
        the matrix of the step, B as it reads it, [q; v] that it writes, these two.
    """
    B, ages = np.zeros((4 + order, nv)), np.arange(order)
    position, velocity = adams_weights(order, dt)
    slots = []
    for step in range(2 * order):
        newest, is_even = step % order, step % 2 == 0
        age = (newest - ages) % order
        parts = [np.array([[1.0, dt], [0.0, 1.0]]), np.array([position[age], velocity[age]])]
        before, after = (B[:-2], B[-2:]) if is_even else (B[2:], B[:2])
        matrix = np.ascontiguousarray(np.hstack(parts if is_even else parts[::-1]))
        row, (q, v) = B[2 + newest], after
        slots.append((row, matrix.dot, before, after, q, v))
    return B, slots


def adams_weights(order: int, dt: float) -> tuple[Array, Array]:
    """Weights of the accelerations by age in the changes of q and v.

    Integrals of the Lagrange polynomials over the step.
    """
    velocity, position = integrals(-np.arange(order, dtype=np.float64), 1.0)
    return dt * dt * position, dt * velocity
