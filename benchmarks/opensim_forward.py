"""A second of motion driven by muscles, beside OpenSim's Manager.

python benchmarks/opensim_forward.py MODEL.osim --peer PYTHON [--solver compiled] [--duration 1.0]

Prints JSON: CPU time [s] on one thread and error of both, by accuracy, the times at an error of
1e-6 between them, and their ratio. PYTHON is one that has `opensim`, since it goes with other
libraries than this package. All muscles start at an activation of 0.05 in equilibrium, and have
constant excitations between 0.05 and 0.4. The error is the largest of positions and velocities
[rad, rad/s] against the same program at its finest, since paths that wrap differ in themselves.
With its wraps, `arm26` takes `--duration 0.85`: later its elbow is so far beyond its range that
triceps jump to the other side of their cylinder.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from mbd_ros import load_scene
from mbd_ros.core.dynamics.sources import HeldTable
from mbd_ros.core.state import Array
from mbd_ros.scene.built_scene import Scene

_ROUNDS, _FIRST, _WANTED = 3, 0.05, 1.0e-6
_ACCURACIES = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
_FINEST = 1e-12
_PEER = """
import json, sys, time
import opensim
path, excitations, accuracies, duration, first, rounds = json.loads(sys.argv[1])
opensim.Logger.setLevelString("Off")
model = opensim.Model(path)
control = opensim.PrescribedController()
for name in excitations:
    control.addActuator(model.getMuscles().get(name))
model.addController(control)
for name, level in excitations.items():
    control.prescribeControlForActuator(name, opensim.Constant(level))
coordinates = model.getCoordinateSet()
found = []
for accuracy in accuracies:
    shortest = 1e9
    for _ in range(rounds):
        state = model.initSystem()
        for name in excitations:
            model.getMuscles().get(name).setActivation(state, first)
        model.equilibrateMuscles(state)
        manager = opensim.Manager(model)
        manager.setIntegratorAccuracy(accuracy)
        manager.setWriteToStorage(False)
        state.setTime(0.0)
        manager.initialize(state)
        begin = time.process_time()
        state = manager.integrate(duration)
        shortest = min(shortest, time.process_time() - begin)
    each = [coordinates.get(i) for i in range(coordinates.getSize())]
    end = [one.getValue(state) for one in each] + [one.getSpeedValue(state) for one in each]
    found.append([accuracy, shortest, end])
print(json.dumps(found))
"""


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("model", type=Path)
    parser.add_argument("--solver", default="compiled")
    parser.add_argument("--duration", type=float, default=1.0)
    parser.add_argument("--peer", default=sys.executable)
    words = parser.parse_args()
    scene = load_scene(words.model)
    names = [part.name for part in scene.muscles]
    levels = dict(zip(names, np.linspace(0.05, 0.4, len(names)).round(3).tolist(), strict=True))
    accuracies, end = [*_ACCURACIES, _FINEST], words.duration
    ours = [_ours(scene, words.solver, levels, accuracy, end) for accuracy in accuracies]
    given = [str(words.model), levels, accuracies, end, _FIRST, _ROUNDS]
    ran = subprocess.run(
        [words.peer, "-c", _PEER, json.dumps(given)], capture_output=True, text=True, check=True
    )
    theirs = [(a, s, np.array(end)) for a, s, end in json.loads(ran.stdout.splitlines()[-1])]
    found = {"ours": _errors(ours), "opensim": _errors(theirs)}
    at = {name: _at_error(rows) for name, rows in found.items()}
    print(json.dumps({**found, "seconds": at, "ratio": at["ours"] / at["opensim"]}, indent=1))
    return 0


def _ours(
    scene: Scene, solver: str, levels: dict[str, float], tolerance: float, duration: float
) -> tuple[float, float, Array]:
    """Tolerance, CPU time of the quickest round, and the end."""
    first = {"internal": {name: {"activation": _FIRST} for name in levels}}
    scene = scene.with_(initial={**scene.entries.get("initial", {}), **first})
    sources = {n: HeldTable(np.zeros(1), np.full((1, 1), u)) for n, u in levels.items()}
    method = {"type": "dop853", "tolerance": tolerance}
    simulation = scene.simulation(
        integrator=method, dt=duration, solver={"type": solver}, sources=sources
    )
    shortest = np.inf
    for _ in range(_ROUNDS):
        begin = time.process_time()
        *_, end = simulation.run(scene.initial, duration)
        shortest = min(shortest, time.process_time() - begin)
    return tolerance, shortest, np.concatenate((end.q, end.v))


def _errors(runs: list[tuple[float, float, Array]]) -> list[tuple[float, float, float]]:
    """Accuracy, time and error of each run but the finest."""
    *coarse, (_, _, exact) = runs
    return [(a, s, float(np.abs(end - exact).max())) for a, s, end in coarse]


def _at_error(rows: list[tuple[float, float, float]]) -> float:
    """Time at the wanted error, by straight lines between logarithms."""
    rows = sorted(rows, key=lambda row: row[2])
    errors, seconds = (np.log([max(row[i], 1e-300) for row in rows]) for i in (2, 1))
    return float(np.exp(np.interp(np.log(_WANTED), errors, seconds)))


if __name__ == "__main__":
    sys.exit(main())
