"""A check of converged motion by a method that never sees the drift of a constraint."""

from collections.abc import Sequence
from typing import NamedTuple

from mbd_ros.applications.report.precision.choices import Choice
from mbd_ros.applications.report.precision.converged import Known, distance, trace
from mbd_ros.core.state import State
from mbd_ros.errors import MbdError
from mbd_ros.scene.built_scene import Scene

_STEPS = (1.0, 0.5, 0.25, 0.125)  # of the scene
_NEAR = 1.0e-8  # [rad or m]: agreement that proves the point by itself
_SETTLED = 2.0  # distance in last changes; a method of order 2 that approaches has 1/3


class Approach(NamedTuple):
    """Result of the check.

    Attributes:
        is_wrong: RATTLE settles on another motion.
        text: Its largest differences in position from step to step [rad or m].
    """

    is_wrong: bool
    text: str


def approach(scene: Scene, motion: Known) -> Approach:
    """Whether RATTLE approaches a converged motion as its step is halved.

    Accelerations need J' v, which RATTLE does not read: it keeps g = 0 and J v = 0 by impulses. A
    wrong drift therefore leaves RATTLE settled at a distance. Where it does not settle with these
    steps, at a toggle, there is no result.
    """
    if not scene.system().rows:
        return Approach(False, "no rows")
    runs = _runs(scene, motion)
    if len(runs) < 2:
        return Approach(False, "RATTLE does not run here")
    away = [_apart(scene, run, motion.states) for run in runs]
    shown = "RATTLE, step halved: " + " -> ".join(f"{d:.1e}" for d in away)
    is_settled = away[-1] > _SETTLED * _apart(scene, runs[-1], runs[-2])
    if away[-1] > _NEAR and is_settled:
        return Approach(True, shown)
    return Approach(False, shown if away[-1] < away[-2] else f"{shown}, not settled")


def _runs(scene: Scene, motion: Known) -> list[list[State]]:
    """States of all joints at the samples, for steps that are halved."""
    runs = []
    for steps in _STEPS:
        choice = Choice("plain", None, {"type": "rattle"}, steps * scene.dt)
        try:
            simulation, ys = trace(scene, choice, motion.times)
        except MbdError:
            continue
        runs.append([simulation.system.expand(y) for y in ys])
    return runs


def _apart(scene: Scene, ours: Sequence[State], theirs: Sequence[State]) -> float:
    return max(distance(scene, x, y) for x, y in zip(ours, theirs, strict=True))
