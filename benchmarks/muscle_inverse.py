"""CPU of excitations that explain a recorded motion, beside OpenSim's MocoInverse; prints JSON.

python benchmarks/muscle_inverse.py MODEL.osim MOTION.mot EXTERNAL.xml
    [--cutoff 6] [--interval 0.02] [--reserves 1] [--dynamics activation] [--peer PYTHON]

`seconds` is the CPU time from files to excitations, median of three, imports left out, `finer`
the largest difference of an activation from a mesh of a quarter of the interval. `opensim` is
MocoInverse with the same interval, rigid or elastic tendons (implicit dynamics), reserves and
muscles of De Groote and Fregly, by a Python that has the wheel `opensim`, building included.
Single thread, both in one run.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np

import mbd_ros as mbd


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("model", "motion", "external"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--cutoff", type=float, default=6.0)
    parser.add_argument("--interval", type=float, default=0.02)
    parser.add_argument("--reserves", type=float, default=1.0)
    parser.add_argument("--dynamics", choices=("activation", "tendon"), default="activation")
    parser.add_argument("--peer", help="a Python with the wheel opensim")
    given = parser.parse_args()
    _solved(given, 0.2)  # imports
    times = []
    for _ in range(3):
        begin = time.process_time()
        coarse = _solved(given, given.interval)
        times.append(time.process_time() - begin)
    result: dict[str, Any] = {"seconds": statistics.median(times)}
    fine = _solved(given, 0.25 * given.interval)
    names = [name for name in coarse if name.endswith(".activation")]
    result["finer"] = max(float(np.abs(coarse[n] - fine[n]).max()) for n in names)
    if given.peer:
        script = Path(__file__).with_name("opensim_inverse_muscles.py")
        words = [given.model, given.motion, given.external, given.cutoff, given.interval]
        words += [given.reserves, given.dynamics]
        command = [given.peer, str(script), *map(str, words)]
        said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        result["opensim"] = json.loads(said[said.rindex("{") :])["seconds"]
        result["ratio"] = result["seconds"] / result["opensim"]
    json.dump(result, sys.stdout, indent=2)
    print()
    return 0


def _solved(given: argparse.Namespace, interval: float) -> Any:
    scene = mbd.load_scene(given.model)
    return scene.muscle_forces(
        given.motion,
        external=given.external,
        derivatives="opensim",
        cutoff=given.cutoff,
        reserves=given.reserves,
        dynamics=given.dynamics,
        interval=interval,
    )["samples"]


if __name__ == "__main__":
    sys.exit(main())
