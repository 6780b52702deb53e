"""CPU time of a compiled scene beside equations written by hand, in the same native integrators.

    python benchmarks/andrews.py

Andrews' squeezer of the Test Set for IVP Solvers, without stabilization in both. Each method runs
with the loosest tolerance with which its own result has the error asked for.
"""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.compiled.build.library import load
from mbd_ros.compiled.code.emit import emit
from mbd_ros.compiled.code.source import Signature
from mbd_ros.compiled.runs.compiled_method import CompiledMethod
from mbd_ros.compiled.runs.native_run import NativeRun, Sizes, held_inputs, with_integrators
from mbd_ros.core.state import Array
from mbd_ros.methods.integration.stepping import Integrator
from mbd_ros.methods.simulation.samples import sample_times
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.reading.part_entries import build_part

SCENE = "package://mbd_ros/config/scenes/benchmark/ts_andrews.yaml"
DURATION, INTERVAL, ERROR, ROUNDS = 0.03, 0.03 / 400, 1e-6, 50
SIZES = Sizes(7, 7, 0, 0, 0, 0, 7, 7, is_flat=True, is_whole=True)
CALL = """
static void accelerate(const real *t, const real *q, const real *v, const real *z, const real *u,
                       const real *p, real *a, real *rates, real *health, real *work) {
  andrews(q, v, a);
  *health = 1.0;
}
"""
Take = Callable[[], Array]


def main() -> None:
    """Print one line a method."""
    scene = load_scene(SCENE)
    known = ours(scene, method("dop853", 1e-13))()[-1, 1:8]
    for kind in ("dopri5", "dop853"):
        runs = {"ours": ours, "by_hand": by_hand}
        found = {
            name: loosest(partial_of(scene, kind, make), known) for name, make in runs.items()
        }
        times: dict[str, list[float]] = {name: [] for name in runs}
        for _ in range(ROUNDS):
            for name, (take, _, _) in found.items():
                begin = time.process_time()
                take()
                times[name].append(time.process_time() - begin)
        best = {name: min(each) for name, each in times.items()}
        line: dict[str, Any] = {"method": kind, "ratio": best["ours"] / best["by_hand"]}
        for name, (_, tolerance, error) in found.items():
            line[name] = {"tolerance": tolerance, "error": error, "us": 1e6 * best[name]}
        print(json.dumps(line))


def partial_of(scene: Any, kind: str, make: Any) -> Callable[[float], Take]:
    """What makes a run of a tolerance."""
    return lambda tolerance: make(scene, method(kind, tolerance))


def loosest(make: Callable[[float], Take], known: Array) -> tuple[Take, float, float]:
    """The run with the loosest tolerance that is exact enough, the tolerance, and its error."""
    for exponent in np.arange(-4.0, -12.0, -0.25):
        take = make(float(10.0**exponent))
        end = take()[-1, 1:8]
        error = float(np.abs(end / known - 1.0).max())
        if error <= ERROR:
            return take, float(10.0**exponent), error
    raise SystemExit("no tolerance is tight enough")


def method(kind: str, tolerance: float) -> Integrator:
    """A method with error control."""
    found: Integrator = build_part("integrators", {"type": kind, "tolerance": tolerance}, "here")
    return found


def ours(scene: Any, chosen: Integrator) -> Take:
    """Runs of the compiled scene."""
    none = build_part("stabilization", {"type": "none"}, "here")
    simulation = Simulation(scene.system(), CompiledMethod(chosen, none), none, INTERVAL)
    return lambda: simulation.sampled(scene.initial, DURATION)


def by_hand(scene: Any, chosen: Integrator) -> Take:
    """Runs of the equations written by hand, in the order of joints of the scene."""
    names = [joint.name for joint in sorted(scene.robot.joints, key=lambda joint: joint.v)]
    order = [names.index(f"q{i}") for i in range(1, 8)]
    own = np.argsort(order)
    y, head = scene.system().reduce(scene.initial), emit([])
    text = f"{head.text}#include <string.h>\n{Path(__file__).with_name('andrews.h').read_text()}"
    signatures = {"accelerate": Signature((1, 7, 7, 0, 0, 0), (7, 0, 1), 0)}
    source = head._replace(text=text + CALL, signatures=signatures)
    run = NativeRun(
        load(with_integrators(source, SIZES)), SIZES, chosen, INTERVAL, np.zeros((3, 0))
    )
    y = y._replace(q=y.q[order], v=y.v[order])
    times, held = sample_times(0.0, DURATION, INTERVAL), held_inputs([], 0.0)
    take = run.full_run(y, np.hstack(y[:3]), times, held, 10**6)
    columns = [0, *(1 + own), *(8 + own)]

    def taken() -> Array:
        rows = take()
        assert rows is not None
        return rows[:, columns]

    return taken


if __name__ == "__main__":
    main()
