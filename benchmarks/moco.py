"""Prediction beside OpenSim Moco, in one run, one thread: CPU seconds and errors of the cost.

python benchmarks/moco.py

Prints JSON. `opensim` must be importable by this Python. Both sides count building and solving,
ours with the integration that checks the result; imports count on neither.
"""

import json
import math
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import mbd_ros

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "test"))
import prediction_problems as problems  # noqa: E402

COSTS = {"cart_pole": 58.80766745817}
MOCO = {  # problem: intervals, and whether controls in the middle are free
    "cart_pole": ("50", "free"),
    "double_pendulum": ("50",),
    "hanging_rigid": ("50",),
    "hanging_elastic": ("50",),
}


def cart_pole() -> tuple:
    """The embedded scene, from hanging to standing."""
    end = {"cart.position": 1.0, "pole.position": math.pi, "*.velocity": 0.0}
    task = {"duration": 2.0, "end": end, "goals": [{"type": "effort"}]}
    return mbd_ros.load_scene("cart_pole"), task, COSTS["cart_pole"]


OURS = {
    "cart_pole": (cart_pole, 1.0e-5),
    "double_pendulum": (problems.swing_up, 1.0e-4),
    "hanging_rigid": (problems.hanging_muscle, 1.0e-5),
    "hanging_elastic": (lambda: problems.hanging_muscle("elastic"), 1.0e-4),
}


def main() -> int:
    """Time both sides of every problem."""
    mbd_ros.load_scene("hopper").predict("hop")  # imports
    found = {}
    for name, (make, tolerance) in OURS.items():
        seconds, error, cost = ours(make, tolerance)
        words = [sys.executable, str(HERE / "moco_problems.py"), name, *MOCO[name]]
        theirs = json.loads(subprocess.run(words, capture_output=True, check=True).stdout)
        found[name] = {
            "seconds": round(seconds, 4),
            "error": error,
            "moco_seconds": round(theirs["seconds"], 3),
            "moco_error": abs(theirs["cost"] / cost - 1.0),
            "ratio": round(theirs["seconds"] / seconds, 1),
        }
    print(json.dumps(found, indent=1))
    return 0


def ours(make: Callable[[], tuple], tolerance: float) -> tuple[float, float, float]:
    """Least CPU seconds of three runs, error and cost."""
    spent = []
    for _ in range(3):
        begin = time.process_time()
        scene, task, cost = make()
        result = scene.predict(task | {"tolerance": tolerance})
        spent.append(time.process_time() - begin)
    return min(spent), abs(result.metadata["cost"] / cost - 1.0), cost


if __name__ == "__main__":
    sys.exit(main())
