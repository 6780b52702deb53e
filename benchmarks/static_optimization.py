"""CPU a frame of static optimisation beside OpenSim's on laboratory files; prints JSON.

python benchmarks/static_optimization.py MODEL.osim MOTION.mot EXTERNAL.xml RESERVES.xml
    [--cutoff 6] [--peer PYTHON]

`frame` is the time from positions, velocities and accelerations to activations [ms]: lengths,
moment arms, fibres, inverse dynamics and the program; `live` is the same, one frame at a time;
`loads` adds the loads of all joints. `opensim` is its StaticOptimization at the default accuracy,
by a Python that has the wheel `opensim`, the time of the motion's file and filter taken off.
Single thread, both in one run.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np

from mbd_ros.core.state import State
from mbd_ros.features.muscles.task import muscles_task
from mbd_ros.motion.derivatives import Derivatives
from mbd_ros.motion.external_loads import ExternalLoads
from mbd_ros.motion.samples import Task, observe_motion
from mbd_ros.scene.reader import load_scene

_ROUNDS = 3


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("model", "motion", "external", "reserves"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--cutoff", type=float, default=6.0)
    parser.add_argument("--peer", help="a Python with the wheel opensim")
    given = parser.parse_args()
    words = [given.model, given.motion, given.external, given.reserves]
    result = _ours(given)
    if given.peer:
        script = Path(__file__).with_name("opensim_sharing.py")
        command = [given.peer, str(script), *map(str, words), str(given.cutoff)]
        said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        peer = json.loads(said[said.index("{") :])
        result["opensim"] = 1e3 * peer["per_frame"]
        result["ratio"] = result["frame"] / result["opensim"]
        result["ratio_live"] = result["live"] / result["opensim"]
    json.dump(result, sys.stdout, indent=2)
    print()
    return 0


def _ours(given: argparse.Namespace) -> dict[str, Any]:
    external = ExternalLoads(load_scene(given.model), given.external)
    scene = external.scene
    asked = {"reserves": str(given.reserves.absolute()), "reactions": "child"}
    task = muscles_task(scene, asked, "benchmark")
    solver, loads = task.solver(scene), task.loads(scene)
    motion = Task(given.motion, Derivatives("opensim", given.cutoff, None))
    observed = observe_motion(scene, motion, lambda text: None, external)
    times = observed.samples.stamps * 1e-9
    rows = observed.samples[1:4]

    def whole() -> Any:
        return solver.solve(times, *rows, observed.wrenches)

    def live() -> None:
        for i in range(len(times)):
            some = slice(i, i + 1)
            solver.solve(
                times[some], *(r[some] for r in rows), [w[some] for w in observed.wrenches]
            )

    shares = whole()
    q, v, a = (values.T for values in solver.motion)

    def joint_loads() -> None:
        for i in range(len(times)):
            x, wrenches = State(0.0, q[i], v[i]), [wrench[i] for wrench in observed.wrenches]
            loads.solve(x, a[i], shares.force[i], shares.reserve[i], wrenches)

    found: dict[str, Any] = {"muscles": len(solver.muscles), "frames": len(times)}
    for name, call in (("frame", whole), ("live", live), ("loads", joint_loads)):
        found[name] = 1e3 * _least(call) / len(times)
    found["residual"] = float(shares.residual.max())
    found["feasible"] = bool(np.all(shares.is_feasible))
    return found


def _least(call: Any) -> float:
    taken = []
    for _ in range(_ROUNDS):
        begin = time.process_time()
        call()
        taken.append(time.process_time() - begin)
    return min(taken)


if __name__ == "__main__":
    sys.exit(main())
