"""CPU time of compiled runs beside MuJoCo's at equal error, as ratios in one run.

    python benchmarks/compiled.py [NAME ..]

Each line names a scene, how long it is simulated and the error that both have to reach. MuJoCo's
set-ups and steps, up to 0.1 s, compete with methods, tolerances and stabilizations of compiled
runs, which return 400 samples a run, the call from Python included. Errors are the largest ones of
positions at every tenth of a second, and at all samples of ours. Times are the least of several
runs that take turns.
"""

import json
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.api import load_scene
from mbd_ros.applications.report.peers.mujoco_peer import MujocoRun
from mbd_ros.applications.report.peers.translation import common_ground, task_of
from mbd_ros.compiled.runs.compiled_method import CompiledMethod
from mbd_ros.core.state import Array, State
from mbd_ros.errors import MbdError
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reading.part_entries import build_part

SCENES = "package://mbd_ros/config/scenes/benchmark"
STEPS = (0.1, 0.05, 0.02, 0.01, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5)
SHARES = (2.0, 1.0, 0.7, 0.5, 0.4, 0.38)
OTHERS = ("EULER", "IMPLICIT", "IMPLICITFAST")
GRID, ROUNDS, SHORT, LONG = 0.1, 40, 2e-3, 0.02
Run = Callable[[], tuple[Array, float]]


class Line(NamedTuple):
    """What is compared.

    Attributes:
        scene: Name of its file.
        duration: [s].
        targets: Error -> ratio to be reached.
        samples: How many are returned.
        finest: Shortest step of MuJoCo that is tried [s].
    """

    scene: str
    duration: float
    targets: dict[float, float]
    samples: int = 400
    finest: float = 5e-5

    @property
    def interval(self) -> float:
        """Between two samples [s]."""
        return self.duration / self.samples


LINES = {
    "arm": Line("arm7_swing", 1.0, {1e-6: 20.0, 1e-8: 50.0}),
    "coupled": Line("arm7_swing_coupled", 1.0, {1e-6: 30.0}),
    "a02": Line("a02_four_bars_2", 1.0, {1e-3: 3.0, 1e-8: 100.0}),
    "x02": Line("x02_four_bar_1e-2", 1.0, {1e-3: 8.0, 1e-8: 100.0}),
    "a02_long": Line("a02_four_bars_2", 10.0, {1e-3: 15.0}, finest=5e-4),
    "x02_long": Line("x02_four_bar_1e-2", 3.0, {1e-3: 15.0}, 420, 5e-4),
}


class Rung(NamedTuple):
    """A run of somebody: its name, what it does, error and least time [s]."""

    name: str
    run: Run
    error: float
    seconds: float


def main(names: list[str]) -> None:
    """Print the ratios."""
    for name in names or LINES:
        print(json.dumps({"line": name, **compared(LINES[name])}), flush=True)


def compared(line: Line) -> dict[str, Any]:
    """Best times and ratios for every error of a line."""
    scene = load_scene(f"{SCENES}/{line.scene}.yaml")
    known = positions(scene, line)
    ours = list(rungs(our_runs(scene, line), known))
    theirs = list(rungs(mujoco_runs(scene, line), known))
    found: dict[str, Any] = {}
    for error, wanted in line.targets.items():
        pair = [best(each, error) for each in (ours, theirs)]
        if pair[0] is None or pair[1] is None:
            least = min(each.error for each in theirs)
            found[f"{error:g}"] = {"ours": shown(pair[0]), "least error of MuJoCo": least}
            continue
        times = in_turn([rung.run for rung in pair if rung])
        ratio = times[1] / times[0]
        found[f"{error:g}"] = {
            "ratio": round(ratio, 1),
            "wanted": wanted,
            "ours": shown(pair[0]._replace(seconds=times[0])),
            "MuJoCo": shown(pair[1]._replace(seconds=times[1])),
        }
    return found


def shown(rung: Rung | None) -> dict[str, Any] | None:
    """What is printed of a run."""
    if rung is None:
        return None
    return {
        "setup": rung.name,
        "error": float(f"{rung.error:.2g}"),
        "us": round(1e6 * rung.seconds),
    }


