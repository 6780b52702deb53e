"""Cost of one projection as a ratio to one `pin.crba` and its Cholesky solve; prints JSON.

python benchmarks/costs/projector.py [--rounds 15]
"""

import argparse
import json
import sys
import timeit
from collections.abc import Callable
from pathlib import Path
from typing import Any

import eigenpy
import numpy as np
import pinocchio as pin

from mbd_ros.core.dynamics.tiers import build_system
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.rows.constraint_rows import rigid
from mbd_ros.core.state import Array, State
from mbd_ros.methods.projection.state_projection import Measurement, StateProjector
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.schema.locate import find_file

_SCENES = ("prosthetic_leg", "prosthetic_arm", "four_bar_leg")
_SAMPLES, _PASSES = 100, 4
_REVOLUTE, _SLIDE = 5.0e-3, 3.0e-4  # noise [rad] and [m]
_BEYOND = 0.05  # a limit [rad]
_ROOM = 0.1  # of its range that a joint is away from its limits
_FASTER = 10.0  # noise of velocities over that of positions [1/s]


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=15)
    rounds = parser.parse_args().rounds
    json.dump({name: _compared(name, rounds) for name in _SCENES}, sys.stdout, indent=2)
    print()
    return 0


def _compared(name: str, rounds: int) -> dict[str, Any]:
    """Medians over interleaved rounds: noise on all joints, and the same beyond a limit."""
    path = find_file(Path(), f"package://mbd_ros/config/scenes/{name}.yaml", "benchmark")
    scene = load_scene(path)
    projector = _projector(scene)
    x = projector.project(_measured(scene, _inside(projector, scene.initial))).x
    inside, outside = _noisy(scene, x), _noisy(scene, _at_limit(projector, x))
    bare = _bare(scene, [m.x.q for m in inside])
    calls = {"inside": _over(projector, inside), "at_limit": _over(projector, outside)}
    result: dict[str, Any] = {"joints": len(scene.robot.joints)}
    for case, call in calls.items():
        times = np.array([(_time(bare), _time(call)) for _ in range(rounds)])
        result[f"{case}_us"] = float(np.median(times[:, 1]) * 1e6)
        result[f"{case}_over_crba_solve"] = float(np.median(times[:, 1] / times[:, 0]))
    return result


def _projector(scene: Scene) -> StateProjector:
    rows, loads = rigid(scene.constraints), Loads(scene.robot.model.nv)
    return StateProjector(build_system(scene.robot, scene.couplings, rows, loads, "kkt"))


def _measured(scene: Scene, x: State) -> Measurement:
    known = np.ones(len(scene.robot.joints), dtype=np.bool_)
    return Measurement(x, known, known)


def _inside(projector: StateProjector, x: State) -> State:
    """The state with no joint near its limits."""
    room = np.nan_to_num(_ROOM * (projector.upper - projector.lower), posinf=0.0)
    return x._replace(q=np.clip(x.q, projector.lower + room, projector.upper - room))


def _at_limit(projector: StateProjector, x: State) -> State:
    """The state with the last joint that no row holds beyond its upper limit."""
    is_free = ~projector.system.jacobian(x.t, x.q).any(axis=0) & np.isfinite(projector.upper)
    q, last = x.q.copy(), is_free.nonzero()[0][-1]
    q[last] = projector.upper[last] + _BEYOND
    return x._replace(q=q)


def _noisy(scene: Scene, x: State) -> list[Measurement]:
    rng, size = np.random.default_rng(0), np.zeros(len(x.q))
    for joint in scene.robot.joints:
        size[joint.v] = _SLIDE if joint.kind == "prismatic" else _REVOLUTE
    noise = size * rng.normal(size=(2, _SAMPLES, len(size)))
    states = (State(x.t, x.q + p, x.v + _FASTER * w) for p, w in zip(*noise, strict=True))
    return [_measured(scene, state) for state in states]


def _bare(scene: Scene, configurations: list[Array]) -> Callable[[], None]:
    """The mass matrix and one solve with it."""
    model, data = scene.robot.model, scene.robot.model.createData()
    right = np.ones(model.nv)

    def run() -> None:
        for q in configurations:
            eigenpy.LLT(pin.crba(model, data, q)).solve(right)

    return run


def _over(projector: StateProjector, measurements: list[Measurement]) -> Callable[[], None]:
    def run() -> None:
        for m in measurements:
            projector.project(m)

    return run


def _time(call: Callable[[], None]) -> float:
    """Of one sample [s]."""
    return timeit.timeit(call, number=_PASSES) / (_PASSES * _SAMPLES)


if __name__ == "__main__":
    sys.exit(main())
