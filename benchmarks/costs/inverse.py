"""Cost of inverse dynamics as ratios to bare Pinocchio calls and to a bare echo node; prints JSON.

python benchmarks/costs/inverse.py [--seconds 4] [--leg SCENE]
"""

import argparse
import json
import sys
import time
import timeit
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from node_load import Load, measure

from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.schema.locate import find_file

_SAMPLES, _ROUNDS = 100_000, 5


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=4.0, help="per node run")
    parser.add_argument("--leg", type=Path, default=_embedded("prosthetic_leg_stance"))
    arguments = parser.parse_args()
    arm, leg = load_scene(_embedded("arm7")), load_scene(arguments.leg)
    result = {
        "arm": _calls(arm),
        "leg": {"scene": str(arguments.leg), **_calls(leg)},
        "node": _nodes(arm, arguments.seconds),
    }
    json.dump(result, sys.stdout, indent=2)
    print()
    return 0


def _embedded(name: str) -> Path:
    return find_file(Path(), f"package://mbd_ros/config/scenes/{name}.yaml", "benchmark")


def _calls(scene: Scene) -> dict[str, Any]:
    """Single calls and a batch against bare rnea of the same model."""
    model, data = scene.robot.model, scene.robot.model.createData()
    random = np.random.default_rng(1)
    q, v, a = random.uniform(-0.5, 0.5, (3, model.nv))
    z, w, b = (x[scene.couplings.v_index] for x in (q, v, a))
    loads = [random.normal(size=6) for _ in scene.wrenches]
    inverse = scene.inverse_dynamics()
    bare, ours = _paired(
        lambda: pin.rnea(model, data, q, v, a), lambda: inverse.solve(z, w, b, loads)
    )
    return {
        "joints": len(scene.robot.joints),
        "dependent": len(scene.couplings.dependent),
        "wrenches": len(scene.wrenches),
        "bare_rnea_us": bare * 1e6,
        "solve_us": ours * 1e6,
        "solve_over_rnea": ours / bare,
        "batch_rate_over_rnea_loop": _batch_ratio(scene),
    }


def _batch_ratio(scene: Scene) -> float:
    """Samples per second of an unloaded batch over those of a loop of bare rnea."""
    model, data, inverse = (
        scene.robot.model,
        scene.robot.model.createData(),
        scene.inverse_dynamics(),
    )
    random = np.random.default_rng(2)
    full = random.uniform(-0.5, 0.5, (3, _SAMPLES, model.nv))
    free = np.ascontiguousarray(full[:, :, scene.couplings.v_index])

    def loop() -> None:
        for q, v, a in zip(*full, strict=True):
            pin.rnea(model, data, q, v, a)

    return min(_timed(loop) for _ in range(3)) / min(
        _timed(lambda: inverse.batch(*free)) for _ in range(3)
    )


def _timed(call: Callable[[], Any]) -> float:
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


def _paired(first: Callable[[], Any], second: Callable[[], Any]) -> tuple[float, float]:
    """Best time of two calls, measured in turns so that a change of the machine hits both [s]."""
    timers, number = (timeit.Timer(first), timeit.Timer(second)), 5000
    rounds = [[timer.timeit(number) / number for timer in timers] for _ in range(15)]
    return min(r[0] for r in rounds), min(r[1] for r in rounds)


def _nodes(scene: Scene, seconds: float) -> dict[str, Any]:
    """The node beside a bare echo: kept busy, and at 1 kHz, where either sleeps in between."""
    joints = scene.couplings.independent
    echo = [str(Path(__file__).with_name("echo_node.py"))]
    ours = ["-m", "mbd_ros.nodes", "inverse_dynamics", "--ros-args", "-p", f"scene:={scene.path}"]
    streams = {"busy": {"in_flight": 8}, "at 1 kHz": {"rate": 1000.0}}
    return {
        stream: _side_by_side(
            [
                (
                    measure(echo, joints, seconds=seconds, **how),
                    measure(ours, joints, seconds=seconds, **how),
                )
                for _ in range(_ROUNDS)
            ]
        )
        for stream, how in streams.items()
    }


def _side_by_side(rounds: list[tuple[Load, Load]]) -> dict[str, Any]:
    ratios = {
        f"{key}_over_echo": float(
            np.median([getattr(node, key) / getattr(echo, key) for echo, node in rounds])
        )
        for key in ("main_thread_us", "process_us", "round_trip_us")
    }
    echo, node = rounds[-1]
    return {**ratios, "last echo": echo._asdict(), "last inverse_dynamics": node._asdict()}


if __name__ == "__main__":
    sys.exit(main())
