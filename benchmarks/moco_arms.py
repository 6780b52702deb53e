"""Reaches of two arms beside OpenSim Moco, in one run, one thread: CPU seconds and costs.

python benchmarks/moco_arms.py --peer PYTHON [--arm26 arm26.osim] [--intervals 50]

PYTHON has the wheel `opensim`. `arm7` is the embedded arm: Moco's model of it is made of the
numbers of its URDF, and its inverse dynamics is held against ours before Moco is timed. Errors are
relative to our cost at the default tolerance. `arm26` has the muscles of De Groote and Fregly
with elastic tendons; wraps are Moco's own there, polynomials here, so that costs differ by these.

Both sides count building and solving, ours with the integration that checks the result; imports
count on neither. `seconds` is the second of two runs; `first` counts compilers, which the first
one calls for the search of wraps and for that integration.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np
import pinocchio as pin

import mbd_ros as mbd
from mbd_ros.core.kinematics.paths.paths import PathBatch
from mbd_ros.features.prediction.smooth_scene import with_smooth_muscles

THEIRS = Path(__file__).with_name("moco_arm_problems.py")
URDF = Path(mbd.__file__).parents[1] / "config/robots/arm7.urdf"
END = (0.8, 0.7, -0.4, 1.0, 0.5, 0.6, 0.3)
REACH = {"r_shoulder_elev": (0.0, 0.5), "r_elbow_flex": (0.3, 1.5)}
ACTIVATION = 0.05
COARSE = 1.0e-3  # tolerance


def main() -> int:
    """Time both sides of both reaches."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--peer", required=True, help="a Python with the wheel opensim")
    parser.add_argument("--arm26", type=Path, help="the model of OpenSim, unpacked")
    parser.add_argument("--intervals", type=int, default=50, help="of Moco, for arm7")
    given = parser.parse_args()
    mbd.load_scene("hopper").predict("hop")  # imports
    found = {"arm7": arm7(given)}
    if given.arm26 is not None:
        found["arm26"] = arm26(given)
    print(json.dumps(found, indent=1))
    return 0


def arm7(given: argparse.Namespace) -> dict[str, Any]:
    """Seven joints from standing straight to a pose in a second."""
    scene = mbd.load_scene("arm7")
    ends = dict(zip((joint.name for joint in scene.robot.joints), END, strict=True))
    end = {f"{name}.position": q for name, q in ends.items()} | {"*.velocity": 0.0}
    task = {"duration": 1.0, "end": end, "goals": [{"type": "effort"}]}
    found = timed("arm7", task)
    best = found.pop("cost")
    poses = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 3, len(END)))
    asked = {"duration": 1.0, "end": ends, "poses": poses.tolist()}
    theirs = moco(given.peer, URDF, given.intervals, asked)
    model = scene.robot.model
    ours = [pin.rnea(model, model.createData(), *pose) for pose in poses]
    off = np.abs(np.array(theirs["torques"]) - ours).max()
    if off > 1.0e-9 * np.abs(ours).max():
        raise SystemExit(f"arm7: inverse dynamics of both sides differ by {off:g} N m")
    off = abs(theirs["cost"] / best - 1.0)
    found |= beside(found, theirs, given.intervals)
    coarse = timed("arm7", task | {"tolerance": COARSE})
    error = abs(coarse.pop("cost") / best - 1.0)
    coarse |= {"error": error, **beside(coarse, theirs, given.intervals)}
    return found | {"moco_error": off, f"tolerance {COARSE:g}": coarse}


def arm26(given: argparse.Namespace) -> dict[str, Any]:
    """A reach by six muscles, ten intervals on both sides."""
    start = {f"{name}.position": ends[0] for name, ends in REACH.items()}
    end = {f"{name}.position": ends[1] for name, ends in REACH.items()}
    fibers, tensions = balance(given.arm26)
    task = {
        "duration": 0.5,
        "muscles": {"type": "degroote_fregly", "damping": 0.0},
        "start": start | {"*.velocity": 0.0, "*.activation": ACTIVATION} | fibers,
        "end": end | {"*.velocity": 0.0},
        "goals": [{"type": "integral", "of": "*.excitation", "power": 2}],
    }
    asked = {
        "duration": 0.5,
        "activation": ACTIVATION,
        "tensions": tensions,
        **{
            key: {n: ends[i] for n, ends in REACH.items()}
            for i, key in enumerate(("start", "end"))
        },
    }
    theirs = moco(given.peer, given.arm26, 10, asked)
    coarse = {"tolerance": 2.0e-2, "mesh": {"intervals": 10, "refinements": 0}}
    found = timed(str(given.arm26), task | coarse)
    finer = timed(str(given.arm26), task | {"tolerance": 1.0e-4})["cost"]
    found |= {"error": abs(found["cost"] / finer - 1.0), **beside(found, theirs, 10)}
    return found | {"moco_cost": theirs["cost"]}


def balance(model: Path) -> tuple[dict[str, float], dict[str, float]]:
    """Fibre lengths [m] and tensions [peak forces] of muscles at rest where the reach begins."""
    scene, _ = with_smooth_muscles(mbd.load_scene(str(model)), {"damping": 0.0})
    batch = PathBatch(scene.robot, scene.couplings, scene.parts["paths"])
    order = [REACH[name][0] for name in scene.couplings.independent]
    lengths = batch.evaluate(np.array([order])).lengths[0]
    fibers, tensions = dict[str, float](), dict[str, float]()
    for muscle in scene.muscles:
        path = next(i for i, one in enumerate(batch.names) if one == f"{muscle.name}_path")
        at, law = float(lengths[path]), muscle.contraction
        fiber = muscle.stable_lengths(ACTIVATION, at)[0]
        fibers[f"{muscle.name}.fiber_length"] = fiber
        tensions[muscle.name] = float(law.tendon(np, at, fiber) / law.peak)
    return fibers, tensions


def timed(name: str, task: dict[str, Any]) -> dict[str, float]:
    """CPU seconds of a first and of a second run, loading included, and the cost."""
    spent, cost = list[float](), 0.0
    for _ in range(2):
        begin = sum(os.times()[:4])
        cost = mbd.load_scene(name).predict(task).metadata["cost"]
        spent.append(sum(os.times()[:4]) - begin)
    return {"first": round(spent[0], 2), "seconds": round(spent[1], 2), "cost": cost}


def moco(peer: str, model: Path, intervals: int, asked: dict[str, Any]) -> dict[str, Any]:
    """What Moco finds."""
    words = [peer, str(THEIRS), str(model.resolve()), str(intervals)]
    with tempfile.TemporaryDirectory() as folder:  # Moco leaves a file where it runs
        ends = {"capture_output": True, "text": True, "cwd": folder}
        done = subprocess.run(words, input=json.dumps(asked), **ends)
    if not done.stdout:
        raise SystemExit(done.stderr)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def beside(found: dict[str, float], theirs: dict[str, Any], intervals: int) -> dict[str, Any]:
    """Moco's side of a row."""
    return {
        "moco_intervals": intervals,
        "moco_seconds": round(theirs["seconds"], 2),
        "ratio": round(theirs["seconds"] / found["seconds"], 1),
    }


if __name__ == "__main__":
    sys.exit(main())
