"""The methods, tiers and steps of the runs of a scene, and the times of the comparison."""

from typing import NamedTuple

import numpy as np

from mbd_ros.applications.report.stability.cases import applicable, chooses_steps, tiers
from mbd_ros.applications.report.stability.motion import Grid
from mbd_ros.applications.report.stability.reference_motion import starting_rate
from mbd_ros.applications.report.stability.scene_text import LoadedScene
from mbd_ros.scene.built_scene import Scene

_RUNS = 3  # methods that each random scene meets
_FACTORS, _SHARES = (0.1, 0.5, 2.0, 10.0), (0.65, 0.2, 0.1, 0.05)
_TURNS, _LONGEST, _POINTS = 12.0, 0.12, 12  # span: in 1 / rate, and at most [s]; intervals


class Run(NamedTuple):
    """Method, tier and step of a run.

    Attributes:
        method: Key of `METHODS`.
        factor: Step in multiples of the longest one that `check` does not warn of.
        tier: Solver type.
        dt: Step instead of the factor [s], if > 0.
    """

    method: str
    factor: float
    tier: str
    dt: float


def usual_grid(loaded: LoadedScene) -> Grid:
    """Some turns of the fastest motion at the start."""
    span = min(_LONGEST, _TURNS / starting_rate(loaded.scene))
    return Grid(span / _POINTS, _POINTS)


def every_method(factor: float, dt: float, repeats: bool, scene: Scene) -> list[Run]:
    """A run a method.

    Args:
        factor: Step in multiples of the recommended one.
        dt: Step instead of the factor [s], if > 0.
        repeats: Whether other rows have the runs of methods that choose their steps.
        scene: The scene.
    """
    return [
        Run(method, factor, "plain", dt)
        for method in applicable(scene)
        if not (repeats and chooses_steps(method))
    ]


def some_methods(seed: int, scene: Scene) -> list[Run]:
    """Runs with methods and tiers that a seed chooses, and one multiple of the recommended step.

    All take one multiple: a long step makes a long motion, for which short steps take long.
    """
    rng, runs = np.random.default_rng(seed), []
    factor = float(rng.choice(_FACTORS, p=_SHARES))
    for method in map(str, rng.choice(applicable(scene), _RUNS, replace=False)):
        runs.append(Run(method, factor, str(rng.choice(tiers(scene, method))), 0.0))
    return runs
