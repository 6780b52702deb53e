"""Many runs as arrays: where they start, what they did, and one of them taken alone."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.simulation.simulation import Simulation
from mbd_ros.core.state import Array, State
from mbd_ros.errors import DivergedError, MbdError, SolveError


class Runs(NamedTuple):
    """What a batch returns.

    Attributes:
        states: Time [s], positions, velocities of all joints and internal states, as the rows of
            `Simulation.sampled`; shape (n, samples, 1 + nq + nv + nz). NaN after a run has ended.
        known: How many samples each run has, shape (n,).
        failures: Run -> why it ended early.
    """

    states: Array
    known: NDArray[np.int64]
    failures: dict[int, MbdError]


class Starts(NamedTuple):
    """Configurations, velocities of all joints and internal states, a row a run."""

    q: Array
    v: Array
    z: Array

    def state(self, run: int, t: float) -> State:
        """Where a run starts, at a time [s]."""
        return State(t, *(rows[run] for rows in self))


def run_alone(
    simulation: Simulation, x: State, duration: float, out: Array
) -> tuple[int, MbdError | None]:
    """One run, taken alone; how many samples it has, and why it ended early.

    Args:
        simulation: Takes it.
        x: Its start.
        duration: [s].
        out: Gets the samples, those of `Runs.states`.
    """
    out[...], count = np.nan, 0
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # a divergence says so itself
            for each in simulation.run(x, duration):
                out[count], count = np.concatenate(([each.t], *each[1:4])), count + 1
    except (DivergedError, SolveError) as error:
        return count, error
    return count, None
