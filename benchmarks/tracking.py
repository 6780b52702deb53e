"""CPU of a recorded motion that is tracked by torques of joints, beside MocoTrack; prints JSON.

python benchmarks/tracking.py MODEL.osim MOTION.mot EXTERNAL.xml FIRST LAST
    [--interval 0.02] [--weight 100] [--effort 1e-4] [--peer PYTHON]

`seconds` is the CPU time from files to a solution, imports left out. `opensim` is MocoTrack with
the same times, weights and drives, with its own tolerances and the given interval, by a Python
that has the wheel `opensim`, building included. Single thread, both in one run.
`opensim_from_here` is the same search begun at the motion that was found here.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

os.environ["OMP_NUM_THREADS"] = "1"

import mbd_ros as mbd
from mbd_ros.files.table import Result


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("model", "motion", "external"):
        parser.add_argument(name, type=lambda word: Path(word).absolute())
    parser.add_argument("first", type=float)
    parser.add_argument("last", type=float)
    parser.add_argument("--interval", type=float, default=0.02)
    parser.add_argument("--weight", type=float, default=100.0)
    parser.add_argument("--effort", type=float, default=1.0e-4)
    parser.add_argument("--peer", type=os.path.abspath, help="a Python with the wheel opensim")
    given = parser.parse_args()
    any_task = {"duration": 1.0, "goals": [{"type": "effort"}]}
    mbd.load_scene("cart_pole").predict(any_task)  # imports
    begin = time.process_time()
    found = _tracked(given)
    metadata = found.metadata
    result: dict[str, Any] = {"seconds": time.process_time() - begin}
    result |= {key: metadata[key] for key in ("cost", "error", "replay", "iterations")}
    if given.peer:
        script = Path(__file__).with_name("opensim_tracking.py")
        words = [given.model, given.motion, given.external, given.first, given.last]
        words += [given.interval, given.weight, given.effort]
        command = [given.peer, str(script), *map(str, words)]
        with TemporaryDirectory() as folder:  # MocoTrack leaves files where it runs
            result["opensim"] = _asked(command, folder)
            guess = Path(folder, "found.csv")
            Result({"samples": found["samples"]}).to(guess)
            result["opensim_from_here"] = _asked([*command, str(guess)], folder)
        result["ratio"] = result["seconds"] / result["opensim"]["seconds"]
    json.dump(result, sys.stdout, indent=2)
    print()
    return 0


def _asked(command: list[str], folder: str) -> dict[str, Any]:
    ran = subprocess.run(command, check=True, capture_output=True, text=True, cwd=folder)
    found: dict[str, Any] = json.loads(ran.stdout[ran.stdout.rindex("{") :])
    return found


def _tracked(given: argparse.Namespace) -> Result:
    recording = {"motion": str(given.motion), "external": str(given.external)}
    task = {
        "recording": recording | {"times": [given.first, given.last]},
        "driven_by": "joints",
        "goals": [
            {"type": "tracking", "of": "*.position", "weight": given.weight},
            {"type": "effort", "weight": given.effort},
        ],
    }
    return mbd.load_scene(given.model).predict(task)


if __name__ == "__main__":
    sys.exit(main())
