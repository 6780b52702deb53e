"""What a scene builds, what it leaves out, and what one call costs."""

import timeit
from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from mbd_ros.core.inverse_dynamics import InverseDynamics
from mbd_ros.scene import Scene

_CALLS, _REPEATS = 2000, 5


def describe(scene: Scene) -> Iterator[str]:
    """The lines of `mbd-ros check`.

    Args:
        scene: A built scene.

    Yields:
        One line each, label then text.
    """
    robot, couplings = scene.robot, scene.couplings
    gravity = np.array2string(robot.model.gravity.linear, separator=", ")
    base = "floating" if robot.floating else "fixed"
    yield _line("scene", str(scene.path))
    yield _line("robot", f"{robot.name} from {scene.source}, {base} base")
    yield _line("gravity", f"{gravity} m/s^2, included in every torque")
    free = couplings.independent
    yield _line("joints", f"{len(robot.joints)}, degrees of freedom {len(couplings.v_index)}")
    yield _line("independent", ", ".join(free) or "none")
    yield _line("dependent", "; ".join(f"{d} <- {law}" for d, law in scene.laws.items()) or "none")
    if robot.locked:
        locked = ", ".join(f"{name} at {value:g}" for name, value in robot.locked.items())
        yield _line("locked", locked)
    for name, wrench in scene.wrenches.items():
        load = wrench.load
        topic = wrench.topic or f"~/wrench/{name}"
        text = f"{name} on {load.frame}, expressed in {load.expressed_in}, topic {topic}"
        yield _line("wrench", text)
    for force in scene.forces:
        yield _line("force", f"{type(force).__name__} at {getattr(force, 'joint', force)}")
    yield _line("tier", tier(scene))
    yield _line("left out", "; ".join((*scene.absent, *robot.ignored)) or "nothing")
    yield _line("cost", _cost(scene))


def tier(scene: Scene) -> str:
    """How the equations are solved."""
    if not scene.couplings.dependent:
        return "rnea: no dependent joint, one call"
    return "reduced: dependent joints eliminated exactly, q = F(z)"


def _line(label: str, text: str) -> str:
    return f"{label:<12}{text}"


def _cost(scene: Scene) -> str:
    robot, model = scene.robot, scene.robot.model
    inverse = scene.inverse_dynamics()
    q, v, data = pin.neutral(model), np.zeros(model.nv), model.createData()
    bare = _best(lambda: pin.rnea(model, data, q, v, v))
    ours = _best(_typical_call(inverse, scene, q, v))
    return (
        f"one inverse-dynamics call {ours * 1e6:.1f} us, {ours / bare:.1f} x a bare rnea of "
        f"{len(robot.joints)} joints"
    )


def _typical_call(inverse: InverseDynamics, scene: Scene, q: np.ndarray, v: np.ndarray) -> object:
    z, w = q[scene.couplings.q_index], v[scene.couplings.v_index]
    loads = [np.ones(6)] * len(scene.wrenches)
    return lambda: inverse.solve(z, w, w, loads)


def _best(call: object) -> float:
    timer = timeit.Timer(call)  # type: ignore[arg-type]
    return min(timer.repeat(_REPEATS, _CALLS)) / _CALLS
