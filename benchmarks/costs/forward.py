"""Cost of forward dynamics as ratios to a bare `pin.aba` of the same model; prints JSON.

python benchmarks/costs/forward.py [--rounds 15]
"""

import argparse
import json
import sys
import timeit
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.dynamics.tiers import build_system
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.coupling_functions import Linear
from mbd_ros.core.model.couplings import Coupling, Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.state import State
from mbd_ros.methods.simulation.checked_steps import build_stepper
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.reading.part_entries import build_part
from mbd_ros.scene.schema.locate import find_file

_CALLS = 400
_SCENES = "package://mbd_ros/config/scenes"
_LINK = (
    '<link name="l{0}"><inertial><origin xyz="0.1 0 0"/><mass value="1"/><inertia ixx="0.01" '
    'iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="j{0}" '
    'type="revolute"><parent link="{1}"/><child link="l{0}"/><origin xyz="0.2 0 0"/><axis '
    'xyz="0 {2} {3}"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
)


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=15)
    rounds = parser.parse_args().rounds
    arm = load_scene(find_file(Path(), f"{_SCENES}/arm7.yaml", "benchmark")).robot
    result = {"arm7": _tiers(arm, rounds), "steps": _steps(arm, rounds), "chain": _chains(rounds)}
    json.dump(result, sys.stdout, indent=2)
    print()
    return 0


def _tiers(arm: Robot, rounds: int) -> dict[str, float]:
    """One acceleration of every tier over one bare aba, 7 joints."""
    rng = np.random.default_rng(1)
    free, coupled = Couplings(arm), Couplings(arm, {"joint4": Coupling("joint2", Linear(0.5))})
    loop = {"type": "loop_closure", "frame_a": "base", "frame_b": "link7", "directions": "xz"}
    stops = {"type": "joint_stop", "joints": ["all"], "smoothed": True}
    friction = {"type": "dry_friction", "joint": "joint3", "limit": 1e6, "smoothed": True}
    open_stops = {"type": "joint_stop", "joints": ["all"], "lower": -50.0, "upper": 50.0}
    open_stops["smoothed"] = True
    q, v = rng.uniform(-0.5, 0.5, (2, arm.model.nv))
    systems = {
        "aba": _system(arm, free, []),
        "coupling_reduced": _system(arm, coupled, []),
        "coupling_kkt": _system(arm, coupled, [], "kkt"),
        "planar_loop": _system(arm, free, [loop]),
        "aba_stops_idle": _system(arm, free, [open_stops]),
        "reduced_stops_idle": _system(arm, coupled, [open_stops]),
        "loop_stops_idle": _system(arm, free, [loop, open_stops]),
        "friction_held": _system(arm, free, [friction, stops]),
        "stop_active": _system(arm, free, [stops]),
    }
    calls = {}
    for name, system in systems.items():
        at = q.copy()
        if name == "stop_active":
            at[1] = arm.joints[1].upper + 1e-3
        x = system.reduce(State(0.0, at, v))
        calls[name] = _acceleration(system, x)
    return _ratios(arm, q, v, calls, rounds)


def _steps(arm: Robot, rounds: int) -> dict[str, float]:
    """One step of an integrator over one bare aba, 7 joints, no loads."""
    rng = np.random.default_rng(2)
    q, v = rng.uniform(-0.5, 0.5, (2, arm.model.nv))
    calls = {}
    for name in ("semi_implicit_euler", "adams", "rk4", "dopri5", "dop853"):
        system = _system(arm, Couplings(arm), [])
        method = build_part("integrators", {"type": name}, "benchmark")
        calls[name] = _step(method.prepare(system, 1e-4), State(0.0, q, v))
    stops = {"type": "joint_stop", "joints": ["all"], "lower": -50.0, "upper": 50.0}
    for name in ("adams", "rk4"):
        method = build_part("integrators", {"type": name}, "benchmark")
        stepper = build_stepper(method, _system(arm, Couplings(arm), [stops]), 1e-4)
        x = stepper.settle(State(0.0, q, v), None)
        calls[f"{name}_stops_idle"] = _step(stepper, x)
    return _ratios(arm, q, v, calls, rounds)


def _chains(rounds: int) -> dict[str, float]:
    """One acceleration of an open chain, microseconds a body."""
    costs = {}
    for n in (10, 30, 100):
        robot = read_robot(_chain(n))
        system = _system(robot, Couplings(robot), [])
        x = State(0.0, *np.random.default_rng(n).uniform(-0.5, 0.5, (2, n)))
        costs[str(n)] = _best(_acceleration(system, x), rounds) * 1e6 / n
    return costs


def _system(
    robot: Robot, couplings: Couplings, entries: Sequence[Mapping[str, Any]], tier: str = "auto"
) -> System:
    parts = [build_part("constraints", entry, "benchmark", robot) for entry in entries]
    return build_system(robot, couplings, parts, Loads(robot.model.nv), tier)


def _acceleration(system: System, x: State) -> Callable[[], object]:
    accelerate, a = system.accelerator(), np.zeros(system.nv)
    return lambda: accelerate(x.t, x.q, x.v, None, a)


def _step(stepper: Any, x: State) -> Callable[[], None]:
    state = x

    def step() -> None:
        nonlocal state
        state = stepper.step(state, None)

    return step


def _ratios(
    robot: Robot,
    q: np.ndarray,
    v: np.ndarray,
    calls: Mapping[str, Callable[[], object]],
    rounds: int,
) -> dict[str, float]:
    """Median over interleaved rounds of the cost of each call over that of a bare aba."""
    model, data, tau = robot.model, robot.model.createData(), np.zeros(robot.model.nv)
    ratios: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            bare = _time(lambda: pin.aba(model, data, q, v, tau))
            ratios[name].append(_time(call) / bare)
    return {name: float(np.median(values)) for name, values in ratios.items()}


def _best(call: Callable[[], object], rounds: int) -> float:
    return min(_time(call) for _ in range(rounds))


def _time(call: Callable[[], object]) -> float:
    return timeit.timeit(call, number=_CALLS) / _CALLS


def _chain(n: int) -> str:
    links = (_LINK.format(i, f"l{i - 1}" if i else "base", i % 2, (i + 1) % 2) for i in range(n))
    return f'<robot name="chain"><link name="base"/>{"".join(links)}</robot>'


if __name__ == "__main__":
    sys.exit(main())
