"""Motion of a scene to rounding, and how far a second method agrees."""

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.applications.report.precision.choices import Choice
from mbd_ros.applications.report.precision.reference_problems import (
    PROBLEMS,
    Problem,
    error,
    reference,
)
from mbd_ros.core.simulation.simulation import Simulation
from mbd_ros.core.state import Array, State
from mbd_ros.errors import MbdError, SolveError
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene

BY_NAME = {problem.name: problem for problem in PROBLEMS}
_FINE = {"type": "dop853", "tolerance": 1e-13}
_SECOND: tuple[tuple[Mapping[str, Any], float], ...] = (  # integrator, steps in those of the scene
    ({"type": "gauss_legendre", "stages": 3, "tolerance": 1e-13}, 0.5),
    ({"type": "dopri5", "tolerance": 1e-12}, 1.0),
    ({"type": "adams", "order": 8}, 0.125),
)
_SPECIAL: Mapping[str, tuple[tuple[Mapping[str, Any], float], ...]] = {
    # Every toggle multiplies the rounding error of a stage that falls next to it: few stages
    "a02_four_bars_40": (({"type": "dop853"}, 1.0), ({"type": "dopri5"}, 0.5)),
    "s01_parabola": (({"type": "filippov", "tolerance": 1e-13}, 1.0), ({"type": "filippov"}, 0.2)),
}
_GOOD = 1.0e-10  # agreement that needs no third method
_ENOUGH = 1.0e-3  # of a step: two times that are meant to be the same


class Known(NamedTuple):
    """A converged motion.

    Attributes:
        times: Samples [s].
        states: States of all joints there.
        multipliers: Those of `System.multiplier_rows` in the tier `plain`, one row a sample.
        energies: [J].
        method: Method that computed it.
        check: Second method that computed it; empty where none succeeded.
        agreement: Largest difference in position between the two [rad or m]; inf without.
        published: Error against the published reference, in its measure; None without one.
        is_wrong: Whether that error is beyond what the reference demands of precise codes.
    """

    times: tuple[float, ...]
    states: tuple[State, ...]
    multipliers: Array
    energies: Array
    method: str
    check: str
    agreement: float
    published: float | None
    is_wrong: bool


@cache
def known(path: str, times: tuple[float, ...]) -> Known:
    """Converged motion of a scene at some times.

    Args:
        path: Scene file.
        times: Samples [s], increasing, > 0.

    Raises:
        MbdError: No method gets there.
    """
    return motion_of(load_scene(path), times)


def motion_of(scene: Scene, times: tuple[float, ...]) -> Known:
    """Converged motion of a built scene, as `known`."""
    special = None if scene.path is None else _SPECIAL.get(scene.path.stem)
    methods = ((_FINE, 1.0), *_SECOND) if special is None else special
    first = _choice(scene, *methods[0])
    simulation, ys = trace(scene, first, times)
    states = tuple(simulation.system.expand(y) for y in ys)
    check, agreement = _second(scene, times, states, methods[1:])
    published, is_wrong = _published(scene, states)
    solved = [simulation.system.evaluate(x).lam for x in states]
    return Known(
        times,
        states,
        np.array(solved),
        np.array([simulation.system.energy(y) for y in ys]),
        f"{first.method}, {first.fineness}",
        check,
        agreement,
        published,
        is_wrong,
    )


def trace(scene: Scene, choice: Choice, times: Sequence[float]) -> tuple[Simulation, list[State]]:
    """States of the integrated coordinates at some times.

    Raises:
        MbdError: The run stopped.
    """
    simulation = choice.build(scene)
    y, ys = simulation.start(scene.initial), []
    for t in times:
        y = simulation.advance(y, None, t)
        if abs(y.t - t) > _ENOUGH * choice.dt:
            raise SolveError(f"the run ends at {y.t:g} s instead of {t:g} s")
        ys.append(y)
    return simulation, ys


def distance(scene: Scene, ours: State, theirs: State) -> float:
    """Largest difference of two configurations of all joints [rad or m]."""
    return float(np.abs(pin.difference(scene.robot.model, theirs.q, ours.q)).max())


def problem_of(scene: Scene) -> Problem | None:
    """The published problem that a scene file of ours is; None for any other file."""
    if scene.path is None or scene.path.parent.name != "benchmark":
        return None
    return BY_NAME.get(scene.path.stem)


def _choice(scene: Scene, integrator: Mapping[str, Any], steps: float) -> Choice:
    stabilization = {"type": "projection"} if scene.system().rows else None
    return Choice("plain", stabilization, integrator, steps * scene.dt)


def _second(
    scene: Scene,
    times: Sequence[float],
    states: Sequence[State],
    methods: Sequence[tuple[Mapping[str, Any], float]],
) -> tuple[str, float]:
    """The method that agrees best, and the largest difference."""
    best = ("", float("inf"))
    for integrator, steps in methods:
        choice = _choice(scene, integrator, steps)
        try:
            simulation, ys = trace(scene, choice, times)
        except MbdError:
            continue
        pairs = zip(ys, states, strict=True)
        off = [distance(scene, simulation.system.expand(y), x) for y, x in pairs]
        worst = float(np.max(off))  # nan stays nan
        if worst < best[1]:
            best = (f"{choice.method}, {choice.fineness}", worst)
        if worst <= _GOOD:
            break
    return best


def _published(scene: Scene, states: Sequence[State]) -> tuple[float | None, bool]:
    problem = problem_of(scene)
    if problem is None:
        return None, False
    found = error(problem, scene.robot, states)
    return found, not found <= reference(problem.reference).high
