"""Many runs of a free arm beside `mujoco.rollout` at equal error, CPU time of one core.

    python benchmarks/batch.py [RUNS]

Both return the states after all their steps. Errors are the largest ones of positions at every
tenth of a second in all runs; times are the least of several calls that take turns.
"""

import json
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import mujoco
import numpy as np
from compiled import SCENES
from mujoco import rollout

from mbd_ros.core.state import Array
from mbd_ros.report.peers.mujoco_peer import MujocoRun
from mbd_ros.report.peers.translation import common_ground, task_of
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import load_scene

RUNS, DURATION, GRID, ROUNDS = 64, 1.0, 0.1, 3
SPREAD = 0.1  # of the starts around that of the scene [rad, rad/s]
METHODS = [{"type": "adams", "order": order} for order in (3, 4, 6, 8)]
METHODS += [{"type": kind} for kind in ("rk4", "dopri5", "dop853")]
INTERVALS = (5e-3, 2e-3, 1e-3, 5e-4, 2e-4)
STEPS = (2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5)
TARGETS = (1e-3, 1e-6)
Take = Callable[[], Array]


class Rung(NamedTuple):
    """A way to take all runs: its name, what it does, error and least time [s]."""

    name: str
    take: Take
    error: float
    seconds: float


def main(count: int) -> None:
    """Print the ratios."""
    scene = load_scene(f"{SCENES}/arm7_swing.yaml")
    rng, x = np.random.default_rng(7), scene.initial
    q, v = (one + rng.normal(0.0, SPREAD, (count, len(one))) for one in (x.q, x.v))
    exact = scene.batch(count, threads=1, integrator={"type": "dop853"}, dt=5e-4)
    rows = exact.run(DURATION, q, v).states
    known = on_grid(rows, 5e-4)[:, 1:]
    ours = list(rungs(our_calls(scene, q, v), known))
    theirs = list(rungs(their_calls(scene, q, v), known))
    for error in TARGETS:
        pair = [best(each, error) for each in (ours, theirs)]
        times = np.array([[timed(one.take) for one in pair] for _ in range(ROUNDS)]).min(axis=0)
        shown = [
            {"setup": p.name, "error": p.error, "us a run": 1e6 * t / count}
            for p, t in zip(pair, times, strict=True)
        ]
        print(
            json.dumps(
                {
                    "error": error,
                    "ratio": times[1] / times[0],
                    "ours": shown[0],
                    "MuJoCo": shown[1],
                }
            ),
            flush=True,
        )


def on_grid(rows: Array, dt: float) -> Array:
    """Positions at every tenth of a second; the first row is that of the start."""
    return rows[:, :: round(GRID / dt), 1:8]


def our_calls(
    scene: Scene, q: Array, v: Array
) -> Iterator[tuple[str, Take, Callable[[Array], Array]]]:
    """Batches."""
    for method in METHODS:
        for dt in INTERVALS:
            batch = scene.batch(len(q), threads=1, integrator=method, dt=dt)
            take = partial(lambda batch: batch.run(DURATION, q, v).states, batch)
            yield f"{method} dt {dt:g}", take, lambda rows, dt=dt: on_grid(rows, dt)[:, 1:]


def their_calls(
    scene: Scene, q: Array, v: Array
) -> Iterator[tuple[str, Take, Callable[[Array], Array]]]:
    """Rollouts of MuJoCo; coordinates of a fixed arm are the same in both."""
    task = task_of(common_ground(scene))
    state = np.hstack((np.zeros((len(q), 1)), q, v))
    for kind in ("RK4",):
        for dt in STEPS:
            model = MujocoRun(task, f"mjINT_{kind}", dt)._model
            data, steps = mujoco.MjData(model), round(DURATION / dt)
            take = partial(
                lambda model, data, steps: rollout.rollout(model, data, state, nstep=steps)[0],
                model,
                data,
                steps,
            )
            yield (
                f"{kind} dt {dt:g}",
                take,
                lambda rows, dt=dt: rows[:, round(GRID / dt) - 1 :: round(GRID / dt), 1:8],
            )


def rungs(
    calls: Iterator[tuple[str, Take, Callable[[Array], Array]]], known: Array
) -> Iterator[Rung]:
    """Errors and times."""
    for name, take, seen in calls:
        begin = time.process_time()
        rows = take()
        first = time.process_time() - begin
        error = float(np.abs(seen(rows) - known).max())
        if np.isfinite(error):
            yield Rung(name, take, error, min(first, timed(take) if first < 1.0 else first))


def best(found: list[Rung], error: float) -> Rung:
    """The fastest one that is as exact."""
    return min((one for one in found if one.error <= error), key=lambda one: one.seconds)


def timed(take: Take) -> float:
    """CPU time of a call [s]."""
    begin = time.process_time()
    take()
    return time.process_time() - begin


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else RUNS)
