"""What a call of the equations of a scene costs, measured."""

import timeit
from functools import partial

import numpy as np
import pinocchio as pin

from mbd_ros.core.dynamics.phase_queries import inward
from mbd_ros.core.dynamics.system import System, evaluation_at
from mbd_ros.core.state import State
from mbd_ros.scene.built_scene import Scene

_CALLS, _REPEATS = 2000, 5
MEASURED = 0.02  # s for which a call is timed, a few times over


def inverse_cost(scene: Scene, x: State) -> str:
    """Time of a call of inverse dynamics; empty where a motion does not show what it takes.

    Args:
        scene: The scene.
        x: Consistent state of all joints.
    """
    if scene.unmeasured:
        return ""
    return _loop_cost(scene, x) if scene.has_loops else _cost(scene)


def _cost(scene: Scene) -> str:
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
        scene: The scene.
        system: Its system.
        x: Consistent start of what it integrates.
    """
    model, given = system.model, scene.initial
    bare = _best(partial(pin.aba, model, pin.Data(model), given.q, given.v, np.zeros(model.nv)))
    y = x  # else in its mode
    if system.exact is not None:
        simulation = scene.simulation(solver={"type": "plain"})
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
