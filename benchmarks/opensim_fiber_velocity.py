"""Speeds of fibres beside elastic tendons, of given length, beside OpenSim's in full digits.

python benchmarks/opensim_fiber_velocity.py MODEL.osim --peer PYTHON [--poses 50] [--seed 1]

Prints JSON: how many were compared, the largest and the median difference [m/s], and the muscle of
the largest one with what both say. Poses are random within the ranges of the coordinates, tendons
are strained by up to 0.04, activations are between 0.02 and 1. Lengths of paths are OpenSim's, so
that wraps differ in nothing. PYTHON is one that has `opensim`, by
default this one (extra `peers`).
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from mbd_ros import load_scene
from mbd_ros.core.muscles.curves import ArrayNumbers

_PEER = """
import json, math, random, sys
import opensim
path, poses, seed = json.loads(sys.argv[1])
opensim.Logger.setLevelString("Off")
rng = random.Random(seed)
model = opensim.Model(path)
state = model.initSystem()
every, muscles = model.getCoordinateSet(), model.getMuscles()
free = [every.get(i) for i in range(every.getSize())]
free = [one for one in free if not one.isConstrained(state) and not one.getLocked(state)]
found = []
for _ in range(poses):
    for one in free:
        low, high = max(one.getRangeMin(), -1.5), min(one.getRangeMax(), 1.5)
        one.setValue(state, rng.uniform(low, high), False)
    model.assemble(state)
    model.realizePosition(state)
    asked = []  # all lengths are set before any is used: OpenSim keeps what it derived from them
    for i in range(muscles.getSize()):
        muscle = muscles.get(i)
        tendon = muscle.getTendonSlackLength() * (1.0 + rng.uniform(0.001, 0.04))
        along, optimal = muscle.getLength(state) - tendon, muscle.getOptimalFiberLength()
        height = optimal * math.sin(muscle.getPennationAngleAtOptimalFiberLength())
        activation = rng.uniform(0.02, 1.0)
        if along > 0.1 * optimal:
            muscle.setActivation(state, activation)
            muscle.setStateVariableValue(state, "fiber_length", math.hypot(along, height))
            asked.append(muscle)
    model.realizeDynamics(state)
    found += [
        [m.getName(), m.getActivation(state), m.getLength(state), m.getFiberLength(state),
         m.getFiberVelocity(state)]
        for m in asked
    ]
print(json.dumps(found))
"""


def main() -> int:
    """Compare and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("model", type=Path)
    parser.add_argument("--poses", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--peer", default=sys.executable)
    words = parser.parse_args()
    given = json.dumps([str(words.model), words.poses, words.seed])
    ran = subprocess.run(
        [words.peer, "-c", _PEER, given], capture_output=True, text=True, check=True
    )
    names, *columns = zip(*json.loads(ran.stdout.splitlines()[-1]), strict=True)
    activation, length, fiber, theirs = (np.array(column) for column in columns)
    ours, of = np.empty(len(names)), np.array(names)
    for muscle in load_scene(words.model).muscles:
        at = of == muscle.name
        law, state = muscle.contraction, (activation[at], length[at], fiber[at])
        ours[at] = law.beside_elastic_tendon(ArrayNumbers, *state).velocity
    off = np.abs(ours - theirs)
    worst = int(off.argmax())
    found = {
        "compared": len(off),
        "largest": float(off[worst]),
        "median": float(np.median(off)),
        "worst": [names[worst], float(ours[worst]), float(theirs[worst])],
    }
    print(json.dumps(found, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
