"""Cost of contacts: steps and solves as ratios to a bare `pin.aba`; prints JSON.

python benchmarks/costs/contact.py [--rounds 15]

`arm7` holds one contact under friction at the last link of the 7-joint arm: its solve alone, the
step that contains it, and the step without it. `idle` holds steps beside a contact far away over
the same steps without it. `box` holds a box of four contact points at rest, in microseconds, and
if MuJoCo is installed its step with the set-up that the report finds to creep least.
"""

import argparse
import importlib.util
import json
import sys
import time
import timeit
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.applications.report.contact.ours import scene_of
from mbd_ros.applications.report.contact.problems import stuck
from mbd_ros.core.complementarity.contact_problem import ContactProblem
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.rows.constraint_rows import Cone
from mbd_ros.core.state import State
from mbd_ros.methods.simulation.checked_steps import build_stepper
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.reading.part_entries import build_part
from mbd_ros.scene.variants import with_sections

_CALLS, _DT, _MU = 200, 1.0e-4, 0.5
_ARM = "package://mbd_ros/config/scenes/arm7.yaml"
_METHODS = ("rk4", "adams", "moreau_jean")
_FAR = 50.0  # m
Call = Callable[[], object]


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=15)
    rounds = parser.parse_args().rounds
    result = {"arm7": _arm(rounds), "idle": _idle(rounds), "box": _box(rounds)}
    json.dump(result, sys.stdout, indent=2)
    print()
    return 0


def _arm(rounds: int) -> dict[str, float]:
    """One contact of the arm, over a bare aba."""
    scene = load_scene(_ARM)
    x = _swinging(scene)
    touching, model = _over(scene, _lowest(scene, x)), scene.robot.model
    data, tau = model.createData(), np.zeros(model.nv)
    steps = {
        "free_step": _step(scene, "moreau_jean", x),
        "step": _step(touching, "moreau_jean", x),
        "solve": _solve(scene.robot, x),
    }
    bare = {"aba": lambda: pin.aba(model, data, x.q, x.v, tau)}
    costs = _costs({**steps, **bare}, rounds)
    return {name: float(np.median(costs[name] / costs["aba"])) for name in steps}


def _idle(rounds: int) -> dict[str, float]:
    """Steps beside a contact far away, over those without it."""
    scene = load_scene(_ARM)
    x, far = _swinging(scene), _over(scene, -_FAR)
    calls = {name: _step(scene, name, x) for name in _METHODS}
    beside = {f"{name}_idle": _step(far, name, x) for name in _METHODS}
    costs = _costs({**calls, **beside}, rounds)
    return {name: float(np.median(costs[f"{name}_idle"] / costs[name])) for name in _METHODS}


def _box(rounds: int) -> dict[str, float]:
    """A step of a box on four points [us]."""
    problem = stuck()
    scene = scene_of(problem)
    calls = {name: _step(scene, name, scene.initial, 1.0e-3) for name in ("moreau_jean", "rk4")}
    found = {name: float(np.min(cost)) * 1e6 for name, cost in _costs(calls, rounds).items()}
    if importlib.util.find_spec("mujoco") is not None:
        from mbd_ros.applications.report.contact.mujoco_contacts import MujocoContacts

        peer = MujocoContacts(problem, "EULER", 1.0e-3, 2.0, (1000.0, 10))
        seconds = min(peer.run(problem.times)[1] for _ in range(3))
        found["mujoco"] = seconds / problem.times[-1] * 1.0e-3 * 1e6
    return found


def _swinging(scene: Scene) -> State:
    q, v = np.random.default_rng(2).uniform(-0.5, 0.5, (2, scene.robot.model.nv))
    return State(0.0, q, v)


def _lowest(scene: Scene, x: State) -> float:
    """Height of the origin of the last link [m]."""
    model = scene.robot.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, x.q)
    return float(data.oMf[scene.robot.frame("link7")].translation[2] + scene.robot.origin[2])


def _over(scene: Scene, height: float) -> Scene:
    """The scene with a ground at a height, for a point of the last link."""
    ground = {"half_space": [0.0, 0.0, 1.0], "xyz": [0.0, 0.0, height]}
    point = {"frame": "link7", "points": [[0.0, 0.0, 0.0]]}
    return with_sections(
        scene, contacts=[{"type": "rigid", "between": [point, ground], "friction": _MU}]
    )


def _step(scene: Scene, name: str, x: State, dt: float = _DT) -> Call:
    """A step of a method, each from where the last one ended."""
    method = build_part("integrators", {"type": name}, "benchmark")
    system = scene.system()
    stepper = build_stepper(method, system, dt)
    y = stepper.settle(system.reduce(x), None)

    def step() -> None:
        nonlocal y
        y = stepper.step(y, None)

    return step


def _solve(robot: Robot, x: State) -> Call:
    """The impulses of the contact of a sliding point, with those of the step before known."""
    model = robot.model
    data = model.createData()
    J = pin.computeFrameJacobian(model, data, x.q, robot.frame("link7"), pin.LOCAL_WORLD_ALIGNED)[
        [2, 0, 1]
    ]
    A = J.dot(pin.computeMinverse(model, data, x.q)).dot(J.T)
    cone = Cone("normal", slice(0, 3), _MU, 0.0)
    problem = ContactProblem(A, A.diagonal(), ("normal", "friction_x", "friction_y"), [cone])
    b, least, most = J.dot(x.v), np.zeros(3), np.full(3, np.inf)
    b[0] = -0.1 * float(np.hypot(b[1], b[2]))  # it approaches and slides
    warm = problem.solve(b, least, most, 1.0)
    return lambda: problem.solve(b, least, most, 1.0, None, warm)


def _costs(calls: Mapping[str, Call], rounds: int) -> dict[str, Any]:
    """Seconds a call of all, in turn, shape (rounds,) each."""
    found: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            taken = timeit.timeit(call, number=_CALLS, timer=time.process_time)
            found[name].append(taken / _CALLS)
    return {name: np.array(taken) for name, taken in found.items()}


if __name__ == "__main__":
    sys.exit(main())
