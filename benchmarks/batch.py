"""Many runs of a free arm beside `mujoco.rollout` at equal error, CPU time of one core.

    python benchmarks/batch.py [RUNS]

Both return states every hundredth of a second: rollouts go on by so many steps a call, batches
leave out what they write in between. Errors are the largest ones of positions at these times in
all runs; times are the least of several calls that take turns. Batches run with the vectors of
this processor, then, where those are wider, with those of AVX2.
"""

import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import mujoco
import numpy as np
from compiled import SCENES
from mujoco import rollout

from mbd_ros.api import load_scene
from mbd_ros.applications.report.peers.mujoco_peer import MujocoRun
from mbd_ros.applications.report.peers.translation import common_ground, task_of
from mbd_ros.compiled.runs import lane_method
from mbd_ros.core.state import Array
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.runs.batch import Batch

RUNS, DURATION, SAMPLE, ROUNDS = 64, 1.0, 1e-2, 3
SPREAD = 0.1  # of the starts around that of the scene [rad, rad/s]
METHODS = [{"type": "adams", "order": order} for order in (3, 4, 6, 8)]
METHODS += [{"type": kind} for kind in ("rk4", "dopri5", "dop853")]
INTERVALS = (5e-3, 2e-3, 1e-3, 5e-4, 2e-4)
STEPS = (2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5)
TARGETS = (1e-3, 1e-6, 1e-8)
AVX2 = 4  # lanes
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
    known = sampled(exact.run(DURATION, q, v).states, 5e-4)
    theirs = list(rungs(their_calls(scene, q, v), known))
    compare(list(rungs(our_calls(scene, q, v), known)), theirs, count)
    if lane_method.lanes() > AVX2:
        os.environ["CC"] = f"{os.environ.get('CC', 'cc')} -mno-avx512f"
        lane_method.lanes = lambda: AVX2
        compare(list(rungs(our_calls(load_scene(scene.path), q, v), known)), theirs, count)


def compare(ours: list[Rung], theirs: list[Rung], count: int) -> None:
    """Print the ratio at each error, or who does not get there."""
    for error in TARGETS:
        pair = {"ours": best(ours, error), "MuJoCo": best(theirs, error)}
        found = {name: one for name, one in pair.items() if one is not None}
        rounds = [[timed(one.take) for one in found.values()] for _ in range(ROUNDS)]
        times = dict(zip(found, np.array(rounds).min(axis=0).tolist(), strict=True))
        ratio = times["MuJoCo"] / times["ours"] if len(times) == len(pair) else None
        shown = {
            name: {"setup": one.name, "error": one.error, "us a run": 1e6 * times[name] / count}
            for name, one in found.items()
        }
        line = {"error": error, "lanes": lane_method.lanes(), "ratio": ratio}
        print(json.dumps(line | dict.fromkeys(pair) | shown), flush=True)


def sampled(rows: Array, dt: float) -> Array:
    """Positions of the samples after the start, shape (runs, samples, joints)."""
    step = round(SAMPLE / dt)
    return rows[:, step::step, 1:8]


def our_calls(scene: Scene, q: Array, v: Array) -> Iterator[tuple[str, Take]]:
    """Batches."""
    for method in METHODS:
        for dt in INTERVALS:
            batch = scene.batch(len(q), threads=1, integrator=method, dt=dt)
            yield f"{method} dt {dt:g}", partial(ours_at, batch, q, v, dt)


def ours_at(batch: Batch, q: Array, v: Array, dt: float) -> Array:
    """Positions of a batch."""
    return sampled(batch.run(DURATION, q, v).states, dt)


def their_calls(scene: Scene, q: Array, v: Array) -> Iterator[tuple[str, Take]]:
    """Rollouts of MuJoCo; coordinates of a fixed arm are the same in both."""
    task = task_of(common_ground(scene))
    start = np.hstack((np.zeros((len(q), 1)), q, v))
    for dt in STEPS:
        model = MujocoRun(task, "mjINT_RK4", dt)._model
        take = partial(theirs_at, model, mujoco.MjData(model), start, round(SAMPLE / dt))
        yield f"RK4 dt {dt:g}", take


def theirs_at(model: mujoco.MjModel, data: mujoco.MjData, x: Array, steps: int) -> Array:
    """Positions of rollouts."""
    rows = np.empty((len(x), round(DURATION / SAMPLE), x.shape[1]))
    for k in range(rows.shape[1]):
        rows[:, k] = x = rollout.rollout(model, data, x, nstep=steps)[0][:, -1]
    return rows[:, :, 1:8]


def rungs(calls: Iterator[tuple[str, Take]], known: Array) -> Iterator[Rung]:
    """Errors and times."""
    for name, take in calls:
        begin = time.process_time()
        rows = take()
        first = time.process_time() - begin
        error = float(np.abs(rows - known).max())
        if np.isfinite(error):
            yield Rung(name, take, error, min(first, timed(take) if first < 1.0 else first))


def best(found: list[Rung], error: float) -> Rung | None:
    """The fastest one that is as exact; None where none is."""
    good = [one for one in found if one.error <= error]
    return min(good, key=lambda one: one.seconds, default=None)


def timed(take: Take) -> float:
    """CPU time of a call [s]."""
    begin = time.process_time()
    take()
    return time.process_time() - begin


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else RUNS)
