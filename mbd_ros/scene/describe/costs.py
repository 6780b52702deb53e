"""Times of a call of the equations of a scene, and of a step, measured."""

import math
import timeit
from collections.abc import Callable
from functools import partial

import numpy as np
import pinocchio as pin

from mbd_ros.core.dynamics.system import System, evaluation_at, inward
from mbd_ros.core.state import Array, State
from mbd_ros.errors import DivergedError, SolveError
from mbd_ros.methods.integration.stepping import BlockStepper
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.runs.simulation import build_simulation

MEASURED = 0.02  # s for which a call is timed, a few times over
_REPEATS = 5  # of which the shortest counts
_CALLS, _STEPS = 2000, 1000  # at most, in one repeat
_PLAIN = {"type": "plain"}


def inverse_cost(scene: Scene, x: State) -> str:
    """Time of a call of inverse dynamics; empty where a motion does not show what it takes.

    Args:
        x: Consistent state of all joints.
    """
    if scene.unmeasured:
        return ""
    return _loop_cost(scene, x) if scene.has_loops else _open_chain_cost(scene)


def _open_chain_cost(scene: Scene) -> str:
    robot, model = scene.robot, scene.robot.model
    q, v = pin.neutral(model), np.zeros(model.nv)
    bare = _best(partial(pin.rnea, model, pin.Data(model), q, v, v))
    inverse, loads = scene.inverse_dynamics(), [np.ones(6)] * len(scene.wrenches)
    z, w = q[scene.couplings.q_index], v[scene.couplings.v_index]
    ours = _best(lambda: inverse.solve(z, w, w, loads))
    ratio = f"{ours / bare:.1f} x a bare rnea of {len(robot.joints)} joints"
    return f"one inverse-dynamics call {ours * 1e6:.1f} us, {ratio}"


def _loop_cost(scene: Scene, x: State) -> str:
    drives = [section.key for section in scene.sections if "command" in section.offers]
    every = scene.without(drives).closed_loop()  # so that no fixed base is out of reach
    x, a = every.consistent(x, np.zeros(scene.robot.model.nv))
    call = (lambda: every.reach(x)) if scene.robot.floating else (lambda: every.solve(x, a))
    return f"one inverse-dynamics call {_best(call) * 1e6:.0f} us"


def forward_cost(scene: Scene, system: System, x: State) -> str:
    """Time of a call of forward dynamics.

    Args:
        x: Consistent start of what it integrates.
    """
    model, given = system.model, scene.initial
    bare = _best(partial(pin.aba, model, pin.Data(model), given.q, given.v, np.zeros(model.nv)))
    y = x  # else in its mode
    if system.exact is not None:
        simulation = build_simulation(scene, solver=_PLAIN)
        y = inward(simulation.system, simulation.start(given))
    ours = _best(evaluation_at(system, y))
    return f"one acceleration {ours * 1e6:.1f} us, {ours / bare:.1f} x a bare aba"


def _best(call: object) -> float:
    """Shortest time of a call [s], by as many calls as there is time for."""
    timer = timeit.Timer(call)  # type: ignore[arg-type]
    first = timer.timeit(1)
    if first >= MEASURED:
        return first
    calls = int(min(max(MEASURED / first, 1), _CALLS))
    return min(timer.repeat(_REPEATS, calls)) / calls


def step_costs(scene: Scene, simulation: Simulation) -> str:
    """Times of a step, empty where the first one fails."""
    plain = build_simulation(scene, solver=_PLAIN)
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
