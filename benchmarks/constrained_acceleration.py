"""What each formulation saves beside the constrained acceleration on one page.

python benchmarks/constrained_acceleration.py [--rounds 5]

Prints a line a scene: its formulation, the time of `core/dynamics/step.py` and of the accelerator
that integrators call [us], and their ratio. Times are the shortest of some rounds.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from mbd_ros.api import load_scene
from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.dynamics.step import constrained_acceleration
from mbd_ros.core.dynamics.tiers import tier_of
from mbd_ros.core.rows.constraint_rows import ConstraintRows

SCENES = Path(__file__).parents[1] / "config/scenes"
CASES = {  # scene -> types of its solver
    "arm7": ("aba",),
    "prosthetic_arm": ("reduced", "kkt"),
    "prosthetic_leg": ("reduced", "kkt", "qp"),
    "four_bar_leg": ("kkt", "qp"),
}
_CALLS = 200  # of one round


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=5, help="rounds, of which the best counts")
    rounds = parser.parse_args().rounds
    print(f"{'scene':<16} {'formulation':<14} {'step':>8} {'accelerator':>12} {'ratio':>7}")
    for name, solvers in CASES.items():
        for solver in solvers:
            print(f"{name:<16} {compare(name, solver, rounds)}")


def compare(name: str, solver: str, rounds: int) -> str:
    """Return the line of a scene."""
    scene = load_scene(SCENES / f"{name}.yaml")
    system = scene.system(solver={"type": solver})
    y = system.reduce(scene.initial)
    x = system.expand(y)
    mechanism = Mechanism(system.robot, system.loads)
    rows = ConstraintRows(system.layout.blocks, int(system.model.nv))
    accelerate, a = system.accelerator(), np.zeros(system.nv)
    step = best(lambda: constrained_acceleration(mechanism, rows, x), rounds)
    fast = best(lambda: accelerate(y.t, y.q, y.v, None, a), rounds)
    times = f"{step * 1e6:8.1f} {fast * 1e6:12.1f} {step / fast:7.1f}"
    return f"{tier_of(system):<14} {times}"


def best(call: Callable[[], object], rounds: int) -> float:
    """Return the shortest time of a call [s]."""
    times = []
    for _ in range(rounds):
        begin = time.process_time()
        for _ in range(_CALLS):
            call()
        times.append((time.process_time() - begin) / _CALLS)
    return min(times)


if __name__ == "__main__":
    main()
