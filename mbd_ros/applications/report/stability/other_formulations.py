"""Motion of extreme scenes by other equations than the tested ones."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.integrate import solve_ivp

from mbd_ros.applications.report.stability.motion import Grid, Motion, motion
from mbd_ros.applications.report.stability.scene_text import LoadedScene
from mbd_ros.core.state import Array, State

Known = Callable[[Grid], Motion]
_PRECISE = 1.0e-12


def elsewhere(load: Callable[[], LoadedScene], solver: str) -> Known:
    """Motion of a scene with the same joints at another place, under another tier."""

    def known(grid: Grid) -> Motion:
        method = {"type": "dop853", "tolerance": _PRECISE}
        return motion(load().scene, method, grid.interval, grid, solver)

    return known


def rotor(moments: Sequence[float], rates: Sequence[float]) -> Known:
    """A free rotor on hinges z, y, x from angles 0, by Euler's equations in body axes.

    I w' = (I w) x w, and w = (c' - a' sin b, b' cos c + a' cos b sin c, a' cos b cos c - b' sin c)
    of the angles a, b, c.

    Args:
        moments: Principal moments of inertia [kg·m^2], shape (3,).
        rates: First rates of the angles [rad/s], shape (3,).
    """
    inertia = np.array(moments)

    def angular_rates(y: Array) -> Array:
        (_, b, c), (x, across, along) = y[:3], y[3:]
        a_rate = (across * np.sin(c) + along * np.cos(c)) / np.cos(b)
        b_rate = across * np.cos(c) - along * np.sin(c)
        return np.array([a_rate, b_rate, x + a_rate * np.sin(b)])

    def slope(_: float, y: Array) -> Array:
        w = y[3:]
        return np.concatenate([angular_rates(y), np.cross(inertia * w, w) / inertia])

    def known(grid: Grid) -> Motion:
        times = np.linspace(0.0, grid.span, grid.count + 1)
        start, span = np.array([0.0, 0.0, 0.0, *rates[::-1]]), (0.0, grid.span)
        found = solve_ivp(slope, span, start, "DOP853", times, rtol=_PRECISE, atol=_PRECISE)
        rows = zip(found.t.tolist(), found.y.T, strict=True)
        return Motion([State(t, y[:3].copy(), angular_rates(y)) for t, y in rows], "")

    return known
