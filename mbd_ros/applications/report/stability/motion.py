"""Runs of a scene, kept on a grid of times."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from mbd_ros.applications.report.stability.scene_text import Entry
from mbd_ros.core.state import State
from mbd_ros.errors import MbdError
from mbd_ros.scene.built_scene import Scene


class Grid(NamedTuple):
    """Times at which motions are compared: 0, interval, .., count * interval [s]."""

    interval: float
    count: int

    @property
    def span(self) -> float:
        """Last time [s]."""
        return self.interval * self.count


class Motion(NamedTuple):
    """A run.

    Attributes:
        states: Those on the grid.
        reason: Why there are not more of them; empty if there are all.
        every: All states, one a step.
    """

    states: list[State]
    reason: str
    every: Sequence[State] = ()


def motion(
    scene: Scene, method: Entry, dt: float, grid: Grid, solver: str = "plain", **others: Any
) -> Motion:
    """Run a scene and keep the states on a grid.

    Args:
        scene: The scene.
        method: Integrator entry.
        dt: A whole fraction of the interval [s], or a longer step than half of it, whose states
            are all kept.
        grid: When to keep states.
        solver: Tier.
        **others: `start`: state to begin with; `stabilization`: entry.
    """
    found: list[State] = []
    every = max(1, round(grid.interval / dt))
    try:
        start = others.pop("start", scene.initial)
        simulation = scene.simulation(integrator=method, dt=dt, solver={"type": solver}, **others)
        for x in simulation.run(start, grid.span):
            found.append(x)
    except MbdError as error:
        return Motion(found[::every], f"{type(error).__name__}: {error}", found)
    return Motion(found[::every], "", found)
