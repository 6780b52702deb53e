"""Prediction beside OpenSim Moco, in one run, one thread: CPU seconds and errors of the cost.

python benchmarks/moco.py [--peer PYTHON]

Prints JSON. PYTHON, by default this one, has the wheel `opensim`. Both sides count building and
solving, ours with the integration that checks the result; imports count on neither. Moco takes 50
intervals, and twice as many again until its error is not larger than ours: `ratio` is that to 50
intervals, `ratio_at_equal_error` that to the last ones.
"""

import argparse
import json
import math
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import mbd_ros

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "test"))
import prediction_problems as problems  # noqa: E402

COSTS = {"cart_pole": 58.80766745817}
FREE = ("cart_pole",)  # where Moco does better with controls that are free inside of intervals
FIRST, LAST = 50, 400  # intervals of Moco


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
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--peer", default=sys.executable, help="a Python with the wheel opensim")
    peer = parser.parse_args().peer
    mbd_ros.load_scene("hopper").predict("hop")  # imports
    found = {}
    for name, (make, tolerance) in OURS.items():
        seconds, error, cost = ours(make, tolerance)
        runs = list(moco(peer, name, cost, error))
        found[name] = {
            "seconds": round(seconds, 4),
            "error": error,
            "moco": runs,
            "ratio": round(runs[0]["seconds"] / seconds, 1),
            "ratio_at_equal_error": round(runs[-1]["seconds"] / seconds, 1),
        }
    print(json.dumps(found, indent=1))
    return 0


def moco(peer: str, name: str, cost: float, error: float) -> Iterator[dict[str, float]]:
    """Moco on finer and finer meshes, until its error is not larger than one."""
    intervals, off = FIRST, math.inf
    while off > error and intervals <= LAST:
        words = [peer, str(HERE / "moco_problems.py"), name, str(intervals)]
        words += ["free"] * (name in FREE)
        theirs = json.loads(subprocess.run(words, capture_output=True, check=True).stdout)
        off = abs(theirs["cost"] / cost - 1.0)
        yield {"intervals": intervals, "seconds": round(theirs["seconds"], 3), "error": off}
        intervals *= 2


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
