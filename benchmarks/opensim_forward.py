"""A second of motion driven by muscles, beside OpenSim's Manager.

python benchmarks/opensim_forward.py MODEL.osim --peer PYTHON [--straight] [--solver compiled]

Prints JSON: CPU time [s] on one thread and error of both, by accuracy, the times at an error of
1e-6 between them, their ratio, and the range of every coordinate. PYTHON is one that has
`opensim`, by default this one (extra `peers`). All muscles start at an activation
of 0.05 in equilibrium and get a burst: an excitation that rises from 0.05 by `--peak` in the
middle of the run and falls back, a polynomial of degree 4 in time, so that neither program has
to find a jump. The defaults are those of `arm26`, whose elbow bends and stays in its range.
`--constant` gives constant excitations between 0.05 and 0.4 instead; with its wraps, `arm26` takes
`--constant --duration 0.85`, since later its elbow is so far beyond its range that triceps jump to
the other side of their cylinder. The error is the largest of positions and velocities [rad, rad/s]
against the same program at its finest, since paths that wrap differ in themselves.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from mbd_ros import load_scene
from mbd_ros.core.loads.inputs import Polynomials
from mbd_ros.core.state import Array
from mbd_ros.scene.built_scene import Scene

_ROUNDS, _FIRST, _WANTED = 3, 0.05, 1.0e-6
_ACCURACIES = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
_FINEST = 1e-12
_BURST = (0.0, 0.0, 16.0, -32.0, 16.0)  # of the share of the run, by rising power: 1 in its middle
_PEER = """
import json, sys, time
import opensim
path, starts, excitations, accuracies, duration, first, rounds = json.loads(sys.argv[1])
opensim.Logger.setLevelString("Off")
model = opensim.Model(path)
control = opensim.PrescribedController()
for name in excitations:
    control.addActuator(model.getMuscles().get(name))
model.addController(control)
for name, powers in excitations.items():
    rows = opensim.Vector(len(powers), 0.0)
    for i, power in enumerate(reversed(powers)):
        rows.set(i, power)
    control.prescribeControlForActuator(name, opensim.PolynomialFunction(rows))
coordinates = model.getCoordinateSet()
found = []
for accuracy in accuracies:
    shortest = 1e9
    for _ in range(rounds):
        state = model.initSystem()
        for name, value in starts.items():
            coordinates.get(name).setValue(state, value)
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


class Drive(NamedTuple):
    """What both programs are given.

    Attributes:
        starts: Positions at the start by coordinate [rad or m], 0 for all others.
        excitations: Muscle -> coefficients of its excitation by rising power of time [s].
        duration: [s].
    """

    starts: dict[str, float]
    excitations: dict[str, list[float]]
    duration: float


def main() -> int:
    """Measure and print."""
    words = _words()
    with tempfile.TemporaryDirectory() as folder:
        model: Path = words.model
        if words.straight:
            model = _without_wraps(model, Path(folder))
        scene = load_scene(model)
        drive = _drive(words, [part.name for part in scene.muscles])
        accuracies = [*_ACCURACIES, _FINEST]
        ours = [_ours(scene, words.solver, drive, accuracy) for accuracy in accuracies]
        given = [str(model), drive.starts, drive.excitations, accuracies, drive.duration]
        ran = subprocess.run(
            [words.peer, "-c", _PEER, json.dumps([*given, _FIRST, _ROUNDS])],
            capture_output=True,
            text=True,
            check=True,
        )
    theirs = [(a, s, np.array(end)) for a, s, end in json.loads(ran.stdout.splitlines()[-1])]
    found = {"ours": _errors(ours), "opensim": _errors(theirs)}
    at = {name: _at_error(rows) for name, rows in found.items()}
    ranges = _ranges(scene, words.solver, drive)
    ends = {"apart": float(np.abs(ours[-1][2] - theirs[-1][2]).max()), "ranges": ranges}
    print(json.dumps({**found, **ends, "seconds": at, "ratio": at["ours"] / at["opensim"]}))
    return 0


def _words() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("model", type=Path)
    parser.add_argument("--solver", default="compiled")
    parser.add_argument("--duration", type=float, default=1.0)
    parser.add_argument("--peer", default=sys.executable)
    parser.add_argument("--straight", action="store_true", help="the model without its wraps")
    parser.add_argument("--constant", action="store_true", help="excitations do not change")
    start, peak = ["r_elbow_flex=0.5"], ["=0.2", "TRI=0.1"]
    parser.add_argument("--start", nargs="*", default=start, help="COORDINATE=POSITION")
    parser.add_argument("--peak", nargs="*", default=peak, help="BEGIN_OF_NAME=RISE, last counts")
    return parser.parse_args()


def _drive(words: argparse.Namespace, names: Sequence[str]) -> Drive:
    if words.constant:
        levels = np.linspace(0.05, 0.4, len(names)).round(3).tolist()
        constant = {name: [level] for name, level in zip(names, levels, strict=True)}
        return Drive({}, constant, words.duration)
    bursts: dict[str, list[float]] = {}
    for begin, rise in _pairs(words.peak).items():
        for name in names:
            if name.startswith(begin):
                powers = [rise * c / words.duration**i for i, c in enumerate(_BURST)]
                bursts[name] = [_FIRST + powers[0], *powers[1:]]
    return Drive(_pairs(words.start), bursts, words.duration)


def _pairs(texts: Sequence[str]) -> dict[str, float]:
    return {name: float(value) for name, value in (text.split("=") for text in texts)}


def _without_wraps(model: Path, folder: Path) -> Path:
    tree = ElementTree.parse(model)
    for wraps in tree.iter("PathWrapSet"):
        for inside in list(wraps):
            wraps.remove(inside)
    straight = folder / model.name
    tree.write(straight)
    return straight


def _ours(scene: Scene, solver: str, drive: Drive, tolerance: float) -> tuple[float, float, Array]:
    """Tolerance, CPU time of the quickest round, and the end."""
    start, simulation = _simulation(scene, solver, drive, tolerance, drive.duration)
    shortest = np.inf
    for _ in range(_ROUNDS):
        begin = time.process_time()
        *_, end = simulation.run(start, drive.duration)
        shortest = min(shortest, time.process_time() - begin)
    return tolerance, shortest, np.concatenate((end.q, end.v))


def _simulation(
    scene: Scene, solver: str, drive: Drive, tolerance: float, dt: float
) -> tuple[Any, Any]:
    """Where it starts, and the simulation."""
    first = {"internal": {name: {"activation": _FIRST} for name in drive.excitations}}
    positions = {**scene.entries.get("initial", {}).get("position", {}), **drive.starts}
    scene = scene.with_(initial={"position": positions, **first})
    sources = {
        name: Polynomials(np.zeros(1), np.array(powers)[None, :, None])
        for name, powers in drive.excitations.items()
    }
    method = {"type": "dop853", "tolerance": tolerance}
    simulation = scene.simulation(
        integrator=method, dt=dt, solver={"type": solver}, sources=sources
    )
    return scene.initial, simulation


def _ranges(scene: Scene, solver: str, drive: Drive) -> dict[str, list[float]]:
    """Smallest and largest position of every joint [rad or m]."""
    start, simulation = _simulation(scene, solver, drive, 1e-8, drive.duration / 100.0)
    q = np.array([x.q for x in simulation.run(start, drive.duration)])
    return {one.name: [q[:, one.q].min(), q[:, one.q].max()] for one in scene.robot.joints}


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