def best(found: list[Rung], error: float) -> Rung | None:
    """The fastest run that is as exact."""
    fit = [rung for rung in found if rung.error <= error]
    return min(fit, key=lambda rung: rung.seconds) if fit else None


def rungs(runs: Iterator[tuple[str, Run]], known: Array) -> Iterator[Rung]:
    """Errors and times of all runs that come to their end."""
    for name, run in runs:
        try:
            found, taken = run()
        except MbdError:
            continue
        off = float(np.abs(found - known[:: (len(known) - 1) // (len(found) - 1)]).max())
        more = 20 if taken < SHORT else 2 if taken < 0.1 else 0
        times = [taken, *(run()[1] for _ in range(more))]
        yield Rung(name, run, off, min(times))


def in_turn(runs: list[Run]) -> list[float]:
    """Least times of runs that take turns [s]."""
    first = [run()[1] for run in runs]
    rounds = ROUNDS if max(first) < LONG else 5
    times = [first, *([run()[1] for run in runs] for _ in range(rounds))]
    return np.array(times).min(axis=0).tolist()


def positions(scene: Scene, line: Line) -> Array:
    """The motion of the plain tier to rounding, a row a sample."""
    simulation = scene.simulation(
        integrator={"type": "dop853", "tolerance": 1e-13},
        dt=line.interval,
        stabilization={"type": "projection"} if has_rows(scene) else None,
    )
    return np.array([x.q for x in simulation.run(scene.initial, line.duration)])


def our_runs(scene: Scene, line: Line) -> Iterator[tuple[str, Run]]:
    """Compiled runs, one call each."""
    for integrator, dt in our_methods(line.interval):
        for stabilization in ("projection", "none") if has_rows(scene) else ("none",):
            method = build_part("integrators", integrator, "integrator")
            fix = build_part("stabilization", {"type": stabilization}, "stabilization")
            system, parts = scene.system(), round(line.interval / dt)
            simulation = Simulation(system, CompiledMethod(method, fix), fix, dt)
            run = partial(our_run, simulation, scene.initial, line.duration, parts)
            yield f"{integrator} dt {dt:g} {stabilization}", run


def our_run(simulation: Simulation, x: State, duration: float, parts: int) -> tuple[Array, float]:
    """Positions at the samples, and CPU time of the call [s]."""
    begin = time.process_time()
    rows = simulation.sampled(x, duration)
    used = time.process_time() - begin
    return rows[::parts, 1 : 1 + simulation.system.model.nq], used


def has_rows(scene: Scene) -> bool:
    """Whether anything has to be kept by multipliers."""
    return bool(scene.system().bilateral.rows)


def our_methods(interval: float) -> Iterator[tuple[dict[str, Any], float]]:
    """Methods and their steps, parts of the interval of the samples [s]."""
    for exponent in np.arange(-12.0, -1.0, 0.25):
        for kind in ("dopri5", "dop853"):
            yield {"type": kind, "tolerance": float(f"{10.0**exponent:.3g}")}, interval
    for parts in (1, 2, 5):
        for order in (2, 3, 4, 6, 8):
            yield {"type": "adams", "order": order}, interval / parts
        yield {"type": "rk4"}, interval / parts


def mujoco_runs(scene: Scene, line: Line) -> Iterator[tuple[str, Run]]:
    """MuJoCo's set-ups; their steps alone are timed."""
    task = task_of(common_ground(scene))
    for dt in (step for step in STEPS if step >= line.finest):
        for share in SHARES if task.has_rows else (2.0,):
            for is_exact in (False, True) if task.has_rows else (False,):
                plain = share == 2.0 and not is_exact
                for kind in ("RK4", *OTHERS) if plain else ("RK4",):
                    peer = MujocoRun(task, f"mjINT_{kind}", dt, share, is_exact)
                    yield (
                        f"{peer.setup}, {dt:g} s",
                        partial(their_run, peer, task.q, line.duration),
                    )


def their_run(peer: MujocoRun, q: Array, duration: float) -> tuple[Array, float]:
    """Positions at every tenth of a second, and CPU time of the steps [s]."""
    states, used = peer.run((np.arange(1, round(duration / GRID) + 1) * GRID).tolist())
    return np.array([q, *(x.q for x in states)]), used


if __name__ == "__main__":
    main(sys.argv[1:])
