"""Ways to run one scene that are timed against one another."""

import gc
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Protocol, TypeVar

import numpy as np

from mbd_ros.applications.report.precision.converged import (
    COMPILED,
    Choice,
    Known,
    Record,
    distance,
    problem_of,
    timed,
)
from mbd_ros.applications.report.precision.reference_problems import error
from mbd_ros.core.state import State
from mbd_ros.errors import MbdError
from mbd_ros.scene.built_scene import Scene

OURS, NATIVE = "mbd_ros", "mbd_ros, compiled"
_LONG = 0.1  # s; runs are not repeated beyond that
USELESS = 1.0e2  # error of a run that says nothing [rad or m]
Found = TypeVar("Found")
Found_co = TypeVar("Found_co", covariant=True)


class Contender(Protocol[Found_co]):
    """One package with one set-up.

    Attributes:
        package: Its name, `OURS` and `NATIVE` for this one.
        setup: Name of this set-up among others, without the step.
        record: Its record for JSON.
    """

    package: str
    setup: str
    record: Record

    def run(self, times: Sequence[float]) -> tuple[Found_co, float]:
        """Return the solution at the samples, and the CPU time of the integration alone [s].

        Raises:
            MbdError: The run stopped.
        """
        ...


class Ours:
    """This package.

    Args:
        choice: How it is run.
    """

    def __init__(self, scene: Scene, choice: Choice) -> None:
        self.package = NATIVE if choice.solver == COMPILED else OURS
        self._scene, self._choice = scene, choice
        self.record: Record = dict(choice._asdict())
        self.setup = choice.method

    def run(self, times: Sequence[float]) -> tuple[list[State], float]:
        """Return the states at the samples, and the CPU time of the integration [s]."""
        simulation, ys, used = timed(self._scene, self._choice, times)
        return [simulation.system.expand(y) for y in ys], used


def compete(
    scene: Scene, contenders: Sequence[Contender[list[State]]], motion: Known, rounds: int
) -> list[Record]:
    """Errors and best times of all against a motion that is known."""
    return in_turn(contenders, motion.times, partial(_errors, scene, motion), rounds)


def in_turn(
    contenders: Sequence[Contender[Found]],
    times: Sequence[float],
    judge: Callable[[Found], Record],
    rounds: int,
) -> list[Record]:
    """Errors and best times of all, run in turn so that a slow machine is slow for all.

    The `spread` of a run that took too long to be repeated is None.

    Args:
        times: Samples [s].
        judge: Errors of what a run found, or why it is no use: `stopped`.
        rounds: How often each is run.
    """
    records = [{"package": c.package, "setup": c.setup, **c.record} for c in contenders]
    seconds: list[list[float]] = [[] for _ in contenders]
    gc.collect()
    gc.disable()
    try:
        for turn in range(rounds):
            for i, contender in enumerate(contenders):
                if "stopped" in records[i] or sum(seconds[i]) * times[-1] > _LONG:
                    continue
                try:
                    samples, used = contender.run(times)
                except MbdError as stop:
                    records[i]["stopped"] = str(stop)[:160]
                    continue
                seconds[i].append(used / times[-1])
                if turn == 0:
                    records[i] |= judge(samples)
    finally:
        gc.enable()
    for record, taken in zip(records, seconds, strict=True):
        if "stopped" not in record:
            best = min(taken)
            spread = sorted(taken)[len(taken) // 2] / best - 1.0 if len(taken) > 1 else None
            record |= {"seconds": best, "spread": spread}
    return records


def cpu_time(call: Any) -> float:
    """CPU time of a call [s]."""
    begin = time.process_time()
    call()
    return time.process_time() - begin


def _errors(scene: Scene, motion: Known, states: Sequence[State]) -> Record:
    pairs = list(zip(states, motion.states, strict=True))
    off = float(np.max([distance(scene, x, known) for x, known in pairs]))  # nan stays nan
    if not off < USELESS:
        return {"stopped": "far off"}
    problem = problem_of(scene)
    position = off if problem is None else error(problem, scene.robot, states)
    velocity = max(float(np.abs(x.v - known.v).max()) for x, known in pairs)
    return {"position": position, "configuration": off, "velocity": velocity}
