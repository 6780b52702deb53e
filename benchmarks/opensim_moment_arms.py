"""Lengths and moment arms of all muscles, beside OpenSim.

python benchmarks/opensim_moment_arms.py MODEL.osim --peer PYTHON [--poses 500]

Prints JSON: CPU time a pose [s] on one thread of both, and their ratio, for random poses within
the bounds of all joints, and for a motion through these. PYTHON is one that has `opensim`, which
computes `getLength` and `computeMomentArm` about every coordinate. What is compiled, is before.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from mbd_ros import load_scene
from mbd_ros.core.kinematics.paths.paths import PathBatch
from mbd_ros.core.state import Array
from mbd_ros.scene.runs.path_search import QuickestSearch

_ROUNDS = 3
_FREE = 1.5  # rad or m, on either side of 0 where a joint has no bound
_PEER = """
import json, sys, time
import numpy, opensim
path, names, files, rounds = json.loads(sys.argv[1])
opensim.Logger.setLevelString("Off")
model = opensim.Model(path)
state = model.initSystem()
muscles = [model.getMuscles().get(i) for i in range(model.getMuscles().getSize())]
coordinates = [model.getCoordinateSet().get(name) for name in names]
found = []
for poses in files:
    shortest = 1e9
    for _ in range(rounds):
        begin = time.process_time()
        for pose in poses:
            for coordinate, value in zip(coordinates, pose):
                coordinate.setValue(state, value, False)
            model.realizePosition(state)
            for muscle in muscles:
                muscle.getLength(state)
                for coordinate in coordinates:
                    muscle.computeMomentArm(state, coordinate)
        shortest = min(shortest, time.process_time() - begin)
    found.append(shortest / len(poses))
print(json.dumps(found))
"""


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("model", type=Path)
    parser.add_argument("--peer", default=sys.executable)
    parser.add_argument("--poses", type=int, default=500)
    words = parser.parse_args()
    scene = load_scene(words.model)
    joints = [scene.robot.joint(name) for name in scene.couplings.independent]
    lower = np.array([max(joint.lower, -_FREE) for joint in joints])
    upper = np.array([min(joint.upper, _FREE) for joint in joints])
    shares = np.random.default_rng(0).uniform(size=(words.poses, len(joints)))
    along = np.linspace(0.0, 1.0, words.poses)[:, None]
    poses = {"random": lower + shares * (upper - lower), "motion": lower + along * (upper - lower)}
    batch = PathBatch(
        scene.robot,
        scene.couplings,
        {muscle.name: muscle.path for muscle in scene.muscles},
        QuickestSearch(),
    )
    ours = [_ours(batch, each) for each in poses.values()]
    given = [str(words.model), [joint.name for joint in joints]]
    given += [[each.tolist() for each in poses.values()], _ROUNDS]
    ran = subprocess.run(
        [words.peer, "-c", _PEER, json.dumps(given)], capture_output=True, text=True, check=True
    )
    theirs = json.loads(ran.stdout.splitlines()[-1])
    rows = zip(poses, ours, theirs, strict=True)
    print(json.dumps({n: {"ours": a, "opensim": b, "ratio": a / b} for n, a, b in rows}, indent=1))
    return 0


def _ours(batch: PathBatch, poses: Array) -> float:
    """CPU time a pose [s] of the quickest round."""
    batch.evaluate(poses[:1])
    shortest = np.inf
    for _ in range(_ROUNDS):
        begin = time.process_time()
        batch.evaluate(poses)
        shortest = min(shortest, time.process_time() - begin)
    return shortest / len(poses)


if __name__ == "__main__":
    sys.exit(main())
