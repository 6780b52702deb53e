"""Inverse dynamics of a recorded motion, a frame, beside OpenSim's InverseDynamicsSolver.

python benchmarks/opensim_inverse.py MODEL.osim MOTION.mot [--external LOADS.xml] --peer PYTHON

Prints JSON: CPU time a frame [us] of both on one thread, in turn, and their ratio. PYTHON is one
that has `opensim`, by default this one (extra `peers`). Both get positions,
velocities and accelerations of every frame (`--derivatives opensim`). OpenSim's muscles are off,
and it has no external loads, whose splines would cost it more than all else; ours has them.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from mbd_ros import load_scene
from mbd_ros.motion.derivatives import Derivatives
from mbd_ros.motion.external_loads import ExternalLoads
from mbd_ros.motion.samples import Task, observe_motion

_ROUNDS = 5
_FRAMES = 3000  # at least, for a round
_PEER = """
import json, sys, time
import opensim
model, motion = sys.argv[1:3]
opensim.Logger.setLevelString("Off")
model = opensim.Model(model)
state = model.initSystem()
forces = model.getForceSet()
for i in range(forces.getSize()):
    if opensim.Muscle.safeDownCast(forces.get(i)):
        forces.get(i).setAppliesForce(state, False)
names, *rows = json.load(open(motion))
own = [model.getCoordinateSet().get(i).getName() for i in range(model.getNumCoordinates())]
vectors = [
    [opensim.Vector([row[k].get(n, 0.0) for n in own]) for row in rows] for k in range(1, 4)
]
solver = opensim.InverseDynamicsSolver(model)
begin = time.process_time()
for row, q, u, a in zip(rows, *vectors):
    state.setTime(row[0])
    state.setQ(q)
    state.setU(u)
    solver.solve(state, a)
print((time.process_time() - begin) / len(rows) * 1e6)
"""


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("model", type=Path)
    parser.add_argument("motion", type=Path)
    parser.add_argument("--external", type=Path)
    parser.add_argument("--cutoff", type=float, default=6.0)
    parser.add_argument("--peer", default=sys.executable)
    words = parser.parse_args()
    scene, external = load_scene(words.model), None
    if words.external:
        external = ExternalLoads(scene, words.external)
        scene = external.scene
    task = Task(words.motion, Derivatives("opensim", words.cutoff), external=words.external)
    observed = observe_motion(scene, task, lambda text: None, external)
    solver, samples = scene.inverse_dynamics(), observed.samples
    times = -(-_FRAMES // len(samples.stamps))
    motion = [np.tile(values, (times, 1)) for values in samples[1:4]]
    loads = [np.tile(values, (times, 1)) for values in observed.wrenches]
    names = scene.couplings.independent
    rows = [
        [stamp * 1e-9, *(dict(zip(names, value.tolist(), strict=True)) for value in values)]
        for stamp, *values in zip(samples.stamps.tolist(), *samples[1:4], strict=True)
    ]
    ours, theirs = [], []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "motion.json"
        path.write_text(json.dumps([list(names), *rows]))
        order = [words.peer, "-c", _PEER, words.model, path]
        for _ in range(_ROUNDS):
            begin = time.process_time()
            solver.batch(*motion, loads)
            ours.append((time.process_time() - begin) / len(motion[0]) * 1e6)
            said = subprocess.run(
                list(map(str, order)), capture_output=True, check=True, text=True
            )
            theirs.append(float(said.stdout.split()[-1]))
    found = {"mbd_ros": min(ours), "opensim": min(theirs), "ratio": min(ours) / min(theirs)}
    print(json.dumps({"coordinates": len(names), "frames": len(samples.stamps), **found}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
