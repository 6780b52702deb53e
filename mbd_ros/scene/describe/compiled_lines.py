"""Compiled steps in `mbd-ros check`: operations, times, or what keeps them plain."""

import math
import timeit
from collections.abc import Callable, Iterator

from mbd_ros.core.integration.blocks import BlockStepper
from mbd_ros.core.simulation.simulation import Simulation
from mbd_ros.core.state import Array, State
from mbd_ros.errors import DivergedError, SolveError
from mbd_ros.scene.built_scene import Scene, Tell
from mbd_ros.scene.describe.part_lines import line

_STEPS, _REPEATS = 1000, 5


def compiled_lines(scene: Scene, has_start: bool, tell: Tell | None = None) -> Iterator[str]:
    """What was compiled for a scene that asks for it, and what a step costs.

    Args:
        scene: The scene.
        has_start: Whether it has a start from which steps can be taken.
        tell: Is told what takes time.

    Raises:
        SceneError: It demands compiled steps and cannot have them.
    """
    simulation = scene.simulation(tell=tell)
    is_compiled = isinstance(simulation.stepper, BlockStepper)
    text = simulation.how.partition(": ")[2]
    if is_compiled and has_start:
        text += _costs(scene, simulation)
    yield line("compiled", text if is_compiled else f"not: {text}")


def _costs(scene: Scene, simulation: Simulation) -> str:
    """Times of a step, empty where the first one fails."""
    plain = scene.simulation(solver={"type": "plain"})
    try:
        ours, theirs = _step_time(simulation, scene), _step_time(plain, scene)
    except (DivergedError, SolveError):
        return ""
    if isinstance(simulation.stepper, BlockStepper) and simulation.stepper.plain_steps:
        return "; plain steps at the start, where rows are near dependence"
    name = plain.integrator.title
    return f"; one step of {name} {ours * 1e6:.2g} us, plain {theirs * 1e6:.3g} us"


def _step_time(simulation: Simulation, scene: Scene) -> float:
    """Shortest time of a step from the start on, with its corrections [s]."""
    y = simulation.start(scene.initial)
    u, stepper = simulation.system.loads.sources.held(y.t), simulation.stepper
    if isinstance(stepper, BlockStepper):
        return _shortest(lambda: stepper.stride(y, u, math.inf, _STEPS)[1])
    return _shortest(lambda: _advanced(simulation, y, u))


def _advanced(simulation: Simulation, y: State, u: Array | None) -> int:
    """Number of steps to the next sample."""
    before = simulation.steps
    simulation.advance(y, u, y.t + simulation.dt)
    return simulation.steps - before


def _shortest(steps: Callable[[], int]) -> float:
    """Time of one of the steps that a function takes and counts [s]."""
    times = []
    for _ in range(_REPEATS):
        begin = timeit.default_timer()
        count = steps()
        times.append((timeit.default_timer() - begin) / max(count, 1))
    return min(times)
