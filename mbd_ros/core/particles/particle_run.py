"""A run of points: states after every so many steps."""

import math
from collections.abc import Iterator

import numpy as np

from mbd_ros.core.particles.particle_system import ParticleSystem
from mbd_ros.core.particles.verlet_steps import ParticleVerlet
from mbd_ros.core.state import State
from mbd_ros.core.thresholds import SAME_TIME
from mbd_ros.errors import DivergedError


def sample_count(duration: float, dt: float, every: int) -> int:
    """How many samples follow the first one."""
    return math.ceil(duration / (dt * every) - SAME_TIME)


def run(
    system: ParticleSystem,
    stepper: ParticleVerlet,
    x: State,
    duration: float,
    dt: float,
    every: int = 1,
) -> Iterator[State]:
    """States, the first one included; a last shorter interval ends exactly at the end.

    Args:
        system: The points.
        stepper: Its steps.
        x: State on the rows.
        duration: Time from the first state to the last.
        dt: Step.
        every: Steps from one state to the next.

    Raises:
        DivergedError: A state is not finite, or rows of a molecule cannot be closed.
    """
    origin, end = x.t, x.t + duration
    yield x
    for k in range(1, sample_count(duration, dt, every) + 1):
        due = min(origin + k * every * dt, end)
        x = stepper.advance(x, due)
        if not (math.isfinite(x.q.dot(x.q)) and math.isfinite(x.v.dot(x.v))):
            bad = np.flatnonzero(~np.isfinite(x.q + x.v))
            name = system.names[int(bad[0]) // 3] if len(bad) else system.names[0]
            raise DivergedError(f"the state of {name} is not finite at t = {x.t:.9g}")
        yield x
